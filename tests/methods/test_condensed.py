"""Coupled scenes by the condensed route: MPRGP's answer on all rows, its derivatives, batches, single precision."""

import derivatives
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from standard import STANDARD, block_on_plane

import jaxfem as jf

pytestmark = pytest.mark.slow  # contacts with soft bodies are touched in tests/system too

SCENES = ["block on plane", "ball on block", "arm with tool"]


@pytest.mark.parametrize("name", SCENES)
def test_mprgp_on_all_rows_gives_the_same(name):
    methods = ("condensed", "mprgp")
    (model, found, info), (same, expected, other) = (STANDARD[name].run(method) for method in methods)
    assert (model.method.name, same.method.name) == methods
    np.testing.assert_allclose(found.positions, expected.positions, atol=2e-8)
    np.testing.assert_array_equal(info.weakly_active, other.weakly_active)
    if found.rigid is not None:
        np.testing.assert_allclose(found.rigid.positions, expected.rigid.positions, atol=2e-8)
        np.testing.assert_allclose(found.rigid.orientations, expected.rigid.orientations, atol=2e-7)
    own, theirs = jf.impulses(model, found), jf.impulses(same, expected)
    assert set(own) == {name for name in theirs if not name.startswith("elastic")}
    for group, impulses in own.items():
        size = float(jnp.abs(theirs[group]).max() + 1e-3)
        np.testing.assert_allclose(impulses, theirs[group], atol=1e-6 * size, err_msg=group)


def test_single_precision_follows():
    _, single, _ = STANDARD["arm with tool"].run("condensed", jnp.float32, 1e-5)
    _, double, _ = STANDARD["arm with tool"].run("condensed")
    assert single.positions.dtype == jnp.float32
    np.testing.assert_allclose(single.positions, double.positions, atol=2e-5)


def sliding_block():
    """Model, params, state of the block, and where it is after some steps as a function of stiffness and friction."""
    model, params, state = jf.build(block_on_plane(), tolerance=1e-12)
    (name,) = params.contacts

    def place(young, friction, steps=4):
        contacts = {name: params.contacts[name].replace(friction=friction * params.contacts[name].friction)}
        values = params.replace(young=young * params.young, contacts=contacts)
        states, _ = jf.rollout(model, values, state, 1e-2, steps)
        return jnp.mean(states.positions[-1] @ jnp.array([1.0, 0.4, 0.5]))

    return place


def test_derivatives_where_friction_slides():
    """The derivative's system is not symmetric there."""
    derivatives.check(sliding_block(), (1.0, 1.0))


def test_lanes_of_a_batch():
    place, young, steps = sliding_block(), jnp.array([0.8, 1.3]), STANDARD["block on plane"].steps
    lanes = jax.jit(jax.vmap(lambda e: place(e, 1.0, steps)))(young)
    np.testing.assert_allclose(lanes, [place(each, 1.0, steps) for each in young], atol=1e-9)
