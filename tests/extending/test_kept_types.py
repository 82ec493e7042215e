"""What a method or a law of one's own remembers keeps its types: counts, flags and random keys stay what they are."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_new_memory import DT, FLOW, MEMORIES, OWN, POINTS, Creep

import jaxfem as jf
from jaxfem.io.checkpoints import load_checkpoint, save_checkpoint
from jaxfem.methods import Condensed
from jaxfem.pytrees import on_host
from jaxfem.stepping.frames import begin, frames


def turned_keys(keys):
    return jax.vmap(lambda key: jax.random.fold_in(key, 1))(keys)


class Counting(Creep, word="counting"):
    """Creep that counts its steps, notes whether it was ever stretched, and draws random numbers of its own."""

    def internal0(self, strain):
        count = strain.shape[1]
        keys, none = jax.random.split(jax.random.key(3), count), jnp.zeros(count, jnp.int32)
        return {"flow": strain * 0, "steps": none, "stretched": none > 0, "keys": keys}

    def response(self, values, internal, dt, rows):
        return super().response(values, internal["flow"], dt, rows)

    def commit(self, values, internal, strain, dt, rows):
        return {
            "flow": super().commit(values, internal["flow"], strain, dt, rows),
            "steps": internal["steps"] + 1,
            "stretched": internal["stretched"] | (jnp.abs(strain).max(0) > 0),
            "keys": turned_keys(internal["keys"]),
        }

    def rest_strain(self, values, internal, rows):
        return internal["flow"]


class Noting(Condensed):
    """A method that remembers a count, a flag, a random key and a share of plain numbers beside what it needs."""

    name = None

    def start(self, model, params, state):
        return [0, 0.5, False, jax.random.key(7), super().start(model, params, state)]

    def step(self, model, params, state, dt, forces, cache):
        count, share, flag, key, inner = state.memory
        following, info = super().step(model, params, state.replace(memory=inner), dt, forces, cache)
        memory = [count + 1, share / 2, ~flag, jax.random.fold_in(key, count), following.memory]
        return following.replace(memory=memory), info


def noted(dtype=None):
    """A creeping body and one that counts besides, by a method that notes, and the same without notes."""
    bodies = [
        jf.SoftBody(jf.TetMesh(POINTS, [[0, 1, 2, 3]]), density=1e3, material=law, fixed=[0, 1, 2])
        for law in (Counting(creep=FLOW, **OWN), MEMORIES["creep"])
    ]
    return jf.build(jf.Scene(bodies[:1]), solver=Noting(), dtype=dtype), jf.build(
        jf.Scene(bodies[1:]), solver="condensed"
    )


def like_notes(state, steps):
    """Whether a state's memories have the types they began with, and the values of so many `steps`."""
    count, share, flag, key, _ = state.memory
    (own,) = state.internal
    assert jnp.issubdtype(count.dtype, jnp.integer) and own["steps"].dtype == jnp.int32
    assert flag.dtype == own["stretched"].dtype == bool
    assert int(count) == steps and (own["steps"] == steps).all() and bool(flag) == bool(steps % 2)
    assert float(share) == 0.5 ** (steps + 1) and share.dtype == state.positions.dtype and own["stretched"].all()
    keys, plain = jax.random.split(jax.random.key(3), 1), jax.random.key(7)
    for number in range(steps):
        keys, plain = turned_keys(keys), jax.random.fold_in(plain, number)
    for found, wanted in ((own["keys"], keys), (key, plain)):
        assert (jax.random.key_data(found) == jax.random.key_data(wanted)).all()


def at(index, tree):
    return jax.tree.map(lambda leaf: leaf[index], tree)


def test_counts_flags_and_random_keys_that_are_remembered_keep_their_types(tmp_path):
    (model, params, state), plain = noted()
    one = state
    for _ in range(2):
        one, info = jf.step(model, params, one, DT)
        assert int(info.status) == 0
    like_notes(one, 2)
    expected, _ = jf.rollout(*plain, DT, 4)
    for options in ({}, {"checkpoint": 2}, {"on_failure": "halve"}):
        states, infos = jf.rollout(model, params, state, DT, 4, **options)
        assert not infos.status.any()
        like_notes(at(-1, states), 4)
        np.testing.assert_allclose(states.positions, expected.positions, atol=1e-13)
    assert jf.diagnose(model, params, states, infos).ok
    assert float(jf.energies(model, params, one).elastic) > 0
    path = tmp_path / "run.state.npz"
    save_checkpoint(path, on_host(one), 2, DT, 1)
    again, done, _ = load_checkpoint(path, model, params, state, DT)
    like_notes(again, 2)
    after, _ = jf.rollout(model, params, again, DT, 2)
    like_notes(at(-1, after), 4)
    np.testing.assert_allclose(after.positions[-1], expected.positions[-1], atol=1e-13)
    assert done == 2
    ready, start = begin(model, params, again, DT)  # as the command line writes a run
    saved, _, _ = frames(ready, params, on_host(start), DT, 1, 2, most=2, halvings=1)
    like_notes(at(0, on_host(saved)), 4)


def test_what_is_remembered_follows_a_state_in_single_precision_where_it_is_a_number():
    (model, params, state), _ = noted(np.float32)
    states, infos = jf.rollout(model, params, state, DT, 2)
    assert not infos.status.any() and states.internal[0]["flow"].dtype == np.float32
    like_notes(at(-1, states), 2)


def test_counts_are_swept_as_whole_numbers_alone():
    (model, params, state), _ = noted()
    asked = dict(dt=DT, steps=1, outputs={"count": lambda run: run.last.memory[0]})
    with pytest.raises(jf.sweeping.SweepError, match=r'"state\.memory\[0\]" is 2\.5 in a variant, and holds int'):
        jf.sweep(model, params, state, {"state.memory[0]": np.array([1.0, 2.5])}, **asked)
    told = jf.sweep(model, params, state, {"state.memory[0]": np.array([1, 5])}, engine="loop", **asked)
    assert told["count"].tolist() == [2, 6]


@pytest.mark.slow
def test_lanes_and_derivatives_pass_by_what_is_counted():
    (model, params, state), plain = noted()
    shear = jnp.asarray([1.0, 1.5]) * params.shear

    def fallen(model, params, state, shear, **options):
        states, _ = jf.rollout(model, params.replace(shear=shear), state, DT, 4, **options)
        return states.positions[-1, 3, 2], states

    for options in ({}, {"checkpoint": 2}, {"on_failure": "halve"}):
        own, states = jax.vmap(jax.grad(lambda s, o=options: fallen(model, params, state, s, **o), has_aux=True))(shear)
        wanted = jax.vmap(jax.grad(lambda s: fallen(*plain, s)[0]))(shear)
        np.testing.assert_allclose(own, wanted, rtol=1e-8)
        for lane in range(2):
            like_notes(at((lane, -1), states), 4)
    for engine in ("auto", "vmap", "loop"):
        told = jf.sweep(
            model, params, state, {"shear": np.asarray(shear)}, dt=DT, steps=4, engine=engine,
            outputs={"count": lambda run: run.last.memory[0], "z": lambda run: run.last.positions[3, 2]},
            derivatives=("shear",),
        )  # fmt: skip
        assert told["count"].tolist() == [4, 4] and not told.status.any()
        np.testing.assert_allclose(told.derivative("z", "shear"), wanted, rtol=1e-8)
