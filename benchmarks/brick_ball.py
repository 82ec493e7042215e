"""A rigid ball falls on the free end of the stiff brick.  python benchmarks/brick_ball.py [--quick] [--out FOLDER]

The brick of Benevolensky & Voroshilov 2009, section 3.7, held at one end, sagging from straight; a ball of 20 kg and
0.1 m radius meets its free end at 3 m/s. Float32 at 1e-4, dt 1/60 s, 60 steps, by the solver that build chooses and by
MPRGP on all rows. `penetration`: of nodes into the ball, the worst of all steps.
"""

import jax
from machine import describe, first_time, median_time
from report import arguments, finish

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402

import jaxfem as jf  # noqa: E402

DT, RADIUS, TOP = 1 / 60, 0.1, 0.1


def scene(dtype, **build):
    mesh = jf.mesh.box((9.6, 0.2, TOP), (96, 2, 1), tets_per_cell=12, mirrored=False)
    brick = jf.SoftBody(mesh, young=1e9, poisson=0.35, density=2200.0, fixed="x-", name="brick")
    place = (9.5, 0.1, TOP + RADIUS + 0.05)
    ball = jf.RigidBody(jf.Sphere(RADIUS), mass=20.0, position=place, velocity=(0, 0, -3.0), name="ball")
    near = (mesh.points[:, 0] > 9.2) & (mesh.points[:, 2] > TOP - 1e-9)
    contact = jf.Contact(brick, ball, friction=0.5, nodes=near)
    return jf.build(jf.Scene([brick, ball], contacts=[contact]), dtype=dtype, tolerance=1e-4, **build)


def measure(steps, repeats, **build):
    model, params, state = scene(jnp.float32, **build)

    def run():
        return jf.rollout(model, params, state, DT, steps)

    compile_s = first_time(run)
    seconds = median_time(run, repeats)
    states, info = run()
    away = jnp.linalg.norm(states.positions - states.rigid.positions, axis=-1)
    tip = jnp.abs(model.rest[:, 0] - 9.6) < 1e-4
    return {
        "ms_per_step": 1e3 * seconds / steps,
        "penetration": float(jnp.maximum(RADIUS - away.min(), 0)),
        "tip_sag": float(-(states.positions - model.rest)[-1, tip, 2].mean()),
        "ball_height": float(states.rigid.positions[-1, 0, 2]),
        "iterations": float(jnp.median(info.iterations)),
        "most_iterations": int(info.iterations.max()),
        "inverted": int(info.inverted.max()),
        "status": int(info.status.max()),
        "solver": model.method.name,
        "first_call_s": compile_s,
    }


def main():
    options = arguments(__doc__)
    steps, repeats = (15, 1) if options.quick else (60, 3)
    figures = {"machine": describe(), **measure(steps, repeats)}
    figures["first_15_steps"] = measure(15, 1)
    figures["first_15_steps_mprgp"] = measure(15, 1, solver="mprgp", max_iterations=20_000)
    finish("brick_ball", figures, options.out)


if __name__ == "__main__":
    main()
