"""The stretch without its rotation: that of the nearest rotation, with its derivative, also where no root is had."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.elements.domains import domain_strains
from jaxfem.elements.stretch import domain_stretches, stretch_strain
from jaxfem.elements.tetra import rotated_strain
from jaxfem.rotation import nearest_rotation
from jaxfem.tensors import matrix_of

DRAWS = np.random.default_rng(3).standard_normal((2, 40, 3, 3))
TURNS = np.asarray(nearest_rotation(DRAWS[0]))


def deformations(size, dtype="float64"):
    """Turned anyhow and strained by about `size`, (3, 3, 40)."""
    strain = 0.5 * size * (DRAWS[1] + DRAWS[1].swapaxes(1, 2)) / np.linalg.norm(DRAWS[1], axis=(1, 2))[:, None, None]
    return jnp.asarray(np.moveaxis(TURNS @ (np.eye(3) + strain), 0, -1), dtype)


@jax.jit
def by_root(f):
    return stretch_strain(matrix_of(f))


@jax.jit
def by_rotation(f):
    turn = nearest_rotation(jnp.moveaxis(f, -1, 0))
    return jnp.stack(rotated_strain(matrix_of(f), matrix_of(jnp.moveaxis(turn, 0, -1))))


@pytest.mark.parametrize(("size", "dtype"), [(1e-9, "float64"), (0.3, "float64"), (1.5, "float64"), (0.3, "float32")])
def test_it_is_that_of_the_nearest_rotation(size, dtype):
    """Small strains, large ones, and such that some domains are inside out; so are the derivatives, both ways."""
    f, way = deformations(size, dtype), jnp.asarray(np.moveaxis(DRAWS[0], 0, -1), dtype)
    digits = 40 * float(jnp.finfo(dtype).eps)
    np.testing.assert_allclose(by_root(f), by_rotation(f), atol=digits)
    inside_out = int(jnp.sum(jnp.linalg.det(jnp.moveaxis(f, -1, 0)) < 0))
    assert (inside_out > 0) == (size > 1)
    if inside_out:
        return  # derivatives are those of the nearest rotation, which has tests of its own
    slopes = [jax.jvp(each, (f,), (way,))[1] for each in (by_root, by_rotation)]
    np.testing.assert_allclose(*slopes, atol=30 * digits)
    pulls = [jax.vjp(each, f)[1](slopes[0])[0] for each in (by_root, by_rotation)]
    np.testing.assert_allclose(*pulls, atol=100 * digits)


def test_domains_of_every_kind_have_the_same_strains():
    mesh = jf.mesh.box((0.1, 0.05, 0.05), (2, 1, 1))
    body = jf.SoftBody(mesh, young=1e5, poisson=0.45, density=1e3, strain="smoothed")
    model, _, state = jf.build(jf.Scene([body]))
    places = state.positions + 0.01 * jnp.sin(40 * state.positions[:, ::-1])
    for found, (wanted, _, _) in zip(
        domain_stretches(model.domains, places), domain_strains(model.domains, places), strict=True
    ):
        np.testing.assert_allclose(found, jnp.stack(wanted), atol=1e-14)
