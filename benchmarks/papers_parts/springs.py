"""Paper B: springs do not converge to the elastic solution, finite elements do; Gram-Schmidt and polar rotations."""

import warnings

import numpy as np
from groups import least

import jaxfem as jf
from jaxfem.methods.mass_spring import MassSpring

YOUNG, SMALL = 1e5, 1e-6
SIDE = np.array([1.0, 0.5, -0.3])


def manufactured(points, poisson):
    """Displacement u = SMALL a sin(pi x) sin(pi y) sin(pi z) and the force density -div sigma that holds it."""
    lam, mu = YOUNG * poisson / ((1 + poisson) * (1 - 2 * poisson)), YOUNG / (2 * (1 + poisson))
    sin, cos = np.sin(np.pi * points), np.cos(np.pi * points)
    bump = sin.prod(1)
    second = np.zeros((len(points), 3, 3))
    for i in range(3):
        for j in range(3):
            k = 3 - i - j
            second[:, i, j] = np.pi**2 * (-bump if i == j else cos[:, i] * cos[:, j] * sin[:, k])
    force = -(lam + mu) * np.einsum("nij,j->ni", second, SIDE) + 3 * np.pi**2 * mu * bump[:, None] * SIDE
    return SMALL * bump[:, None] * SIDE, SMALL * force


def error(method, cells, poisson):
    """Relative L2 error of the nodes of a unit cube held all around; statics as one very long step."""
    mesh = jf.mesh.box((1.0, 1.0, 1.0), cells)
    held = (np.abs(mesh.points - 0.5) > 0.5 - 1e-9).any(1)
    body = jf.SoftBody(mesh, young=YOUNG, poisson=poisson, density=1.0, fixed=held)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model, params, state = jf.build(jf.Scene([body], gravity=(0, 0, 0)), solver=method, tolerance=1e-10)
    exact, density = manufactured(mesh.points, poisson)
    volumes = np.asarray(model.nodal_volumes)[:, None]
    following, info = jf.step(model, params, state, dt=1e3, forces=density * volumes)
    assert int(info.status) == 0
    off = np.asarray(following.positions) - mesh.points - exact
    return float(np.sqrt((volumes * off**2).sum() / (volumes * exact**2).sum()))


def convergence(quick):
    """Errors by cells a side, and the orders fitted to the last three."""
    counts = (4, 8, 12) if quick else (4, 6, 8, 12, 16)
    found = {"cells": counts, "errors": {}, "order": {}}
    for poisson in (0.25, 0.4):
        for name, method in {
            "finite elements": "condensed",
            "springs": MassSpring(),
            "springs, Lloyd": MassSpring(calibration="lloyd"),
        }.items():
            label = f"{name}, nu {poisson:g}"
            errors = [error(method, count, poisson) for count in counts]
            found["errors"][label] = errors
            found["order"][label] = float(-np.polyfit(np.log(counts[-3:]), np.log(errors[-3:]), 1)[0])
            print(label, errors, found["order"][label], flush=True)
    return found


def rotations(quick):
    """The beam of paper B by both rotations: sag, and time a step."""
    rows = {}
    for rotation in ("polar", "gram_schmidt"):
        for young in (2e5, 5e4):
            mesh = jf.mesh.box((0.16, 0.04, 0.04), (8, 2, 2) if quick else (16, 4, 4))
            body = jf.SoftBody(
                mesh,
                young=young,
                poisson=0.3,
                density=1e3,
                damping=5e-3,
                mass_damping=10.0,
                fixed="x-",
                rotation=rotation,
            )
            model, params, state = jf.build(jf.Scene([body]), solver="assembled")
            states, info = jf.rollout(model, params, state, 1e-2, 200, every=200)
            end = mesh.points[:, 0] > 0.16 - 1e-9
            sag = mesh.points[end, 2] - np.asarray(states.positions[-1])[end, 2]
            aside = np.asarray(states.positions[-1])[end, 1] - mesh.points[end, 1]
            seconds = least(lambda m=model, p=params, s=state: jf.rollout(m, p, s, 1e-2, 20), 3)[1]
            rows[f"{rotation}, E {young:g}"] = {
                "sag_m": float(sag.mean()),
                "aside_m": float(aside.mean()),
                "ms_per_step": 1e3 * seconds / 20,
                "speed_at_end": float(np.abs(states.velocities[-1]).max()),
                "status": int(np.asarray(info.status).max()),
            }
            print(rotation, young, rows[f"{rotation}, E {young:g}"], flush=True)
    return rows


PARTS = {"convergence": convergence, "rotations": rotations}
