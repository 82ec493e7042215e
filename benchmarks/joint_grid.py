"""The joint grid: a heavy net of ball joints.  python benchmarks/joint_grid.py [--steps N] [--quick] [--out FOLDER]

20x20 unit spheres in a net 1 m apart, four corners fixed, a chain of 16 from each: 6800 bodies, 7160 joints, 21,480
rows, from rest, dt 1/60 s, relative residual 1e-4 (Benevolensky & Voroshilov 2009, section 3.7; radius 0.5 m, 1 kg).
Gaps are distances between the two anchors of a joint, over the whole run. The rows are eliminated (solver
"direct", what "auto" takes); MPRGP and PGS are compared with that on the first step, the easiest one: error against
iterations. Run it with one core (taskset -c 0, intra_op_parallelism_threads=1) to compare with other engines.
"""

import argparse
import pathlib

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
from machine import describe, first_time, median_time  # noqa: E402
from report import finish, line_plot  # noqa: E402

import jaxfem as jf  # noqa: E402

SIDE, CHAIN, DT, TOLERANCE = 20, 16, 1 / 60, 1e-4


def grid(dtype, side=SIDE, chain=CHAIN, **build):
    """Model, params, state and the joints' number."""
    corners = {(0, 0), (0, side - 1), (side - 1, 0), (side - 1, side - 1)}
    net = {
        (i, j): jf.RigidBody(jf.Sphere(0.5), mass=1.0, position=(i, j, 0.0), fixed=(i, j) in corners)
        for i in range(side)
        for j in range(side)
    }
    bodies, joints = list(net.values()), []
    for (i, j), body in net.items():
        joints += [jf.BallJoint(body, net[i + 1, j], (i + 0.5, j, 0.0))] if i + 1 < side else []
        joints += [jf.BallJoint(body, net[i, j + 1], (i, j + 0.5, 0.0))] if j + 1 < side else []
        above = body
        for k in range(chain):
            below = jf.RigidBody(jf.Sphere(0.5), mass=1.0, position=(i, j, -(k + 1.0)))
            joints.append(jf.BallJoint(above, below, (i, j, -(k + 0.5))))
            bodies.append(below)
            above = below
    settings = {"tolerance": TOLERANCE, "max_iterations": 5000, "dtype": dtype, **build}
    return jf.build(jf.Scene(bodies, joints=joints), **settings)


def anchor_gap(model, state):
    """Largest distance between the two anchors of a joint [m]."""
    from jaxfem.system.coupled import configuration  # here: commits.py takes this file to commits that lack it

    at = configuration(state)
    ends = [(lock.a.placed(at).position, lock.b.placed(at).position) for lock in model.joints.values()]
    return jnp.stack([jnp.linalg.norm(b - a, axis=-1).max() for a, b in ends]).max()


def largest_gap(model, states):
    """Largest distance between two anchors over all saved states [m]."""
    return float(jax.lax.map(lambda state: anchor_gap(model, state), states).max())


def measure(dtype, steps, repeats, **build):
    model, params, state = grid(dtype, **build)

    def run():
        return jf.rollout(model, params, state, DT, steps)

    compile_s = first_time(run)
    seconds = median_time(run, repeats)
    states, info = run()
    return {
        "ms_per_step": 1e3 * seconds / steps,
        "largest_gap": largest_gap(model, states),
        "iterations": float(jnp.median(info.iterations)),
        "most_iterations": int(info.iterations.max()),
        "status": int(info.status.max()),
        "steps": steps,
        "lowest": float(states.rigid.positions[..., 2].min()),
        "first_call_s": compile_s,
    }


def compare_first_step(dtype, quick):
    """The first step by each solver, stopped after more and more iterations, and to the tolerance: lists of figures.

    Errors: the largest difference of a velocity from that of the converged step in double precision, over the largest
    velocity.
    """
    model, params, state = grid(jnp.float64, tolerance=1e-10)
    exact = jf.step(model, params, state, DT)[0].rigid.velocities
    most = 200 if quick else 5000
    limits = {"direct": (1, 2, 3), "mprgp": (10, 30, 100, 300, most), "pgs": (10, 30, 100, 300, 1000, most)}
    found = {}
    for solver, stops in limits.items():
        model, params, state = grid(dtype, solver=solver)
        figures = {"iterations": [], "error": [], "residual": [], "ms": []}
        for limit in stops:
            if limit > most:
                continue
            stopped = model.replace(max_iterations=jnp.asarray(limit, jnp.int32))
            seconds = median_time(lambda m=stopped, p=params, s=state: jf.step(m, p, s, DT), 1)
            after, info = jf.step(stopped, params, state, DT)
            figures["iterations"].append(int(info.iterations))
            figures["error"].append(float(jnp.abs(after.rigid.velocities - exact).max() / jnp.abs(exact).max()))
            figures["residual"].append(float(info.residual))
            figures["ms"].append(1e3 * seconds)
        found[solver] = figures
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=600, help="steps of 1/60 s (600)")
    parser.add_argument("--quick", action="store_true", help="one run, 30 steps")
    parser.add_argument("--out", type=pathlib.Path, help="folder for the figures and the plot")
    arguments = parser.parse_args()
    steps = 30 if arguments.quick else arguments.steps
    figures = measure(jnp.float32, steps, 1)
    first = compare_first_step(jnp.float32, arguments.quick)
    figures |= {"pgs_ms_per_step": first["pgs"]["ms"][-1], "pgs_iterations": first["pgs"]["iterations"][-1]}
    figures |= {"first_step": first, "machine": describe()}
    finish("joint_grid", figures, arguments.out)
    if arguments.out:
        lines = {solver: (each["iterations"], each["error"]) for solver, each in first.items()}
        line_plot(arguments.out / "joint_grid.png", lines, "iterations, first step", "relative error of velocities")


if __name__ == "__main__":
    main()
