"""Branches and loops under vmap: the same values as lane by lane, and no more work than they need."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxfem as jf
from jaxfem.batching import cond_any, lanes_in_turn, one_program
from jaxfem.methods import by_rows


@lanes_in_turn
def halvings(system, right):
    """A loop of its own length for each lane; system and right are pytrees."""
    count, value = jax.lax.while_loop(
        lambda s: s[1] > system["least"], lambda s: (s[0] + 1, s[1] / 2), (jnp.int32(0), right * system["scale"])
    )
    return {"count": count, "value": value}


SYSTEMS = {"least": jnp.array([1e-3, 1.0, 0.1]), "scale": jnp.array([1.0, 2.0, 3.0])}
RIGHT = jnp.array([1.0, 5.0, 0.01])


def alone(index):
    return halvings(jax.tree.map(lambda x: x[index], SYSTEMS), RIGHT[index])


def test_lanes_in_turn_are_what_each_is_alone():
    together = jax.jit(jax.vmap(halvings))(SYSTEMS, RIGHT)
    for lane in range(3):
        assert jax.tree.map(lambda x, lane=lane: x[lane], together) == alone(lane)


def test_one_system_serves_many_right_hand_sides_and_nested_batches():
    first = {"least": SYSTEMS["least"][0], "scale": 2.0}
    one = jax.vmap(halvings, (None, 0))(first, RIGHT)
    mixed = jax.vmap(halvings, ({"least": None, "scale": 0}, 0))(SYSTEMS | {"least": jnp.array(0.01)}, RIGHT)
    assert one["count"].shape == mixed["count"].shape == (3,)
    grid = jax.jit(jax.vmap(jax.vmap(halvings, (None, 0)), (0, None)))(SYSTEMS, RIGHT)
    np.testing.assert_array_equal(grid["value"].diagonal(), [alone(lane)["value"] for lane in range(3)])
    turned = jax.jit(jax.vmap(jax.vmap(halvings, (0, None)), (None, 0)))(SYSTEMS, RIGHT)
    np.testing.assert_array_equal(turned["value"].T, grid["value"])


def branch(x, shift):
    return cond_any(jnp.any(x < 0), lambda x, s: jnp.where(x < 0, jnp.sqrt(-x) + s, x), lambda x, _: x, x, shift)


def test_a_branch_stays_one_under_vmap():
    x = jnp.array([[1.0, 2.0], [-4.0, 3.0]])
    expected = [[1.0, 2.0], [2.5, 3.0]]
    np.testing.assert_array_equal(jax.vmap(branch, (0, None))(x, 0.5), expected)
    np.testing.assert_array_equal(jax.jit(jax.vmap(jax.vmap(branch, (0, None)), (0, None)))(x[None], 0.5)[0], expected)
    traced = str(jax.make_jaxpr(jax.vmap(branch, (0, None)))(x, 0.5))
    assert "cond[" in traced and "sqrt" in traced.split("cond[")[1]


def test_small_functions_are_one_program_and_leave_no_trace_inside_of_others():
    seen = []

    @one_program
    def moved(x):
        seen.append(x)
        return 2 * x + 1

    for start in (0.0, 1.0):
        np.testing.assert_array_equal(moved(np.full(3, start)), np.full(3, 2 * start + 1))
    assert len(seen) == 1  # traced, and not run an operation at a time
    inside = jax.jit(lambda x: moved(x)).lower(np.zeros(3)).as_text()
    assert "multiply" in inside and "call" not in inside


def test_a_scene_of_known_shape_is_built_without_tracing(monkeypatch):
    traced, counts, plain = [], [], by_rows.system_of
    monkeypatch.setattr(by_rows, "system_of", lambda *given: traced.append(given) or plain(*given))
    for speed in (0.1, 0.2):
        boxes = [
            jf.RigidBody(jf.Box((0.1, 0.1, 0.1)), mass=1.0, position=(0.3 * k, 0, 0.05), velocity=(speed, 0, 0))
            for k in range(3)
        ]
        jf.build(jf.Scene(boxes, contacts=[jf.Contact(box, jf.Plane()) for box in boxes]))
        counts.append(len(traced))
    assert counts[1] == counts[0]
