"""Paper A: the brick by MPRGP on all rows at several regularisations (figures 3, 4), few iterations of CG and of
Gauss-Seidel (figure 1), MPRGP with and without a preconditioner; the joint grid's own script is read, not run again."""

import itertools
import json
import pathlib

import jax
import numpy as np

import jaxfem as jf
from jaxfem.system.coupled import configuration

RESULTS = pathlib.Path(__file__).parents[1] / "results"
PAPER = {
    "joint_grid": {"iterations": 140, "ms": 45, "pgs_iterations": 840, "pgs_ms": 3110},
    "brick": {"high": {"iterations": 220, "ms": 50}, "low": {"iterations": 420, "ms": 150}},
}


def joint_grid(quick):
    """The figures of benchmarks/joint_grid.py beside the paper's."""
    path = RESULTS / "joint_grid.json"
    ours = json.loads(path.read_text()) if path.is_file() else None
    return {"paper": PAPER["joint_grid"], "ours": ours}


def brick(solver, young, steps, cells=(96, 2, 1), dt=1 / 60):
    """The paper's brick, 96 x 2 x 1 cells of 0.1 m, held at one end: iterations, time a step and sag."""
    mesh = jf.mesh.box(0.1 * np.array(cells), cells, tets_per_cell=12)
    body = jf.SoftBody(mesh, young=young, poisson=0.35, density=2200.0, fixed="x-")
    model, params, state = jf.build(jf.Scene([body]), solver=solver, tolerance=1e-4, max_iterations=20_000)
    states, info = jf.rollout(model, params, state, dt, steps)
    return {
        "young": young,
        "iterations": float(np.median(info.iterations)),
        "most_iterations": int(np.max(info.iterations)),
        "tip_z_m": float(states.positions[-1, -1, 2] - model.rest[-1, 2]),
        "status": int(np.max(info.status)),
    }


def bricks(quick):
    """By regularisation: rows' compliance times 1, 10, 100, as a modulus as much smaller."""
    steps, cells = (3, (24, 2, 1)) if quick else (10, (96, 2, 1))
    rows = []
    for solver in ("mprgp", "condensed"):
        for softer in (1, 10, 100):
            row = {"solver": solver, "compliance": softer} | brick(solver, 1e9 / softer, steps, cells)
            rows.append(row)
            print(row, flush=True)
    return {"paper": PAPER["brick"], "ours": rows}


def few_iterations(quick):
    """A heavy chain of ball joints: Gauss-Seidel ends too soft, conjugate gradients noisy, when stopped early.

    `gap_m`: the largest distance between the two anchors of a joint; `off_m`: how far the tip is from the converged
    one on average; `noise`: root mean square of the second differences of the tip that the converged course has not.
    """
    number, dt, steps = 20, 1 / 60, 60
    radius = 0.5
    bodies = [jf.RigidBody(jf.Sphere(radius), mass=1.0, position=(i, 0, 0), fixed=i == 0) for i in range(number)]
    joints = [jf.BallJoint(a, b, (i + radius, 0, 0)) for i, (a, b) in enumerate(itertools.pairwise(bodies))]

    def course(solver, most):
        model, params, state = jf.build(
            jf.Scene(bodies, joints=joints), solver=solver, tolerance=1e-8, max_iterations=most
        )
        states, _ = jf.rollout(model, params, state, dt, steps)
        at = jax.vmap(configuration)(states)
        held = next(iter(model.joints.values()))
        ends = [np.asarray(jax.vmap(lambda c, s=side: s.placed(c).position)(at)) for side in (held.a, held.b)]
        return np.asarray(states.rigid.positions[:, -1]), float(np.linalg.norm(ends[0] - ends[1], axis=-1).max())

    exact, gap = course("direct", 20_000)
    rows, tips = [{"solver": "direct", "iterations": None, "gap_m": gap}], {"converged": exact[:, 2].tolist()}
    for solver in ("pgs", "mprgp"):
        for most in (5, 20, 80) if quick else (5, 10, 20, 40, 80, 160):
            path, gap = course(solver, most)
            tips[f"{solver} {most}"] = path[:, 2].tolist()
            off = path - exact
            noise = np.sqrt(np.mean((off[2:] - 2 * off[1:-1] + off[:-2]) ** 2))
            row = {"solver": solver, "iterations": most, "gap_m": gap}
            row |= {"off_m": float(np.linalg.norm(off, axis=1).mean()), "noise_m": float(noise)}
            rows.append(row)
            print(row, flush=True)
    return {"rows": rows, "tips": tips}


def preconditioned(quick):
    """MPRGP on a box problem of stiff and soft parts, plain and with its diagonal taken out (Jacobi)."""
    rng = np.random.default_rng(0)
    count = 200
    basis = np.linalg.qr(rng.standard_normal((count, count)))[0]
    scale = np.exp(rng.uniform(0, np.log(1e4), count))
    matrix = scale[:, None] ** 0.5 * (basis @ np.diag(np.linspace(1, 10, count)) @ basis.T) * scale[None] ** 0.5
    right = rng.standard_normal(count) * scale**0.5
    one, plain = jf.solvers.mprgp(lambda x: matrix @ x, right, lower=0.0, tol=1e-8, max_iterations=1_000_000)
    two, scaled = jf.solvers.mprgp(matrix, right, lower=0.0, tol=1e-8)
    return {
        "plain": int(plain.iterations),
        "with Jacobi": int(scaled.iterations),
        "apart": float(np.abs(np.asarray(one) - np.asarray(two)).max() / np.abs(np.asarray(two)).max()),
        "status": max(int(plain.status), int(scaled.status)),
    }


PARTS = {
    "joint_grid": joint_grid,
    "few_iterations": few_iterations,
    "preconditioned": preconditioned,
    "bricks": bricks,
}
