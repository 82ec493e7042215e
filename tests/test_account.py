"""Energy that is stored, lost and brought in sums up to the scheme's order; tensors of frames against formulas."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.io.export import FrameWriter
from jaxfem.io.fields import computed
from jaxfem.io.reading import read_frames
from jaxfem.stepping.begin import begun

ELASTIC = {"young": 1e5, "poisson": 0.3, "damping": 2e-3}
LAWS = {
    "linear": jf.Linear(**ELASTIC),
    "undamped": jf.Linear(**{**ELASTIC, "damping": 0.0}),
    "viscoelastic": jf.Viscoelastic(**ELASTIC, branches=[(0.5, 0.03)]),
    "creep_plastic": jf.CreepPlastic(**ELASTIC, yield_strain=2e-3, creep=20.0),
}
COUNTS = (40, 80, 160)


def pulled(law, scheme, strain="element", driven=False, **settings):
    """A block under its weight, a traction and a pressure, clamped or shaken at one side."""
    mesh = jf.mesh.box((0.1, 0.05, 0.05), 1)
    loads = [jf.Traction("x+", (0.0, 60.0, 0.0)), jf.Pressure("z+", 40.0)]
    shaken = [jf.Driven("x-", jf.Motion(amplitude=(0.0, 0.0, 2e-3), frequency=3.0, phase=np.pi / 2))]
    held = {"driven": shaken} if driven else {"fixed": "x-"}
    body = jf.SoftBody(mesh, density=1e3, material=LAWS[law], loads=loads, strain=strain, **held)
    model, params, state = jf.build(jf.Scene([body]), scheme=scheme, **{"tolerance": 1e-12, **settings})
    return model, params, jf.with_account(model, params, state)


def imbalance(scene, time=0.16):
    """The largest change of the sum of all energies, by the number of steps; and the last energies."""
    model, params, state = scene

    @jax.jit
    def run(steps):
        def one(_, carry):
            at, worst = carry
            at, _ = jf.step(model, params, at, time / steps)
            return at, jnp.maximum(worst, jnp.abs(total(at) - total(state)))

        # Begun it is as steps leave it: the loop's body holds the only step.
        return jax.lax.fori_loop(0, steps, one, (begun(model, params, state, None), jnp.zeros(())))

    def total(at):
        return sum(jf.energies(model, params, at).kinds.values())

    ends = [run(steps) for steps in COUNTS]
    return [float(worst) for _, worst in ends], jf.energies(model, params, ends[-1][0])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "scheme", "driven", "order"),
    [
        # With damping, prescribed velocities, which are those of the middle of a step, cost the scheme its order.
        ("undamped", "generalized_alpha", True, 2),
        ("viscoelastic", "generalized_alpha", False, 2),
        ("creep_plastic", "backward_euler", False, 1),
    ],
)
def test_the_sum_of_all_energies_is_constant_to_the_schemes_order(law, scheme, driven, order):
    errors, last = imbalance(pulled(law, scheme, driven=driven))
    found = -np.polyfit(np.log(COUNTS), np.log(errors), 1)[0]
    assert found > order - 0.25, (found, errors)
    moved = abs(float(last.booked["loads"]))
    assert errors[-1] < (0.5 if order == 1 else 0.05) * moved and moved > 1e-5
    assert float(last.booked["damping"]) > 0.01 * moved or law == "undamped"
    assert ("supports" in last.booked) == driven
    own = {"viscoelastic": "viscous", "creep_plastic": "plastic"}.get(law)
    assert set(last.booked) == {"loads", "damping"} | ({"supports"} if driven else set()) | ({own} if own else set())
    assert own is None or float(last.booked[own]) > 0.005 * moved


@pytest.mark.parametrize("law", ["viscoelastic", "creep_plastic"])
def test_single_precision_stays_single(law):
    model, params, state = pulled(law, "backward_euler", dtype=jnp.float32, tolerance=1e-5)
    states, info = jf.rollout(model, params, state, 1e-3, 20)
    assert not info.status.any()
    leaves = jax.tree.leaves((states, jf.energies(model, params, jax.tree.map(lambda leaf: leaf[-1], states))))
    assert {str(leaf.dtype) for leaf in leaves if jnp.issubdtype(leaf.dtype, jnp.inexact)} == {"float32"}
    double = jf.rollout(*pulled(law, "backward_euler"), 1e-3, 20)[0]
    np.testing.assert_allclose(states.positions[-1], double.positions[-1], atol=2e-6)
    np.testing.assert_allclose(states.account["loads"], double.account["loads"], rtol=1e-3, atol=1e-8)


def test_states_without_an_account_carry_none():
    scene = pulled("linear", "backward_euler")
    assert jf.step(*scene[:2], scene[2].replace(account=None), 1e-2)[0].account is None
    assert jf.energies(*scene[:2], scene[2].replace(account=None)).booked is None


@pytest.mark.parametrize("strain", ["element", "smoothed"])
def test_tensors_of_an_even_strain(strain):
    """All stretched and turned alike: strain, stress and their von Mises values by formula, in the world's axes."""
    law = jf.CreepPlastic(**ELASTIC, yield_strain=1.0, creep=0.0)
    other = jf.SoftBody(
        jf.mesh.box((1, 1, 1), 1, origin=(3, 0, 0)), density=1e3, material=LAWS["linear"], strain=strain
    )
    body = jf.SoftBody(jf.mesh.box((1, 1, 1), 1), density=1e3, material=law, strain=strain)
    model, params, state = jf.build(jf.Scene([body, other]))
    angle, stretch = 0.7, np.diag([1.1, 0.98, 1.03])
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    state = state.replace(positions=model.rest @ (turn @ stretch).T)
    plastic = np.array([0.0, 0.01, 0, 0, 0, 0])  # (xx - yy) / sqrt 2 in the rotated frame
    own = [None if k is None else jnp.zeros_like(k) for k in state.internal]
    for k, each in enumerate(model.domains):
        if own[k] is not None and each.rows.start <= 1 < each.rows.stop:
            own[k] = own[k].at[1 - each.rows.start].set(0.01)
    fields = computed(model, params, state.replace(internal=tuple(own)), whole=True)
    e, p = stretch - np.eye(3), plastic[1] * np.diag([1, -1, 0]) / np.sqrt(2)
    mu, lam = 1e5 / 2.6, 1e5 * 0.3 / (1.3 * 0.4)
    for elastic, half, flowed in ((e - p, slice(0, 6), p), (e, slice(6, 12), 0 * p)):
        stress = lam * np.trace(elastic) * np.eye(3) + 2 * mu * elastic
        for name, tensor in (("stress", stress), ("strain", e), ("plastic_strain", flowed)):
            world = turn @ tensor @ turn.T
            expected = [world[i] for i in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))]
            size = np.abs(tensor).max()
            np.testing.assert_allclose(fields[name][half], np.tile(expected, (6, 1)), atol=1e-9 * max(size, 1e-2))
        deviator = stress - np.trace(stress) / 3 * np.eye(3)
        np.testing.assert_allclose(fields["von_mises"][half], np.sqrt(1.5 * np.sum(deviator**2)), rtol=1e-9)
        np.testing.assert_allclose(
            fields["von_mises_plastic_strain"][half], np.sqrt(2 / 3 * np.sum(flowed**2)), atol=1e-12
        )


def test_frames_and_tables_hold_them(tmp_path):
    model, params, state = pulled("viscoelastic", "backward_euler")
    with FrameWriter(tmp_path, "block", model, params, tensors=True) as writer:
        writer.write(state)
        writer.write(jf.step(model, params, state, 1e-2)[0])
    frame = read_frames(writer.index)[1]
    assert frame.stress.shape == frame.viscous_strain.shape == (6, 6) and (frame.von_mises_viscous_strain >= 0).all()
    assert np.abs(frame.viscous_strain).max() > 0 and np.isfinite(frame.von_mises).all()
    head = (tmp_path / "energies.csv").read_text().splitlines()[0]
    assert head == "time_s,kinetic_J,elastic_J,gravity_J,damping_J,loads_J,viscous_J"
    assert writer.energies["viscous"][1] > 0


def test_losses_of_a_branch_are_exact_at_any_step():
    """Against the dashpot's power, integrated finely; never negative."""
    law, rows = LAWS["viscoelastic"], slice(0, 6)
    rng = np.random.default_rng(3)
    spring, change = rng.standard_normal((2, 5, 4))
    for dt in (1e-7, 1e-3, 0.03, 3.0):
        before = law.internal0(jnp.zeros((6, 4)))._replace(springs=jnp.asarray(spring)[None])
        end = jnp.zeros((6, 4)).at[1:].set(change)
        after = law.commit(law.values, before, end, dt, rows)
        lost = law.dissipated(law.values, before, after, end, 2.0 * jnp.ones((6, 4)), dt, rows)["viscous"]
        nodes, weight = np.polynomial.legendre.leggauss(60)
        edges = np.concatenate([[0], np.geomspace(1e-4, 1, 12)]) * dt  # finer where the old strain decays
        total = 0.0
        for low, high in itertools.pairwise(edges):
            t = (low + (high - low) * (nodes + 1) / 2)[:, None, None]
            s = spring * np.exp(-t / 0.03) + change / dt * 0.03 * -np.expm1(-t / 0.03)
            total = total + np.tensordot(weight * (high - low) / 2, s**2, 1)
        np.testing.assert_allclose(lost, 0.5 * 2.0 * np.sum(total, 0) / 0.03, rtol=1e-8)
