"""How does the cost grow with the mesh?  python benchmarks/scaling.py [--quick] [--out FOLDER]

Swinging cubes of 1e3 to 3e5 elements, the same material and size, relative residual 1e-4, float32: iterations, time a
step and an element, seconds to build and to compile, temporary memory of a step.
"""

import time

import jax
import jax.numpy as jnp
import scenes
from machine import describe, median_time
from report import arguments, finish, line_plot

import jaxfem as jf

DT = 1 / 60


def measure(cells: int, steps: int, repeats: int) -> dict:
    begun = time.perf_counter()
    model, params, state = scenes.cube(cells, jnp.float32, 1e-4)
    build_s = time.perf_counter() - begun
    begun = time.perf_counter()
    advance = jax.jit(lambda m, s: jf.rollout(m, params, s, DT, steps))
    compiled = advance.lower(model, state).compile()
    compile_s = time.perf_counter() - begun
    begun = time.perf_counter()
    ready = jax.block_until_ready(jf.prepare(model, params, state, DT))
    prepare_s = time.perf_counter() - begun
    advance = jax.jit(lambda m, s: jf.rollout(m, params, s, DT, steps))
    seconds = median_time(lambda: advance(ready, state), repeats)
    _, info = advance(ready, state)
    elements = model.elements.count
    return {
        "elements": elements,
        "nodes": model.nodes,
        "iterations": float(jnp.mean(info.iterations)),
        "status": int(info.status.max()),
        "ms_per_step": 1e3 * seconds / steps,
        "us_per_element": 1e6 * seconds / steps / elements,
        "build_s": build_s,
        "compile_s": compile_s,
        "prepare_first_call_s": prepare_s,
        "temporary_mb": compiled.memory_analysis().temp_size_in_bytes / 1e6,
    }


def main():
    options = arguments(__doc__)
    sizes = (6, 10, 16) if options.quick else (6, 10, 16, 25, 34, 39)
    rows = [measure(cells, 4, 1 if options.quick else 3) for cells in sizes]
    for row in rows:
        print("  ".join(f"{name} {value:.4g}" for name, value in row.items()), flush=True)
    figures = {"machine": describe(), "sizes": rows}
    if not options.quick:
        figures["cost_per_element_200k_over_20k"] = rows[4]["us_per_element"] / rows[2]["us_per_element"]
    if options.out:
        x = [row["elements"] for row in rows]
        lines = {"microseconds an element": (x, [row["us_per_element"] for row in rows])}
        lines["iterations"] = (x, [row["iterations"] for row in rows])
        line_plot(options.out / "scaling.png", lines, "elements", "a step")
    finish("scaling", figures, options.out)


if __name__ == "__main__":
    main()
