"""Small scenes that several tests build."""

import numpy as np

import jaxfem as jf


def beam(cells=(4, 2, 2), size=(0.1, 0.03, 0.03), fixed="x-", gravity=(0.0, 0.0, -9.81), build=None, **material):
    """(model, params, state) of a clamped soft beam; `build` holds keyword arguments of `jf.build`."""
    values = {"young": 2.6e5, "poisson": 0.4, "density": 1070.0, "damping": 2e-3, **material}
    body = jf.SoftBody(jf.mesh.box(size, cells), fixed=fixed, name="beam", **values)
    return jf.build(jf.Scene([body], gravity=gravity), **(build or {}))


def random_rotation(seed: int) -> np.ndarray:
    """A proper rotation, uniformly drawn."""
    q, r = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))
