"""Small scenes that several tests build, runs of them by few programs, and outside values to compare with."""

import json
import pathlib
from typing import Any

import jax
import numpy as np

import jaxfem as jf

CHUNK = 10  # steps; runs of any multiple of it share a program


def beam(cells=(4, 2, 2), size=(0.1, 0.03, 0.03), fixed="x-", gravity=(0.0, 0.0, -9.81), build=None, **material):
    """(model, params, state) of a clamped soft beam; `build` holds keyword arguments of `jf.build`."""
    values = {"young": 2.6e5, "poisson": 0.4, "density": 1070.0, "damping": 2e-3, **material}
    body = jf.SoftBody(jf.mesh.box(size, cells), fixed=fixed, name="beam", **values)
    return jf.build(jf.Scene([body], gravity=gravity), **(build or {}))


def rolled(model, params, state, dt, steps, chunk=CHUNK):
    """What `jf.rollout` gives, (states, infos) as NumPy arrays, `chunk` steps at a time: one program for all lengths.

    A program is compiled for each number of steps, and most of a test's time is compiling.
    """
    assert steps % chunk == 0, f"{steps} steps are no multiple of {chunk}"
    parts = []
    for _ in range(steps // chunk):
        parts.append(jax.tree.map(np.asarray, jf.rollout(model, params, state, dt, chunk)))
        state = jax.tree.map(lambda leaf: leaf[-1], parts[-1][0])
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)


def rolled_fast(model, params, state, dt, steps, every):
    """What `jf.rollout` gives, by code that runs a few times as fast as that of other tests, and compiles slower."""
    program = jax.jit(lambda *scene: jf.rollout(*scene, dt, steps, every=every)).lower(model, params, state)
    return program.compile(compiler_options={"xla_backend_optimization_level": 2})(model, params, state)


def outside(name: str) -> dict[str, Any]:
    """Values that others computed, from tests/references; each entry says what it is about."""
    return json.loads((pathlib.Path(__file__).parent / "references" / f"{name}.json").read_text())


def random_rotation(seed: int) -> np.ndarray:
    """A proper rotation, uniformly drawn."""
    q, r = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))
