"""The real beam's takes alone, together, held out.  python benchmarks/real_beam_takes.py DIR [--quick] [--out FOLDER]

DIR as for real_beam.py. E and damping, each take with a delay of its own: from gravity.csv, from load52.csv, from both
together, each time with load101.csv held out, predicted and scored: share of its samples in their 95 % band, misfit
beside the markers' own scatter; and from load101.csv. The hanging weight is part of the body: the cells at its end are
as much denser as its moment about the clamp asks for, so that it pulls and has its inertia (a twentieth nearer to the
clamp). Do the takes agree, each alone, on what they share?
"""

import argparse
import dataclasses
import pathlib

import jax
import numpy as np
from machine import describe
from real_beam import PLACES, beam, recording_of, weight_of
from report import finish, save

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402

import jaxfem as jf  # noqa: E402
from jaxfem.fitting import Search, Take, attach  # noqa: E402
from jaxfem.fitting.agreement import agreement  # noqa: E402

GRAVITY, LENGTH, DENSITY = 9.81, 0.1, 1070.0
START = {"young": 2.6e5, "damping": 2.5e-3}
TAKES = ("gravity", "load52", "load101")
HELD = "load101"


def take_of(folder, name, scene, markers, cells):
    """A take whose weight, if any, is in the density of the cells at the end."""
    model, params, state = scene
    middles = np.asarray(model.rest)[np.asarray(model.elements.cells)].mean(axis=1)[:, 0]
    volumes = np.asarray(model.elements.volumes)
    end = middles > -LENGTH / cells[0]
    arm = float((volumes * (LENGTH + middles))[end].sum() / volumes[end].sum())
    mass = 0.0 if name == "gravity" else weight_of(name) / GRAVITY * LENGTH / arm
    density = jnp.asarray(np.where(end, DENSITY + mass / volumes[end].sum(), DENSITY))
    start = params.replace(density=density, **START)
    recording = recording_of(folder, name)
    return Take(model, start, state, recording, markers, 1e-2, frame="rest", end="settled", name=name)


def told(result):
    """Values, bars and how each take is told."""
    takes = {
        take.name: {
            "held_out": take.held_out,
            "residual_mm": 1e3 * take.noise,
            "scatter_mm": 1e3 * take.scatter,
            "share_in_95_percent_band": take.covered,
        }
        for take in result.takes
    }
    shared = {name: result.values[name] for name in START}
    bars = {f"{name}_error": result.standard_errors[name] for name in START}
    return {**shared, **bars, "young_interval": result.intervals["young"], "takes": takes, "status": result.status}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=pathlib.Path, help="folder with gravity.csv, load52.csv and load101.csv")
    parser.add_argument("--quick", action="store_true", help="a coarse mesh")
    parser.add_argument("--out", type=pathlib.Path, help="folder for real_beam_takes.json")
    chosen = parser.parse_args()
    cells = (6, 2, 2) if chosen.quick else (10, 3, 3)
    scene = beam(cells)
    markers = attach(scene[0], PLACES)
    takes = {name: take_of(chosen.folder, name, scene, markers, cells) for name in TAKES}
    figures = {"machine": describe(), "cells": cells}
    settings = {
        "parameters": ("young", "damping", "delay"),
        "search": Search(candidates=1, polish=12, tol=1e-4),
        "bounds": {"young": (0.6 * START["young"], 1.6 * START["young"])},
        "checks": "warn",
    }
    for names in (("gravity",), ("load52",), ("load101",), ("gravity", "load52")):
        out = () if HELD in names else (HELD,)
        result = jf.fit_takes([takes[name] for name in (*names, *out)], held_out=out, **settings)
        figures[" and ".join(names)] = told(result)
        print(result.summary(), flush=True)
        save("real_beam_takes", figures, chosen.out)
    alone = [
        agreement(word, *({name: figures[name][key] for name in TAKES} for key in (word, f"{word}_error")))
        for word in START
    ]
    figures["alone"] = [dataclasses.asdict(each) for each in alone]
    print("\n".join(each.line() for each in alone), flush=True)
    finish("real_beam_takes", figures, chosen.out)


if __name__ == "__main__":
    main()
