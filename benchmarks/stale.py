"""Does the preconditioner get stale?  python benchmarks/stale.py [--quick] [--out FOLDER]

A soft beam falls from rest under its own weight until it hangs down, float64 to 1e-6. Conjugate gradient iterations of
each step with the preconditioner that `prepare` made at the start and that only turns along with the node groups,
beside those with one made anew for each step.
"""

import jax
import numpy as np
from machine import describe
from report import arguments, finish

jax.config.update("jax_enable_x64", True)

import jaxfem as jf  # noqa: E402

DT = 1e-2
CASES = {"element_nu_0.4": ("element", 0.4, 2e4), "smoothed_nu_0.499": ("smoothed", 0.499, 2e4)}


def compare(strain, poisson, young, cells, steps):
    mesh = jf.mesh.box((0.1, 0.03, 0.03), cells)
    body = jf.SoftBody(mesh, young, poisson, 1070.0, damping=2e-3, fixed="x-", strain=strain)
    model, params, state = jf.build(jf.Scene([body]), tolerance=1e-6)
    kept = jf.prepare(model, params, state, DT)
    iterations = []
    for _ in range(steps):
        _, anew = jf.step(model, params, state, DT)
        state, old = jf.step(kept, params, state, DT)
        iterations.append((int(old.iterations), int(anew.iterations)))
    old, anew = np.array(iterations).T
    sag = float(model.rest[:, 2].mean() - state.positions[:, 2].mean())
    return {
        "kept": {"mean": float(old.mean()), "most": int(old.max())},
        "anew": {"mean": float(anew.mean()), "most": int(anew.max())},
        "worst_ratio": float((old / anew).max()),
        "largest_displacement": float(np.abs(state.positions - model.rest).max()),
        "mean_sag": sag,
    }


def main():
    options = arguments(__doc__)
    cells, steps = ((5, 2, 2), 20) if options.quick else ((10, 3, 3), 100)
    figures = {"machine": describe(), "cells": cells, "steps": steps}
    figures |= {name: compare(*case, cells, steps) for name, case in CASES.items()}
    finish("stale", figures, options.out)


if __name__ == "__main__":
    main()
