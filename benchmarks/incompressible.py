"""What does nu near 0.5 cost, and a whole recording with its gradient?  python benchmarks/incompressible.py [--quick]

The real beam, 20 x 6 x 6 cells of 6 tetrahedra with smoothed rows, second-order steps of 10 ms to 1e-6: time and
iterations of a step at nu = 0.3 and 0.499, then 1.6 s of it with the gradient of a loss in E, nu and beta by reverse
mode (160 steps, a tenth of the memory by checkpoints). `error`: of the gradient in E, against central differences.
"""

import jax
from machine import describe, median_time
from report import arguments, finish

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402

import jaxfem as jf  # noqa: E402

DT, STEPS = 1e-2, 160


def beam(cells):
    mesh = jf.mesh.box((0.1, 0.03, 0.03), cells, tets_per_cell=6)
    body = jf.SoftBody(mesh, 2.7e5, 0.499, 1070.0, damping=2.5e-3, fixed="x-", strain="smoothed")
    return jf.build(jf.Scene([body]), scheme="generalized_alpha", tolerance=1e-6)


def timed(call, repeats):
    """(median seconds after a first call, the result)."""
    return median_time(call, repeats), call()


def main():
    options = arguments(__doc__)
    cells, repeats = ((6, 2, 2), 1) if options.quick else ((20, 6, 6), 3)
    model, params, state = beam(cells)
    figures = {"machine": describe(), "elements": model.elements.count}
    for nu in (0.3, 0.499):
        own = params.replace(poisson=jnp.asarray(nu))
        seconds, (_, info) = timed(lambda own=own: jf.rollout(model, own, state, DT, 20, every=20), repeats)
        figures[f"nu_{nu}"] = {"ms_per_step": 50 * seconds, "iterations": int(info.iterations.max())}
    figures["step_ratio"] = figures["nu_0.499"]["ms_per_step"] / figures["nu_0.3"]["ms_per_step"]

    @jax.jit
    def loss(values):
        own = params.replace(**values)
        states, info = jf.rollout(model, own, state, DT, STEPS, checkpoint=10)
        return jnp.sum((states.positions - model.rest) ** 2), info.status.max()

    values = {"young": params.young, "poisson": params.poisson, "damping": params.damping}
    figures["forward_s"], (_, status) = timed(lambda: loss(values), repeats)
    gradient = jax.jit(jax.value_and_grad(loss, has_aux=True))
    figures["gradient_s"], (_, slopes) = timed(lambda: gradient(values), repeats)
    h = 1e-4 * float(params.young)
    up, down = (float(loss({**values, "young": params.young + s * h})[0]) for s in (1, -1))
    figures["error"] = abs(float(slopes["young"]) * 2 * h / (up - down) - 1)
    figures["status"] = int(status)
    finish("incompressible", figures, options.out)


if __name__ == "__main__":
    main()
