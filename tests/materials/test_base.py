"""Laws and constants as objects: known by class and options, refused by name; params hold constants as attributes."""

import copy
import pickle
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.materials.base import LAWS
from jaxfem.materials.constants import Identity, Logarithm, Logistic, Signed
from jaxfem.materials.linear import DAMPING, POISSON, YOUNG
from jaxfem.materials.moduli import eigenstiffness, ratio_and_modulus


class Branches(jf.Material):
    """A law in variants; without a word, so that scene files do not know it."""

    constants = (YOUNG,)
    options: ClassVar = {"count": 1, "whole": False}


def test_a_law_is_known_by_its_class_and_options():
    one, other = jf.Linear(young=1e5, poisson=0.3), jf.Linear(2e5, 0.4, 1e-3)
    assert one.law == other.law and hash(one.law) == hash(other.law) and one not in (other, Branches(young=1e5))
    assert one.values == {"young": 1e5, "poisson": 0.3, "damping": 0.0} and one.law.values == {}
    two = Branches(young=1e5, count=2)
    assert (two.count, two.whole, two.law.count) == (2, False, 2)
    assert two != Branches(young=1e5) and two == pickle.loads(pickle.dumps(two)) == copy.deepcopy(two)
    assert repr(two) == "Branches(count=2, whole=False, young=100000.0)"
    assert LAWS["linear"].made is jf.Linear and Branches not in LAWS.classes()
    with pytest.raises(AttributeError, match="a material does not change"):
        one.values = {}


def test_what_a_law_lacks_is_named():
    with pytest.raises(jf.MaterialError, match="Linear needs poisson, its Poisson's ratio"):
        jf.Linear(young=1e5)
    with pytest.raises(jf.MaterialError, match="Branches has no constant 'poisson'; it has young, count, whole"):
        Branches(young=1e5, poisson=0.3)
    with pytest.raises(NotImplementedError, match="Branches does not say its stiffness"):
        Branches(young=1e5).stiffness({})
    with pytest.raises(TypeError, match="must be a plain Python name"):
        jf.Constant("shear modulus", "Pa", "must be > 0")


def test_bodies_say_what_they_are_made_of_once():
    mesh = jf.mesh.box((1, 1, 1), 1, name="block")
    plain = jf.SoftBody(mesh, 1e5, 0.3, 1e3, 1e-3)
    assert plain.made_of.values == {"young": 1e5, "poisson": 0.3, "damping": 1e-3}
    wrong = [
        ({"young": 1e5, "density": 1e3}, '"block": Linear needs poisson'),
        ({"young": 1e5, "poisson": 0.3}, 'density of "block" is missing: give it in kg/m\\^3'),
        ({"material": jf.Linear(1e5, 0.3), "density": 1e3, "damping": 0.1}, '"block" has a material and damping'),
        ({"material": "linear", "density": 1e3}, "material of \"block\" is 'linear'; give a law with its values"),
        ({"material": jf.Linear(1e5, 0.6), "density": 1e3}, 'poisson of "block" is 0.6'),
    ]
    for values, text in wrong:
        with pytest.raises(jf.MaterialError, match=text):
            jf.SoftBody(mesh, **values)


def test_moduli_and_back():
    for young, poisson in ((2e5, 0.3), (1e9, 0.499), (1.0, -0.5)):
        found = ratio_and_modulus(*eigenstiffness(young, poisson))
        np.testing.assert_allclose(found, (poisson, young), rtol=1e-12)


@pytest.mark.parametrize(
    ("transform", "value"),
    [
        (Logarithm(), 2e5),
        (Logistic(-1.0, 0.5), 0.45),
        (Logistic(0.0, 3.0), 2.0),
        (Identity(), -0.1),
        (Signed(size=1e2), -3e4),
    ],
)
def test_transforms_lead_back(transform, value):
    assert transform.low < value < transform.high
    np.testing.assert_allclose(transform.value(jnp.asarray(transform.unknown(value))), value, rtol=1e-13)
    assert transform.low < float(transform.value(jnp.asarray(-30.0))) < float(transform.value(jnp.asarray(30.0)))


def test_params_hold_constants_as_attributes():
    values = {each.name: jnp.full((), v) for each, v in ((YOUNG, 1e5), (POISSON, 0.3), (DAMPING, 0.0))}
    params = jf.Params({**values, "density": jnp.full((), 1e3)}, gravity=jnp.zeros(3))
    for again in (params, copy.copy(params), pickle.loads(pickle.dumps(params)), jax.tree.map(lambda v: v, params)):
        assert float(again.young) == 1e5 and float(again.poisson) == 0.3 and not hasattr(again, "shear")
    changed = params.replace(young=2e5, gravity=jnp.ones(3))
    assert (changed.young, float(changed.poisson), float(changed.gravity[0])) == (2e5, 0.3, 1)
    assert float(params.young) == 1e5
    assert params.replace(constants={**values, "young": 1.0}, poisson=0.1).constants["young"] == 1.0
    with pytest.raises(AttributeError, match="params hold no 'yuong'; constants: young, poisson"):
        _ = params.yuong
    with pytest.raises(TypeError, match="yuong"):
        params.replace(yuong=1.0)
    mapped = jax.vmap(lambda p: p.young * 2, in_axes=(jax.tree.map(lambda _: None, params).replace(young=0),))
    np.testing.assert_array_equal(mapped(params.replace(young=jnp.arange(3.0))), [0, 2, 4])
