"""Boxes whose edges meet where no corner does: crossed planks, ridges, derivatives."""

import derivatives
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes
from scipy.optimize import lsq_linear

import jaxfem as jf
from jaxfem.system.coupled import configuration

RNG = np.random.default_rng(3)
FLAT, STEEP = (1, 0, 0, 0), (np.cos(np.pi / 8), np.sin(np.pi / 8), 0, 0)


def turned(quaternion, by):
    """A quaternion turned about z by `by` degrees."""
    a = np.radians(by) / 2
    w, x, y, z = quaternion
    c, s = np.cos(a), np.sin(a)
    return (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w)


@jax.jit
def edges_of(model, state):
    return model.contacts["rough rigid-rigid box edges"].pairs(configuration(state))


def two(place, orientation, dtype=None, solver="mprgp", friction=0.5):
    """A plank above a fixed one; model, params, state."""
    below = jf.RigidBody(jf.Box((1.0, 0.2, 0.1)), mass=1.0, fixed=True, name="below")
    above = jf.RigidBody(jf.Box((1.0, 0.2, 0.1)), mass=2.0, position=place, orientation=orientation, name="above")
    scene = jf.Scene([above, below], contacts=[jf.Contact(above, below, friction=friction)])
    return jf.build(scene, dtype=dtype, solver=solver, tolerance=1e-4 if dtype == jnp.float32 else 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("degrees", "dtype", "solver"), [(90, jnp.float64, "auto"), (45, jnp.float64, "mprgp"), (45, jnp.float32, "mprgp")]
)
def test_crossed_planks_rest_on_each_other(degrees, dtype, solver):
    model, params, state = two((0.1, 0.05, 0.11), turned(FLAT, degrees), dtype, solver)
    states, info = scenes.rolled(model, params, state, 1e-2, 100)
    assert not info.status.any()
    np.testing.assert_allclose(states.rigid.positions[-1, 0], (0.1, 0.05, 0.1), atol=1e-3)
    np.testing.assert_allclose(states.rigid.velocities[-1, 0], 0, atol=1e-3)
    assert float(jnp.abs(states.rigid.orientations[-1, 0] @ jnp.asarray(turned(FLAT, degrees)))) > 1 - 1e-5


def test_the_patch_of_two_crossed_faces_has_four_corners():
    model, _, state = two((0.1, 0.05, 0.101), turned(FLAT, 90))
    found = edges_of(model, state)
    near = np.flatnonzero(found.gap < 1)
    np.testing.assert_allclose(found.gap[near], 1e-3, atol=1e-12)
    np.testing.assert_allclose(found.normal[near], [(0, 0, 1)] * 4, atol=1e-12)


def test_two_ridges_meet_in_one_point():
    """Both turned by 45 degrees about their lengths and crossed: half a diagonal each between their axes."""
    upper = turned(STEEP, 90)
    model, params, state = two((0, 0, 0.23), upper)
    below = state.rigid.orientations.at[1].set(jnp.asarray(STEEP))
    state = state.replace(rigid=state.rigid.replace(orientations=below))
    found = edges_of(model, state)
    near = np.flatnonzero(found.gap < 1)
    # The highest point of a 0.2 x 0.1 block turned by 45 degrees is (0.1 + 0.05) / sqrt 2 above its axis.
    assert len(near) == 1
    np.testing.assert_allclose(found.gap[near], 0.23 - 2 * 0.15 / np.sqrt(2), atol=1e-12)
    np.testing.assert_allclose(found.normal[near], [(0, 0, 1)], atol=1e-12)
    states, info = scenes.rolled(model, params.replace(gravity=jnp.zeros(3)), state, 1e-2, 10)
    assert not info.status.any()
    push = state.replace(rigid=state.rigid.replace(velocities=state.rigid.velocities.at[0].set((0, 0, -1.0))))
    states, info = scenes.rolled(model, params, push, 1e-2, 10)
    assert not info.status.any()
    gaps = jax.vmap(lambda s: edges_of(model, s).gap.min())(states)
    assert float(gaps.min()) > -1e-4


def test_gaps_are_the_distance_of_the_boxes():
    """Apart, the gap is the least distance of two points of the boxes: bounded least squares in their coordinates."""
    half, seen = np.array([0.5, 0.1, 0.05]), 0
    corners = np.stack(np.meshgrid(*[[-1, 1]] * 3, indexing="ij"), -1).reshape(-1, 3) * half
    model, _, state = two((0, 0, 0), FLAT)
    for _ in range(200):
        place, quaternion = RNG.normal(size=3) * (0.3, 0.3, 0.1) + (0, 0, 0.25), RNG.normal(size=4)
        rigid = state.rigid.replace(
            positions=state.rigid.positions.at[0].set(place),
            orientations=state.rigid.orientations.at[0].set(quaternion / np.linalg.norm(quaternion)),
        )
        moved = state.replace(rigid=rigid)
        found, turn = edges_of(model, moved), np.asarray(configuration(moved).rotations[0])
        for k in np.flatnonzero(found.gap < 1):
            gap, n = float(found.gap[k]), np.asarray(found.normal[k])
            along = ((corners @ turn.T + place) @ n).min() - (corners @ n).max()
            assert along == pytest.approx(gap, abs=1e-4)
            if gap > 1e-3:
                least = lsq_linear(
                    np.column_stack([turn, -np.eye(3)]), -place, (np.r_[-half, -half], np.r_[half, half])
                )
                assert np.sqrt(2 * least.cost) == pytest.approx(gap, abs=1e-4)
                seen += 1
    assert seen > 10


@pytest.mark.slow
def test_derivative_of_an_impact_of_edges():
    model, params, state = two((0.02, 0.01, 0.2), turned(STEEP, 70), friction=0.1)
    tight = model.replace(tolerance=jnp.asarray(1e-13))
    below = state.rigid.orientations.at[1].set(jnp.asarray(turned(STEEP, 10)))

    def place(friction, speed, height):
        rigid = state.rigid.replace(
            orientations=below,
            velocities=state.rigid.velocities.at[0].set(jnp.array([0.2, 0.1, -1.0]) * speed),
            positions=state.rigid.positions.at[0, 2].set(0.22 * height),
        )
        contacts = {
            name: values.replace(friction=friction * values.friction) for name, values in params.contacts.items()
        }
        states, _ = jf.rollout(tight, params.replace(contacts=contacts), state.replace(rigid=rigid), 5e-3, 6)
        return states.rigid.positions[-1, 0] @ jnp.array([1.0, 0.5, 0.3]) + states.rigid.angular_velocities[-1, 0, 1]

    derivatives.check(place, (1.0, 1.0, 1.0), forwards=False)


@pytest.mark.slow
def test_lanes_give_what_they_give_alone():
    model, params, state = two((0.1, 0.05, 0.11), turned(FLAT, 60))

    def end(height):
        rigid = state.rigid.replace(positions=state.rigid.positions.at[0, 2].set(height))
        return jf.rollout(model, params, state.replace(rigid=rigid), 1e-2, scenes.CHUNK)[0].rigid.positions[-1, 0]

    heights = jnp.array([0.1, 0.12, 0.4])
    np.testing.assert_allclose(jax.vmap(end)(heights), [end(h) for h in heights], atol=1e-7)
