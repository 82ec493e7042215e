"""Paper A: the brick by MPRGP on all rows at several regularisations (figures 3, 4), few iterations of CG and of
Gauss-Seidel (figure 1), MPRGP with and without a preconditioner; the joint grid's own script is read, not run again."""

import json
import pathlib

import jax
import numpy as np

import jaxfem as jf

RESULTS = pathlib.Path(__file__).parents[1] / "results"
PAPER = {
    "joint_grid": {"iterations": 140, "ms": 45, "pgs_iterations": 840, "pgs_ms": 3110},
    "brick": {"high": {"iterations": 220, "ms": 50}, "low": {"iterations": 420, "ms": 150}},
}


def joint_grid():
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
    """A beam that swings: Gauss-Seidel ends too soft, conjugate gradients noisy, when both are stopped early.

    `soft`: how far the tip's mean is off the converged one, `noise`: spread about its own smooth course, both as
    shares of the movement.
    """
    mesh = jf.mesh.box((0.16, 0.04, 0.04), (8, 2, 2))
    body = jf.SoftBody(mesh, young=2e5, poisson=0.3, density=1e3, damping=2e-3, fixed="x-")
    rows, tips = [], {}

    def tip(solver, most):
        model, params, state = jf.build(jf.Scene([body]), solver=solver, tolerance=1e-8, max_iterations=most)
        states, _ = jf.rollout(model, params, state, 5e-3, 60)
        return np.asarray(states.positions[:, -1, 2] - model.rest[-1, 2])

    exact = tip("condensed", 20_000)
    size = float(np.abs(exact).max())
    for solver in ("pgs", "mprgp"):
        for most in (5, 20, 80) if quick else (3, 5, 10, 20, 40, 80, 160):
            course = tip(solver, most)
            tips[f"{solver} {most}"] = course.tolist()
            second = course[2:] - 2 * course[1:-1] + course[:-2]
            smooth = exact[2:] - 2 * exact[1:-1] + exact[:-2]
            row = {
                "solver": solver,
                "iterations": most,
                "off": float(np.mean(np.abs(course - exact)) / size),
                "soft": float(np.mean(exact - course) / size),
                "noise": float(np.sqrt(np.mean((second - smooth) ** 2)) / size),
            }
            rows.append(row)
            print(row, flush=True)
    return {"rows": rows, "tips": tips | {"converged": exact.tolist()}}


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


def measure(quick):
    """All of paper A."""
    assert jax.config.jax_enable_x64
    return {
        "joint_grid": joint_grid(),
        "few_iterations": few_iterations(quick),
        "preconditioned": preconditioned(quick),
        "bricks": bricks(quick),
    }
