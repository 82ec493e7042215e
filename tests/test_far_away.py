"""A body so far from the origin that single precision does not tell its places is named by `build`."""

import warnings

import jax.numpy as jnp
import pytest

import jaxfem as jf


@pytest.mark.parametrize(
    ("far", "dtype", "told"), [(1e5, "float32", True), (1e2, "float32", False), (1e5, "float64", False)]
)
def test_places_that_are_rounded_are_told(far, dtype, told):
    ball = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(0, far, 0), name="ball")
    mesh = jf.mesh.box((0.1,) * 3, 1, origin=(0, 0, far))
    cube = jf.SoftBody(mesh, 1e5, 0.3, 1e3, name="cube")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        jf.build(jf.Scene([ball, cube]), dtype=jnp.dtype(dtype))
    words = [str(each.message) for each in caught if issubclass(each.category, jf.AccuracyWarning)]
    assert sorted(word.split(chr(34))[1] for word in words) == (["ball", "cube"] if told else [])
    if told:
        assert "double precision" in words[0]
