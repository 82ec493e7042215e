"""What does an accelerator bring?  python benchmarks/accelerator.py [--quick] [--out FOLDER]

On the default device, and on the same machine's processor (all of its cores) beside it, by the clock. `sweeps`: clamped
beams of 192, 576 and 2304 tetrahedra under their weight, E over a factor of 100, 20 steps of 10 ms, many in one chunk,
by each engine: microseconds a variant and step. Error: largest difference of a final position from `jf.rollout` on the
processor in float64 at tolerance 1e-11, as a share of how far that variant moved, over 8 of them. `slopes`: with the
derivative of all positions in E. `steps`: swinging cubes of 1e3 to 3e5 tetrahedra at 1e-4, milliseconds a step.
"""

import time

import jax
import numpy as np
import scenes
from machine import describe, median_time
from report import arguments, finish, line_plot, save

import jaxfem as jf
from jaxfem import sweeping

SIZES = {"192": (4, 2, 2), "576": (12, 2, 2), "2304": (12, 4, 4)}
COUNTS = {"192": (64, 1024, 16384), "576": (64, 1024, 6144), "2304": (64, 1024)}
CUBES = (6, 10, 16, 25, 39)
DT, STEPS = 1e-2, 20
EXACT = np.geomspace(2.6e4, 2.6e6, 8)
ON_PROCESSOR = 64  # variants there
SIDE_BY_SIDE = {"192": 1024, "576": 1024, "2304": 256}  # variants of `vmap`


def beam(cells, dtype, **options):
    mesh = jf.mesh.box((0.1, 0.03, 0.03), cells, tets_per_cell=12)
    body = jf.SoftBody(mesh, young=2.6e5, poisson=0.4, density=1070.0, damping=2e-3, fixed="x-")
    return jf.build(jf.Scene([body]), dtype=dtype, **options)


def exact(cells):
    """Final positions of the variants `EXACT` (8, n, 3), and how far each moved at most."""
    model, params, state = beam(cells, np.float64, tolerance=1e-11)
    run = jax.jit(lambda value: jf.rollout(model, params.replace(young=value), state, DT, STEPS, every=STEPS))
    ends = np.stack([np.asarray(run(value)[0].positions[-1]) for value in EXACT])
    return ends, np.abs(ends - np.asarray(model.rest)).max((1, 2))


def swept(cells, dtype, count, engine, reference, repeats, slopes=()) -> dict:
    """Time of one chunk of `count` variants, how many failed, and the error of those that `reference` knows."""
    parts = beam(cells, dtype)
    young = np.concatenate([EXACT, np.geomspace(EXACT[0], EXACT[-1], count - len(EXACT))])
    options = {"outputs": {"end": lambda run: run.last.positions}, "engine": engine, "width": count}
    options |= {"derivatives": slopes, "devices": list(parts[0].rest.devices())}
    begun = time.perf_counter()
    made = sweeping.Sweep(*parts, {"young": young}, dt=DT, steps=STEPS, every=STEPS, **options)
    found, told = made.run(0)
    first = time.perf_counter() - begun
    seconds, (ends, moved) = median_time(lambda: made.run(0), repeats), reference
    return {
        "us_per_scene_step": 1e6 * seconds / count / STEPS,
        "first_call_s": first,
        "failed": int((told["status"] != 0).sum()),
        "error": float((np.abs(found["end"][: len(EXACT)] - ends).max((1, 2)) / moved).max()),
    }


def stepped(cells, dtype, steps, repeats) -> dict:
    model, params, state = scenes.cube(cells, dtype, 1e-4)
    ready = jf.prepare(model, params, state, 1 / 60)
    advance = jax.jit(lambda ready, state: jf.rollout(ready, params, state, 1 / 60, steps))
    begun = time.perf_counter()
    _, info = jax.block_until_ready(advance(ready, state))
    first = time.perf_counter() - begun
    seconds = median_time(lambda: advance(ready, state), repeats)
    figures = {"ms_per_step": 1e3 * seconds / steps, "iterations": float(info.iterations.mean()), "first_call_s": first}
    return figures | {"status": int(info.status.max()), "elements": model.elements.count, "method": model.method.name}


def plot(figures, places, folder):
    """A line a precision and place: milliseconds a step against elements."""
    lines = {}
    for bits in ("float32", "float64"):
        for where in places:
            rows = [
                each for key, each in figures.items() if key.startswith("steps ") and key.endswith(f"{bits} {where}")
            ]
            lines[f"{bits}, {where}"] = [each["elements"] for each in rows], [each["ms_per_step"] for each in rows]
    line_plot(folder / "accelerator.png", lines, "elements", "ms a step")


def main():
    options = arguments(__doc__)
    jax.config.update("jax_enable_x64", True)
    processor, repeats = jax.devices("cpu")[0], 1 if options.quick else 3
    places = {jax.default_backend(): None, "processor": processor}
    figures = {"machine": describe(), "device": jax.devices()[0].device_kind, "steps": STEPS, "dt": DT}

    def note(key, call, *given, place=None, **more):
        with jax.default_device(place):
            figures[key] = call(*given, **more)
        print(
            key,
            {name: float(f"{v:.3g}") if isinstance(v, float) else v for name, v in figures[key].items()},
            flush=True,
        )
        save("accelerator", figures, options.out)

    for cells in CUBES[: 2 if options.quick else None]:
        for bits in ("float32", "float64"):
            for where, place in places.items():
                note(f"steps {cells} {bits} {where}", stepped, cells, np.dtype(bits), 4, repeats, place=place)
    sizes = ["192"] if options.quick else list(SIZES)
    with jax.default_device(processor):
        references = {size: exact(SIZES[size]) for size in sizes}
    for size in sizes:
        for bits in ("float32", "float64"):
            for where, place in places.items():
                wide = [("lanes", count) for count in COUNTS[size]] + [("vmap", SIDE_BY_SIDE[size])]
                for engine, count in [("lanes", ON_PROCESSOR)] if place else wide:
                    given = SIZES[size], np.dtype(bits), count, engine, references[size], repeats
                    note(f"sweeps {size} {bits} {where} {engine} {count}", swept, *given, place=place)
            given = SIZES[size], np.dtype(bits), 1024, "lanes", references[size], repeats
            note(f"slopes {size} {bits} lanes 1024", swept, *given, slopes=("young",))
    if options.out:
        plot(figures, places, options.out)
    finish("accelerator", figures, options.out)


if __name__ == "__main__":
    main()
