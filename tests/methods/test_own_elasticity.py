"""Methods whose forces are not those of the laws on their elements: energies are theirs, statics and modes refuse."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.methods import Condensed
from jaxfem.methods.base import Elasticity
from jaxfem.methods.groupwise import Groupwise
from jaxfem.methods.mass_spring import MassSpring

METHODS = {"groups": Groupwise(groups=3), "springs": MassSpring()}


def built(method, update="explicit", **more):
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (3, 1, 1))
    values = dict(young=6e4, poisson=0.25, density=1070.0, damping=4e-3) | more
    return jf.build(
        jf.Scene([jf.SoftBody(mesh, fixed="x-", **values)]), solver=method, tolerance=1e-12, rotation_update=update
    )


def bent(state):
    """The state in another shape: sheared and stretched, at random speeds."""
    rest = state.positions
    shape = rest * jnp.array([1.1, 0.95, 1.0]) + 0.3 * rest[:, :1] * jnp.array([0.0, 0.0, 1.0])
    return shape, jnp.asarray(np.random.default_rng(0).standard_normal(rest.shape))


@pytest.mark.parametrize("name", METHODS)
def test_forces_are_slopes_of_the_energy_and_power_is_that_of_damping(name):
    model, params, state = built(METHODS[name])
    shape, rates = bent(state)

    @jax.jit
    def told(positions, rates):
        return model.method.elasticity(model, params, positions, rates)

    still, moving = told(shape, 0 * rates), told(shape, rates)
    slope = jax.jit(jax.grad(lambda x: told(x, 0 * rates).energy))(shape)
    # A group's rotation follows its shape: where it is not the best one for the energy, that is felt a little.
    off = float(jnp.abs(still.force + slope).max() / jnp.abs(slope).max())
    assert off < (1e-12 if name == "springs" else 0.2)
    assert float(still.power) == 0 and moving.energy == still.energy > 0
    np.testing.assert_allclose(jnp.vdot(moving.force - still.force, rates), -moving.power, rtol=1e-10)


@pytest.mark.parametrize("name", METHODS)
def test_energies_are_the_methods_own_and_their_sum_keeps_to_the_schemes_order(name):
    """A beam sinks and swings: what the sum loses in .1 s is halved with the step."""
    model, params, state = built(METHODS[name])
    lost = []
    for steps in (50, 100):
        end = jf.with_account(model, params, state)
        for _ in range(steps // 50):  # one program for both
            states, info = jf.rollout(model, params, end, 0.1 / steps, 50, every=50)
            assert not info.status.any()
            end = jax.tree.map(lambda leaf: leaf[-1], states)
        kinds = jf.energies(model, params, end).kinds
        assert kinds["damping"] > 0
        lost.append(float(sum(kinds.values())) / float(-kinds["gravity"]))
    told = jax.jit(lambda positions: model.method.elasticity(model, params, positions, 0 * positions))
    own = told(end.positions).energy
    assert kinds["elastic"] == own > 0
    assert -0.3 < lost[0] < 0 and 0.35 < lost[1] / lost[0] < 0.65


class Idle(Condensed):
    """One whose bodies store and lose nothing, in plain numbers."""

    name: ClassVar[str] = "idle_for_a_test"

    def elasticity(self, model, params, positions, rates):
        return Elasticity(0, jnp.zeros_like(positions), 0)


@pytest.mark.parametrize("update", ["explicit", "implicit"])
def test_plain_numbers_serve_and_rounds_within_a_step_pass_them_on(update):
    model, params, state = built(Idle(), update=update)
    assert model.method.own_elasticity
    state, info = jf.step(model, params, jf.with_account(model, params, state), 1e-2)
    kinds = jf.energies(model, params, state).kinds
    assert int(info.status) == 0 and kinds["elastic"] == kinds["damping"] == 0 and kinds["elastic"].dtype == jnp.float64


@pytest.mark.parametrize("name", METHODS)
def test_statics_and_modes_refuse_by_name(name):
    model, params, state = built(METHODS[name])
    for tell in (jf.equilibrium, jf.modes):
        with pytest.raises(jf.StepError, match=f'"{model.method.name}" has forces of its own'):
            tell(model, params, state)


@pytest.mark.parametrize("name", METHODS)
def test_rotations_that_it_has_not_are_refused_by_name(name):
    with pytest.raises(jf.SceneError, match=r'knows no rotations of elements.*"gram_schmidt"'):
        built(METHODS[name], rotation="gram_schmidt")
