"""A new material law with a memory is one class too: its memory follows the steps, and what cannot use it says so."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivatives import check
from test_new_material import DT, OWN, ShearBulk

import jaxfem as jf

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
