"""What do the gradients of a sweep cost, are they right?  python benchmarks/sweep_gradients.py [--quick] [--out FOLDER]

1000 clamped beams under their weight, of 48 tetrahedra and of 192: Young's modulus over a factor of 100, Poisson's
ratio, density and damping, drawn at random; 20 steps of 10 ms. The gradient of the height of the tip in all four, and
its derivative in the first alone, from one `jf.sweep`, beside as many calls of a compiled `jax.grad`, and `jax.jvp`, of
`jf.rollout`. Processor time of one thread; errors are
the largest difference of a derivative from the single one in float64, as a share of the largest of that variable;
`unsolved`: gradients that are NaN, because a solve did not reach the tolerance.
"""

import os

os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
import time

import jax
import jax.numpy as jnp
import numpy as np
from machine import describe
from report import arguments, finish, save

import jaxfem as jf
from jaxfem import sweeping

SIZES = {"48": (4, 1, 1), "192": (4, 2, 2)}
DT, STEPS, TOLERANCE = 1e-2, 20, {"float32": 1e-6, "float64": 1e-10}
FIRST = "young"
RANGES = {"young": (2.6e4, 2.6e6, "log"), "poisson": (0.2, 0.45), "density": (8e2, 1.4e3), "damping": (1e-3, 4e-3)}


def scene(size, dtype):
    mesh = jf.mesh.box((0.1, 0.03, 0.03), SIZES[size], tets_per_cell=12)
    body = jf.SoftBody(mesh, young=2.6e5, poisson=0.4, density=1070.0, damping=2e-3, fixed="x-")
    return jf.build(jf.Scene([body], gravity=(0, 0, -9.81)), dtype=dtype, tolerance=TOLERANCE[np.dtype(dtype).name])


def timed(run):
    """Seconds of processor time, the best of two behind one that compiles, and what was found."""
    found, times = run(), []
    for _ in range(2):
        start = time.process_time()
        found = run()
        times.append(time.process_time() - start)
    return min(times), found


def batch(parts, variants, names):
    """Function that runs the sweep, with derivatives in `names`: (V, names), or None."""
    outputs = {"tip": lambda run: run.last.positions[-1, 2]}
    options = {"dt": DT, "steps": STEPS, "every": STEPS, "outputs": outputs, "derivatives": names}
    made = sweeping.Sweep(*parts, variants, **options)
    assert made.engine.name == "lanes"

    def run():
        found = [made.run(chunk) for chunk in range(made.chunks)]
        back = np.argsort(np.concatenate([made.members(chunk) for chunk in range(made.chunks)]))
        each = [np.concatenate([outputs[f"d(tip)/d({name})"] for outputs, _ in found])[back] for name in names]
        return np.stack(each, 1) if names else None

    return run


def singles(parts, variants, forwards):
    """Function that finds the gradients (V, 4) one by one, or `forwards` the derivatives in the first name (V, 1)."""
    model, params, state = parts

    @jax.jit
    def slope(values):
        def tip(values):
            own = params.replace(constants={**params.constants, **values})
            return jf.rollout(model, own, state, DT, STEPS, every=STEPS)[0].positions[-1, -1, 2]

        if not forwards:
            return list(jax.grad(tip)(values).values())
        unit = {name: jnp.full_like(value, name == FIRST) for name, value in values.items()}
        return [jax.jvp(tip, (values,), (unit,))[1]]

    def run():
        rows = []
        for number in range(len(variants[FIRST])):
            values = {name: jnp.asarray(each[number], model.rest.dtype) for name, each in variants.items()}
            rows.append([float(each) for each in slope(values)])
        return np.array(rows)

    return run


def compared(parts, variants, names, exact, plain) -> tuple[dict, np.ndarray]:
    """Figures of derivatives in `names`, and those found one by one; `exact`: as these in float64, None there."""
    alone, single = timed(singles(parts, variants, names == [FIRST]))
    slopes, found = timed(batch(parts, variants, names))
    exact = single if exact is None else exact
    share = np.abs(exact).max(0)
    return {
        "batch_s": plain,
        "batch_with_derivatives_s": slopes,
        "derivatives_over_batch": (slopes - plain) / plain,
        "with_derivatives_over_batch": slopes / plain,
        "singles_s": alone,
        "singles_over_batch_with_derivatives": alone / slopes,
        "error": float(np.nanmax(np.abs(found - exact) / share)),
        "error_of_singles": float(np.nanmax(np.abs(single - exact) / share)),
        "unsolved": int(np.isnan(found).any(1).sum()),
        "unsolved_singles": int(np.isnan(single).any(1).sum()),
    }, single


def main():
    options = arguments(__doc__)
    jax.config.update("jax_enable_x64", True)
    count, sizes = (64, ["48"]) if options.quick else (1000, list(SIZES))
    variants = sweeping.random(RANGES, count=count, seed=1)
    names = sorted(RANGES)
    variants = {name: np.asarray(variants[name]) for name in names}
    figures = {"machine": describe(), "variants": count, "steps": STEPS, "dt": DT, "in": names}
    for size in sizes:
        exact = {}
        for bits in ("float64", "float32"):
            parts = scene(size, np.dtype(bits))
            plain, _ = timed(batch(parts, variants, []))
            for word, own in (("forwards", [FIRST]), ("backwards", names)):
                key = f"{size} {bits} {word}"
                figures[key], single = compared(parts, variants, own, exact.get(word), plain)
                exact.setdefault(word, single)
                print(key, figures[key], flush=True)
                save("sweep_gradients", figures, options.out)
    finish("sweep_gradients", figures, options.out)


if __name__ == "__main__":
    main()
