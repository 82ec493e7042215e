"""What does a law with a memory cost a step?  python benchmarks/memory.py [--quick] [--out FOLDER]

The same beam of each law and kind of strain, float64, tolerance 1e-6: milliseconds a step, as the median of interleaved
rollouts, and how much more that is than the linear law; iterations a step. A Prony series of two branches may cost 5 %.
"""

import time

import jax
import numpy as np
from machine import describe
from report import arguments, finish

jax.config.update("jax_enable_x64", True)

import jaxfem as jf  # noqa: E402

ELASTIC = {"young": 2.6e5, "poisson": 0.4, "damping": 2e-3}
LAWS = {
    "linear": jf.Linear(**ELASTIC),
    "2 branches": jf.Viscoelastic(**ELASTIC, branches=[(0.1, 0.05), (0.1, 0.005)]),
    "creep": jf.CreepPlastic(**ELASTIC, yield_strain=0.01, creep=5.0),
}
DT = 5e-3


def scene_of(law, strain, scheme, cells):
    """A clamped beam of the law, prepared."""
    mesh = jf.mesh.box((0.1, 0.03, 0.03), cells)
    body = jf.SoftBody(mesh, density=1070.0, material=law, fixed="x-", strain=strain)
    model, params, state = jf.build(jf.Scene([body]), scheme=scheme, tolerance=1e-6)
    return jf.prepare(model, params, state, DT), params, state


def measure(strain, scheme, cells, rounds, steps):
    """Law -> milliseconds a step and iterations, on one kind of strain."""
    scenes = {name: scene_of(law, strain, scheme, cells) for name, law in LAWS.items()}
    taken, iterations = {name: [] for name in LAWS}, {}
    for number in range(rounds + 1):  # the first compiles
        for name, scene in scenes.items():
            begun = time.perf_counter()
            _, info = jax.block_until_ready(jf.rollout(*scene, DT, steps, every=steps))
            taken[name] += [time.perf_counter() - begun] if number else []
            iterations[name] = int(info.iterations.max())
    out = {}
    for name in LAWS:
        ratios = np.array(taken[name]) / np.array(taken["linear"])
        each = 1e3 * float(np.median(taken[name])) / steps
        out[name] = {"ms": each, "more": float(np.median(ratios)) - 1, "iterations": iterations[name]}
    return out


def main():
    chosen = arguments(__doc__)
    cells, rounds = ((10, 3, 3), 5) if chosen.quick else ((20, 6, 6), 9)
    figures = {"machine": describe(), "cells": cells}
    for strain, scheme in (("element", "backward_euler"), ("smoothed", "generalized_alpha")):
        figures[f"{strain}, {scheme}"] = measure(strain, scheme, cells, rounds, 40)
    finish("memory", figures, chosen.out)


if __name__ == "__main__":
    main()
