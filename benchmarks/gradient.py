"""What does a gradient cost?  python benchmarks/gradient.py [--quick] [--out FOLDER]

50 steps of a beam of 1080 elements; gradient of a tip loss in E, nu and beta by reverse mode, beside the forward run.
"""

import jax
from machine import describe, median_time
from report import arguments, finish

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402

import jaxfem as jf  # noqa: E402


def scene(dtype, tolerance):
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (20, 3, 3))
    body = jf.SoftBody(mesh, young=2.6e5, poisson=0.4, density=1070.0, damping=2e-3, fixed="x-")
    return jf.build(jf.Scene([body]), dtype=dtype, tolerance=tolerance)


def calls(dtype, tolerance, checkpoint=None):
    """Fifty steps, and they with their gradient in E, nu and damping: two calls, and the gradient's program."""
    model, params, state = scene(dtype, tolerance)

    def loss(values):
        young, poisson, damping = values
        own = params.replace(young=young, poisson=poisson, damping=damping)
        states, _ = jf.rollout(model, own, state, 1e-2, 50, checkpoint=checkpoint)
        return jnp.sum((states.positions[-1] - model.rest) ** 2)

    values = (params.young, params.poisson, params.damping)
    forward, gradient = jax.jit(loss), jax.jit(jax.value_and_grad(loss))
    return lambda: forward(values), lambda: gradient(values), gradient.lower(values)


def measure(dtype, tolerance, repeats, checkpoint=None):
    forward, gradient, program = calls(dtype, tolerance, checkpoint)
    memory = program.compile().memory_analysis().temp_size_in_bytes
    forward_s, gradient_s = median_time(forward, repeats), median_time(gradient, repeats)
    return {
        "forward_s": forward_s,
        "gradient_s": gradient_s,
        "ratio": gradient_s / forward_s,
        "temporary_mb": memory / 1e6,
    }


def main():
    options = arguments(__doc__)
    repeats = 2 if options.quick else 7
    figures = {"machine": describe(), **measure(jnp.float64, 1e-6, repeats)}
    figures["float32"] = measure(jnp.float32, 1e-5, repeats)
    figures["checkpoint_10"] = measure(jnp.float64, 1e-6, repeats, 10)
    finish("gradient", figures, options.out)


if __name__ == "__main__":
    main()
