"""Do iterations depend on stiffness and step?  python benchmarks/stiffness.py [--quick] [--out FOLDER]

The brick at E from 1e4 to 1e10 Pa and three time steps, relative residual 1e-4 in float64: mean iterations a step over
ten steps, beside those with the coarse space left out.
"""

import jax
from machine import describe
from report import arguments, finish, line_plot

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import scenes  # noqa: E402

import jaxfem as jf  # noqa: E402

STEPS = 10


def main():
    options = arguments(__doc__)
    model, params, state = scenes.brick(jnp.float64)
    young = (1e4, 1e7, 1e10) if options.quick else (1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10)
    table, plain = {}, []
    for dt in (1e-3, 1 / 60, 0.1):
        counts = []
        for value in young:
            own = params.replace(young=value)
            _, info = jf.rollout(model, own, state, dt, STEPS)
            assert int(info.status.max()) == 0
            counts.append(float(jnp.mean(info.iterations)))
            if dt == 1 / 60:
                alone = model.replace(cache=jnp.zeros_like(jf.prepare(model, own, state, dt).cache))
                plain.append(float(jnp.mean(jf.rollout(alone, own, state, dt, STEPS)[1].iterations)))
        table[f"{dt:.4g}"] = counts
        print(
            f"dt {dt:.4g} s: " + "  ".join(f"{e:g} Pa {n:.1f}" for e, n in zip(young, counts, strict=True)), flush=True
        )
    everything = [n for counts in table.values() for n in counts]
    figures = {"machine": describe(), "young": young, "iterations": table, "block_jacobi_alone_1_60": plain}
    figures["largest_over_smallest"] = max(everything) / min(everything)
    figures["largest_over_smallest_at_1_60"] = max(table["0.01667"]) / min(table["0.01667"])
    if options.out:
        lines = {f"dt = {dt} s": (young, counts) for dt, counts in table.items()}
        lines["dt = 0.01667 s, no coarse space"] = (young, plain)
        line_plot(options.out / "stiffness.png", lines, "Young's modulus (Pa)", "iterations a step")
    finish("stiffness", figures, options.out)


if __name__ == "__main__":
    main()
