"""The tables of sweeps in docs/evidence.md, from the figures.  python benchmarks/sweep_tables.py [FOLDER]

Prints Markdown of what sweep.py, sweep_gradients.py and sweep_others.py wrote to FOLDER, or benchmarks/results.
"""

import json
import pathlib
import sys

WAYS = {"forwards": "forwards in one constant, lanes against `jax.jvp` of rollouts"}
WAYS |= {"backwards": "backwards in four constants, lanes against `jax.grad`"}


def rounded(number):
    """Three digits, never as a power of ten."""
    return f"{float(f'{number:.3g}'):.0f}" if number >= 100 else f"{number:.3g}"


def engines(figures):
    """Time and error of each engine, size by size."""
    heads = "tetrahedra | precision | calls of `jf.rollout` | engine `vmap` | engine `lanes` | ratio to the calls"
    yield f"| {heads} | error of calls, lanes |"
    yield "| --- " * 7 + "|"
    for name, each in figures.items():
        if isinstance(each, dict):
            ways = [each[way] for way in ("unbatched", "vmap", "lanes")]
            times = " | ".join(rounded(way["us_per_scene_step"]) for way in ways)
            errors = f"{ways[0]['error']:.1e}, {ways[-1]['error']:.1e}"
            yield f"| {name.replace(' ', ' | ')} | {times} | {each['lanes_over_unbatched']:.1f} | {errors} |"


def gradients(figures):
    """Microseconds a variant and step with derivatives, beside single ones, and what they cost over the batch."""
    yield f"{figures['variants']} variants:"
    yield ""
    yield "| tetrahedra | precision | derivatives | us, one by one | faster | of the batch without | error | unsolved |"
    yield "| --- " * 8 + "|"
    share = 1e6 / figures["variants"] / figures["steps"]
    for name, each in figures.items():
        if isinstance(each, dict) and "batch_with_derivatives_s" in each:  # older figures have other names
            size, bits, way = name.split()
            times = f"{rounded(share * each['batch_with_derivatives_s'])}, {rounded(share * each['singles_s'])}"
            ratios = f"{each['singles_over_batch_with_derivatives']:.1f} | {each['with_derivatives_over_batch']:.1f}"
            yield f"| {size} | {bits} | {WAYS[way]} | {times} | {ratios} | {each['error']:.0e} | {each['unsolved']} |"


def others(figures):
    """Time and error of other simulators, and what two cores do."""
    yield "| | time | error: median, largest |"
    yield "| --- " * 3 + "|"
    for name, each in figures.items():
        if isinstance(each, dict) and "us" in each:
            yield f"| {name} | {rounded(each['us'])} | {', '.join(f'{error:.2g}' for error in each['error'])} |"
    yield ""
    for name, each in figures.items():
        if isinstance(each, dict) and "ratio" in each:
            yield f"{name}: {each['ratio']:.2f} times one (load {each['load']:.1f})"


def main():
    folder = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else pathlib.Path(__file__).with_name("results"))
    for name, table in {"sweep": engines, "sweep_gradients": gradients, "sweep_others": others}.items():
        figures = json.loads((folder / f"{name}.json").read_text())
        print("\n".join([f"{name}: {figures['machine']}", "", *table(figures), ""]))


if __name__ == "__main__":
    main()
