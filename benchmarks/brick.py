"""The stiff brick: what does a step cost, and is it right?  python benchmarks/brick.py [--quick] [--out FOLDER]

96x2x1 cells of 0.1 m, 12 tetrahedra each, 1 GPa, nu 0.35, 2200 kg/m^3, dt 1/60 s, clamped at one end, 60 steps from
rest (Benevolensky & Voroshilov 2009, section 3.7). Converged backward Euler on the same mesh: tip sag 5.633 m.
Run it with one core (taskset -c 0, intra_op_parallelism_threads=1) to compare with the figures of other engines.
"""

import time

import jax
import numpy as np
import scipy.sparse as sparse
import scipy.sparse.linalg as direct
from machine import describe, first_time, median_time
from report import arguments, finish

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
from scenes import brick  # noqa: E402

import jaxfem as jf  # noqa: E402

CONVERGED, STEPS, DT = 5.633, 60, 1 / 60


def tip_sag(model, positions):
    tip = model.rest[:, 0] > 9.6 - 1e-3
    return float(-jnp.mean((positions - model.rest)[tip, 2]))


def measure(dtype, repeats, tolerance=1e-4):
    model, params, state = brick(dtype, tolerance=tolerance)

    def run():
        return jf.rollout(model, params, state, DT, STEPS)

    compile_s = first_time(run)
    seconds = median_time(run, repeats)
    states, info = run()
    sag = tip_sag(model, states.positions[-1])
    return {
        "ms_per_step": 1e3 * seconds / STEPS,
        "tip_sag": sag,
        "tip_error": sag / CONVERGED - 1,
        "iterations": float(jnp.median(info.iterations)),
        "most_iterations": int(info.iterations.max()),
        "status": int(info.status.max()),
        "first_call_s": compile_s,
    }


def measure_mprgp(dtype, steps):
    model, params, state = brick(dtype, "mprgp")
    seconds = median_time(lambda: jf.rollout(model, params, state, DT, steps), 1)
    _, info = jf.rollout(model, params, state, DT, steps)
    return {"ms_per_step": 1e3 * seconds / steps, "iterations": float(jnp.median(info.iterations))}


def measure_scipy(repeats):
    """The same linear system of the first step, assembled by us, solved by SciPy's sparse direct solver."""
    model, params, state = brick(jnp.float64)
    # Imported here: commits.py takes this file's scene to commits that have these elsewhere.
    from jaxfem.methods.nodes.condensed import condensed_matrix
    from jaxfem.system.soft import momentum_gradient, step_system

    system = step_system(model, params, state, jnp.asarray(DT))
    matrix, pattern = condensed_matrix(system), model.pattern
    nodes, width = pattern.neighbours.shape
    blocks = np.asarray(matrix.blocks).reshape(nodes, 3, width, 3)
    rows = np.broadcast_to(3 * np.arange(nodes)[:, None, None, None] + np.arange(3)[None, :, None, None], blocks.shape)
    columns = np.broadcast_to(3 * np.asarray(pattern.neighbours)[:, None, :, None] + np.arange(3), blocks.shape)
    shape = (3 * nodes, 3 * nodes)
    csc = sparse.coo_matrix((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=shape).tocsc()
    right = -np.asarray(pattern.gathered(momentum_gradient(system, jnp.zeros_like(state.velocities)))).ravel()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        direct.spsolve(csc, right)
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))


def main():
    options = arguments(__doc__)
    repeats, mprgp_steps = (2, 1) if options.quick else (7, 3)
    scipy_ms = measure_scipy(repeats)
    figures = {"machine": describe()}
    for name, dtype in (("float32", jnp.float32), ("float64", jnp.float64)):
        figures[name] = measure(dtype, repeats)
        mprgp = measure_mprgp(dtype, mprgp_steps)
        figures[name] |= {"mprgp_ms_per_step": mprgp["ms_per_step"], "mprgp_iterations": mprgp["iterations"]}
        figures[name]["scipy_direct_ms"] = scipy_ms
    figures["float64_1e-6"] = measure(jnp.float64, repeats, 1e-6)
    finish("brick", figures, options.out)


if __name__ == "__main__":
    main()
