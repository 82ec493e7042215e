"""A new material law with a memory is one class too: its memory follows the steps, and what cannot use it says so."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivatives import check
from test_new_material import DT, OWN, ShearBulk

import jaxfem as jf
from jaxfem.io.checkpoints import load_checkpoint, save_checkpoint
from jaxfem.methods import Condensed
from jaxfem.pytrees import on_host
from jaxfem.stepping.frames import begin, frames

SHARE = jf.Constant("share", "", "must be >= 0", low=0.0, closed=True)
TIME = jf.Constant("relaxation", "s", "must be > 0 s", low=0.0)
RATE = jf.Constant("creep", "1/s", "must be >= 0 1/s", low=0.0, closed=True)


class Maxwell(ShearBulk, word="maxwell"):
    """A spring with `share` times its stiffness beside it, which relaxes (Simo & Hughes 1998, chapter 10)."""

    constants = (*ShearBulk.constants, SHARE, TIME)
    options: ClassVar = {"whole": True}  # whether the volumetric part relaxes too

    def internal0(self, strain):
        return {"branch": jnp.zeros_like(strain), "strain": strain}

    def _numbers(self, values, dt):
        kept = jnp.exp(-dt / values["relaxation"])
        return kept, values["share"] * (1 - kept) * values["relaxation"] / dt

    def _relaxing(self, rows):
        return np.array([self.whole, *[True] * 5], float)[rows, None]

    def response(self, values, internal, dt, rows):
        kept, gain = self._numbers(values, dt)
        gains = self._relaxing(rows) * gain
        offset = (kept * internal["branch"] - gains * internal["strain"]) / (1 + gains)
        return jf.Response((1 + self.whole * gain, 1 + gain), offset)

    def commit(self, values, internal, strain, dt, rows):
        kept, gain = self._numbers(values, dt)
        gains = self._relaxing(rows) * gain
        return {"branch": kept * internal["branch"] + gains * (strain - internal["strain"]), "strain": strain}


class Creep(ShearBulk, word="creep"):
    """Strain that flows: e_p grows by min(dt creep, 1) of the elastic strain after each step."""

    constants = (*ShearBulk.constants, RATE)

    def internal0(self, strain):
        return jnp.zeros_like(strain)

    def response(self, values, internal, dt, rows):
        return jf.Response((1.0, 1.0), -internal)

    def commit(self, values, internal, strain, dt, rows):
        return internal + jnp.minimum(dt * values["creep"], 1) * (strain - internal)

    def rest_strain(self, values, internal, rows):
        return internal


POINTS = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.02, 0.03, 0.1]])
BRANCH, TAU, FLOW = 0.7, 0.03, 6.0
MEMORIES = {
    "maxwell": Maxwell(share=BRANCH, relaxation=TAU, **OWN),
    "maxwell_shear": Maxwell(share=BRANCH, relaxation=TAU, whole=False, **OWN),
    "creep": Creep(creep=FLOW, **OWN),
}


def remembered(name, memory, strain):
    """Stress of the memory over that of the strain alone: (factor on the strain, known strain); 3x3 matrices."""
    old, before = memory
    if name == "creep":
        return strain - before
    kept, change = np.exp(-DT / TAU), strain - old
    if name == "maxwell_shear":
        change = change - np.trace(change) / 3 * np.eye(3)
    return strain + kept * before + BRANCH * (1 - kept) * TAU / DT * change


def hand_step(name, x, v, memory):
    """One step of one tetrahedron with its last node free: exact, because the momentum balance is linear in v."""
    shape = np.linalg.inv(np.c_[np.ones(4), POINTS])[1:].T  # gradients of the shape functions, (4, 3)
    volume, weight = abs(np.linalg.det(POINTS[1:] - POINTS[0])) / 6, 1e3 * np.array([0, 0, -9.81])
    left, _, right = np.linalg.svd(x.T @ shape)
    turn = left @ right
    lam = OWN["bulk"] - 2 * OWN["shear"] / 3

    def sym(a):
        return (a + a.T) / 2

    def stressed(strain):
        return lam * np.trace(strain) * np.eye(3) + 2 * OWN["shear"] * strain

    def balance(new):
        rate = sym(turn.T @ np.outer(new, shape[3]))
        strain = sym(turn.T @ (x.T @ shape)) - np.eye(3) + DT * rate
        stress = stressed(remembered(name, memory, strain)) + stressed(OWN["loss"] * rate)
        mass = 1e3 * volume / 4
        return mass * (new - v) - DT * (volume / 4 * weight - volume * turn @ stress @ shape[3])

    known = balance(np.zeros(3))
    new = np.linalg.solve(np.stack([balance(e) - known for e in np.eye(3)], 1), -known)
    moved = x + DT * np.outer([0, 0, 0, 1], new)
    left, _, right = np.linalg.svd(moved.T @ shape)
    end = sym((left @ right).T @ (moved.T @ shape)) - np.eye(3)
    if name == "creep":
        return moved, new, (end, memory[1] + min(DT * FLOW, 1) * (end - memory[1]))
    return moved, new, (end, remembered(name, memory, end) - end)


@pytest.mark.parametrize("name", MEMORIES)
def test_a_law_with_a_memory_agrees_with_a_computation_by_hand(name):
    body = jf.SoftBody(jf.TetMesh(POINTS, [[0, 1, 2, 3]]), density=1e3, material=MEMORIES[name], fixed=[0, 1, 2])
    # Pulled far: the free node starts a tenth of the height away.
    model, params, state = jf.build(jf.Scene([body]), tolerance=1e-14)
    state = state.replace(positions=state.positions.at[3].add(np.array([0.02, -0.01, 0.01])))
    x, v, memory = np.asarray(state.positions), np.zeros(3), (np.zeros((3, 3)), np.zeros((3, 3)))
    for _ in range(8):
        state, info = jf.step(model, params, state, DT)
        x, v, memory = hand_step(name, x, v, memory)
        assert int(info.status) == 0
        np.testing.assert_allclose(state.positions, x, atol=1e-11)
    assert np.abs(np.asarray(state.internal[0]["strain"] if "maxwell" in name else state.internal[0])).max() > 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("strain", ["element", "smoothed"])
def test_memories_on_every_kind_of_domains_beside_bodies_without(strain):
    """No share, no flow: the plain law, step for step; a body without a memory remembers nothing; derivatives, which
    tests/materials takes through memories on smoothed domains."""
    laws = [Maxwell(share=BRANCH, relaxation=TAU, **OWN), Creep(creep=FLOW, **OWN), ShearBulk(**OWN)]
    meshes = [jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1), origin=(0, 0.1 * k, 0), name=f"beam{k}") for k in range(3)]
    shared = {"density": 1e3, "fixed": "x-", "strain": strain}
    bodies = [jf.SoftBody(mesh, material=law, **shared) for mesh, law in zip(meshes, laws, strict=True)]
    model, params, state = jf.build(jf.Scene(bodies), tolerance=1e-13)
    assert [each is None for each in state.internal] == [type(each.law) is ShearBulk for each in model.domains]

    def tips(share, flow):
        after = jf.rollout(model, params.replace(share=share, creep=flow), state, DT, 6)[0].positions[-1]
        moved = (after - state.positions).reshape(3, -1, 3)
        return 1e2 * jnp.sum(moved[:2, -1, 2]), moved

    run = check(tips, (BRANCH, FLOW), has_aux=True) if strain == "element" else jax.jit(tips)
    _, plain = run(0.0, 0.0)
    np.testing.assert_allclose(plain[0], plain[2], atol=1e-11)
    np.testing.assert_allclose(plain[1], plain[2], atol=1e-11)
    _, moved = run(BRANCH, FLOW)
    np.testing.assert_allclose(moved[2], plain[2], atol=1e-11)
    sag = -np.asarray(moved)[:, -1, 2]
    assert sag[0] < 0.95 * sag[2] < 1.05 * sag[2] < sag[1]  # stiffer while it relaxes; softer as it flows


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


def test_energies_count_from_the_strain_at_rest_and_what_needs_none_refuses_a_memory():
    body = jf.SoftBody(jf.TetMesh(POINTS, [[0, 1, 2, 3]]), density=1e3, material=MEMORIES["creep"], fixed=[0, 1, 2])
    scene = model, params, state = jf.build(jf.Scene([body]))
    moved = state.replace(positions=state.positions.at[3].add(np.array([0.02, -0.01, 0.01])))
    flowed = moved.replace(internal=jax.tree.map(jnp.copy, moved.internal))
    held, _ = jf.step(model, params.replace(creep=1e9), moved, 1e-9)  # all strain flows at once, nothing moves
    assert float(jf.energies(model, params, flowed).elastic) > 1e-3
    assert float(jf.energies(model, params, held).elastic) < 1e-12
    with pytest.raises(jf.StepError, match=r'where "mesh" .* comes to rest.* without a memory, and those that relax'):
        jf.equilibrium(*scene)
    with pytest.raises(jf.StepError, match="modes takes materials without a memory"):
        jf.modes(*scene)
    with pytest.raises(jf.StepError, match="internal belongs to materials with a memory"):
        jf.step(model, params, state.replace(internal=None), DT)
