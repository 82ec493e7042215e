"""Elastica: are large rotations right?  python benchmarks/elastica.py [--quick] [--out FOLDER]

A 20:1 beam (length 1 m, square section, EI = 1 N m^2, nu 0.3) bent by a dead load at its tip, P L^2/EI = 0.5, 2, 10, or
by its own weight, w L^3/EI = 1, 10, against the inextensible elastica (values by quadrature and shooting). Mesh: 60x3x3
cells of 12 tetrahedra (--quick: 40x2x2). Error: distance of the tip from its place in the plane of bending, over the
length of its path; `sideways`: its drift out of that plane, likewise; only the mesh makes it.
A beam of finite thickness also shears: at 20:1 that moves the tip by 0.2 %.
"""

import jax
import numpy as np
from machine import describe, median_time
from report import arguments, finish

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402

import jaxfem as jf  # noqa: E402

STRAINS = ("smoothed", "nodal_volume", "element")
THICKNESS = 0.05
# (tip load, own weight): where the tip goes, along and down
TIPS = {
    "tip_load_0.5": ((0.5, 0), (0.9840810, 0.1621436)),
    "tip_load_2": ((2.0, 0), (0.8393583, 0.4934575)),
    "tip_load_10": ((10.0, 0), (0.4450044, 0.8106090)),
    "own_weight_1": ((0, 1.0), (0.9912464, 0.1234714)),
    "own_weight_10": ((0, 10.0), (0.6563538, 0.7001997)),
}


def strip(strain, cells=(60, 3, 3), tets_per_cell=12):
    """(model, params, state) of the beam, with density 1 and a traction at its tip still to be set."""
    h = THICKNESS
    mesh = jf.mesh.box((1.0, h, h), cells, tets_per_cell=tets_per_cell)
    load = jf.Traction("x+", (0.0, 0.0, 0.0))
    body = jf.SoftBody(mesh, 12 / h**4, 0.3, 1.0, fixed="x-", loads=[load], strain=strain)
    return jf.build(jf.Scene([body]))


def loaded(params, tip_load, own_weight):
    """params with the load of one case [N, N/m]."""
    area, down = THICKNESS**2, jnp.array([0.0, 0.0, -1.0])
    return params.replace(loads=(tip_load / area * down,), gravity=own_weight / area * down)


def tip_error(model, positions, expected):
    """Distance of the end face's middle from its place in the plane, over its displacement; its place; its drift."""
    tip = np.asarray(positions)[np.asarray(model.rest)[:, 0] > 1 - 1e-9].mean(0)
    middle = THICKNESS / 2
    found = np.array([tip[0] - 1, middle - tip[2]])
    wanted = np.array([expected[0] - 1, expected[1]])
    path = np.linalg.norm(wanted)
    place = [float(1 + found[0]), float(found[1])]
    return float(np.linalg.norm(found - wanted) / path), place, float(abs(tip[1] - middle) / path)


def measure(strain, cells, repeats):
    model, params, state = strip(strain, cells)
    cases = {}
    for name, (load, expected) in TIPS.items():
        own = loaded(params, *load)
        rest, info = jf.equilibrium(model, own, state)
        error, tip, sideways = tip_error(model, rest.positions, expected)
        seconds = median_time(lambda own=own: jf.equilibrium(model, own, state), repeats)
        cases[name] = {"error": error, "tip": tip, "sideways": sideways, "status": int(info.status), "seconds": seconds}
    return {"worst_error": max(c["error"] for c in cases.values()), "tets": model.elements.count, "cases": cases}


def main():
    options = arguments(__doc__)
    cells, repeats = ((40, 2, 2), 1) if options.quick else ((60, 3, 3), 3)
    figures = {"machine": describe(), "cells": cells, "tets_per_cell": 12}
    figures |= {strain: measure(strain, cells, repeats) for strain in STRAINS}
    finish("elastica", figures, options.out)


if __name__ == "__main__":
    main()
