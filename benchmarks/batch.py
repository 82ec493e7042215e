"""Does a batch pay?  python benchmarks/batch.py [--quick] [--out FOLDER]

64 materials in one vmapped rollout, against the same one after another: a small beam of 216 elements, and the brick.
Throughput ratio: above 1 the batch is faster. On CPUs a batch solves lane by lane, on accelerators all at once, until
the slowest lane has converged.
"""

import jax
import jax.numpy as jnp
import scenes
from machine import describe, median_time
from report import arguments, finish

import jaxfem as jf


def measure(parts, dt, young, steps, repeats) -> dict:
    model, params, state = parts
    model = jf.prepare(model, params, state, dt)

    def run(value):
        states, info = jf.rollout(model, params.replace(young=value), state, dt, steps, every=steps)
        return states.positions, info.iterations

    single, together = jax.jit(run), jax.jit(jax.vmap(run))
    one_by_one = median_time(lambda: [single(value) for value in young], repeats)
    at_once = median_time(lambda: together(young), repeats)
    return {
        "elements": model.elements.count,
        "sequential_ms_per_step": 1e3 * one_by_one / steps / len(young),
        "batched_ms_per_step": 1e3 * at_once / steps / len(young),
        "throughput_ratio": one_by_one / at_once,
    }


def main():
    options = arguments(__doc__)
    lanes, repeats = (8, 1) if options.quick else (64, 3)
    young = jnp.geomspace(1e5, 1e6, lanes)
    figures = {"machine": describe(), "lanes": lanes}
    figures["small"] = measure(scenes.beam((4, 3, 3), jnp.float32, 1e-4), 1e-2, young, 10, repeats)
    figures["brick"] = measure(scenes.brick(jnp.float32), 1 / 60, 1e4 * young / 10, 4, repeats)
    finish("batch", figures, options.out)


if __name__ == "__main__":
    main()
