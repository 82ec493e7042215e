"""The engine with lanes last gives each variant what a rollout of its own gives, or says why it cannot serve."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import beam

import jaxfem as jf
from jaxfem import sweeping
from jaxfem.materials.linear import Linear
from jaxfem.solvers import Status
from jaxfem.sweeping.lanes.body import padded

DT, STEPS = 5e-3, 10
KEPT = {"x": "positions", "v": lambda run: run.last.velocities, "energy": "energies"}


def both(scene, variants, outputs=KEPT, **options):
    """The same sweep one after another and with lanes last."""
    options = {"dt": DT, "steps": STEPS, "every": 5, **options}
    return [jf.sweep(*scene, variants, outputs=outputs, engine=engine, **options) for engine in ("loop", "lanes")]


def rich(scheme="backward_euler", **build):
    """Two bodies of different materials, one of them damped, with all kinds of loads, driven and fixed."""
    box = jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1))
    loads = [
        jf.PointForce(point=(0.1, 0.015, 0.015), force=(0.0, 0.05, 0.0)),
        jf.Traction(faces="x+", traction=(5.0, 0.0, 0.0)),
        jf.Pressure(faces="z+", pressure=20.0),
        jf.NodalForce(nodes="x+", force=(0.0, 0.0, 0.01)),
    ]
    first = jf.SoftBody(
        box, young=1e5, poisson=0.3, density=1e3, damping=2e-3, fixed="x-", loads=loads, velocity=(0, 0.1, 0)
    )
    shaken = jf.Driven("x-", jf.Motion(amplitude=(0.0, 0.0, 0.005), frequency=5.0))
    second = jf.SoftBody(
        box.translated((0, 0.1, 0)), young=3e5, poisson=0.42, density=8e2, mass_damping=3.0, driven=[shaken]
    )
    scene = jf.Scene([first, second], gravity=(0, 0, -9.81))
    return jf.build(scene, scheme=scheme, **build)


@pytest.mark.parametrize("scheme", ["backward_euler", "generalized_alpha"])
def test_lanes_are_rollouts(scheme):
    """Materials by body, loads of all kinds, driven nodes, dt, a start: over a factor of 100 in E; in both schemes."""
    scene = rich(scheme)
    name = next(iter(scene[0].bodies))
    variants = {
        f'young["{name}"]': np.array([1e4, 1e5, 1e6, 1e5, 1e5]),
        "poisson": np.array([[0.3, 0.42], [0.1, 0.2], [0.45, 0.4], [0.3, 0.3], [0.3, 0.3]]),
        "density": np.array([1e3, 5e2, 2e3, 1e3, 1e3]),
        "damping": np.array([0.0, 1e-3, 1e-2, 1e-3, 1e-3]),
        "mass_damping": np.array([[0.0, 3.0], [10.0, 1.0], [0.0, 0.0], [2.0, 2.0], [50.0, 0.0]]),
        "gravity[1]": np.array([0.0, -5.0, 20.0, 0.0, 0.0]),
        "loads[2]": np.array([20.0, 200.0, -20.0, 0.0, 0.0]),
        "motions[0].frequency": np.array([5.0, 10.0, 20.0, 5.0, 5.0]),
        "dt": np.array([5e-3, 5e-3, 1e-2, 1e-3, 5e-3]),
    }
    loop, lanes = both(scene, variants)
    assert loop.good.all() and lanes.good.all()
    moved = np.abs(loop["x"] - np.asarray(scene[0].rest)).max((1, 2, 3), keepdims=True)
    assert moved.min() > 1e-4
    assert (np.abs(lanes["x"] - loop["x"]) / moved).max() < 1e-6
    np.testing.assert_allclose(lanes["v"], loop["v"], atol=1e-6 * np.abs(loop["v"]).max())
    np.testing.assert_allclose(lanes["energy.elastic"], loop["energy.elastic"], rtol=1e-5, atol=1e-9)


class Halved(Linear):
    """A law of one's own: half as stiff as its Young's modulus says."""

    def stiffness(self, values):
        return tuple(0.5 * each for each in super().stiffness(values))


def test_a_law_of_ones_own():
    """What is linear and without a memory is served whatever its class."""
    box = jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1))
    law = Halved(young=2e5, poisson=0.3, damping=1e-3)
    own = jf.build(jf.Scene([jf.SoftBody(box, material=law, density=1e3, fixed="x-")], gravity=(0, 0, -9.81)))
    plain = beam((2, 1, 1), young=1e5, poisson=0.3, damping=1e-3, density=1e3)
    options = {"dt": DT, "steps": STEPS, "every": 5, "outputs": {"x": "positions"}, "engine": "lanes"}
    found, want = jf.sweep(*own, {"young": [2e5]}, **options), jf.sweep(*plain, {"young": [1e5]}, **options)
    np.testing.assert_allclose(found["x"], want["x"], atol=1e-9)


def test_single_precision():
    """Short steps, whose changes of position would be lost: the digits that they drop are carried."""
    scene = beam((2, 1, 1), build={"dtype": "float32"})
    _, lanes = both(scene, {"young": [1e5, 1e6], "dt": [2e-4, 5e-3]})
    exact = jf.sweep(
        *beam((2, 1, 1)),
        {"young": [1e5, 1e6], "dt": [2e-4, 5e-3]},
        dt=DT,
        steps=STEPS,
        every=5,
        outputs=KEPT,
        engine="loop",
    )
    assert lanes["x"].dtype == np.float32 and lanes.good.all()
    rest = np.asarray(scene[0].rest)
    for lane in range(2):
        moved = np.abs(exact["x"][lane] - rest).max()
        assert np.abs(lanes["x"][lane] - exact["x"][lane]).max() < 2e-3 * moved + 1e-8


def test_a_bad_lane_spoils_no_other():
    """Lanes with impossible values, numbers that overflow and too few iterations; the rest has the bits that it has."""
    scene = beam((2, 1, 1))
    good = {"young": np.full(4, 1e5), "gravity[2]": np.full(4, -9.81)}
    bad = {"young": np.array([1e5, -1.0, 1e5, 1e5]), "gravity[2]": np.array([-9.81, -9.81, np.nan, -1e300])}
    options = {"dt": DT, "steps": STEPS, "every": 5, "outputs": KEPT, "engine": "lanes"}
    clean, mixed = (jf.sweep(*scene, variants, **options) for variants in (good, bad))
    np.testing.assert_array_equal(mixed["x"][0], clean["x"][0])
    found = [Status(int(code)) for code in mixed.status]
    assert found[:3] == [Status.CONVERGED, Status.INVALID_VALUE, Status.INVALID_VALUE] and found[3] != Status.CONVERGED
    np.testing.assert_array_equal(mixed["x"][1], np.broadcast_to(scene[0].rest, mixed["x"][1].shape))  # it stood still
    model = scene[0].replace(max_iterations=scene[0].max_iterations * 0 + 1)
    few = jf.sweep(model, *scene[1:], good, **options)
    assert {Status(int(code)) for code in few.status} == {Status.ITERATION_LIMIT}


def thrown(scheme, **build):
    """Two free bodies that spin, one of them pulled, and one that is held."""
    box = jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1))
    pull = [jf.PointForce(point=(0.1, 0.015, 0.015), force=(0.0, 0.05, 0.0))]
    bodies = [
        jf.SoftBody(box, young=1e5, poisson=0.3, density=1e3, damping=2e-3, loads=pull),
        jf.SoftBody(box.translated((0, 0.1, 0)), young=3e4, poisson=0.4, density=8e2, damping=1e-3, mass_damping=5.0),
        jf.SoftBody(box.translated((0, 0.2, 0)), young=3e5, poisson=0.4, density=8e2, fixed="x-"),
    ]
    model, params, state = jf.build(jf.Scene(bodies, gravity=(0, 0, -9.81)), scheme=scheme, **build)
    return model, params, state


def spinning(scene, rates):
    """A start for each of `rates` [rad/s] about an axis across the free bodies; the second turns more slowly."""
    model, _, state = scene
    places, owner = np.asarray(state.positions), np.asarray(model.node_body)
    arms = np.zeros_like(places)
    for body in (0, 1):
        arms[owner == body] = (1 - 0.2 * body) * (places[owner == body] - places[owner == body].mean(0))
    return np.stack([rate * np.cross((0.2, 1.0, 0.3), arms) for rate in rates])


@pytest.mark.parametrize("scheme", ["backward_euler", pytest.param("generalized_alpha", marks=pytest.mark.slow)])
def test_free_bodies_are_rollouts(scheme):
    """They fall, spin and turn far, over a factor of 100 in E; what turns too far in a step has that status."""
    scene = thrown(scheme)
    variants = {
        "young": np.array([[1e5, 1e4, 1e5], [1e6, 1e5, 1e5], [1e4, 1e4, 1e5], [1e5, 1e5, 1e5], [1e5, 1e5, 1e5]]),
        "state.velocities": spinning(scene, [0.0, 20.0, 5.0, 1.5, 80.0]),
    }
    loop, lanes = both(scene, variants)
    assert lanes.engine == "lanes" and loop.status.tolist() == lanes.status.tolist()
    assert lanes.good.tolist() == [True] * 4 + [False] and "turned too far" in str(lanes)
    moved = np.abs(loop["x"] - np.asarray(scene[0].rest)).max((1, 2, 3), keepdims=True)
    assert (np.abs(lanes["x"] - loop["x"]) / moved).max() < 1e-6
    np.testing.assert_allclose(lanes["v"], loop["v"], atol=1e-6 * np.abs(loop["v"]).max())


@pytest.mark.slow
def test_derivatives_of_free_bodies():
    """That turn in each step further than where rotations are those of its end; forwards and backwards."""
    scene = thrown("backward_euler", tolerance=1e-11)
    spins = spinning(scene, [20.0, 3.0])
    variants = {"young": np.array([1e5, 1e4]), "dt": np.array([5e-3, 4e-3]), "state.velocities": spins}
    share = jnp.asarray(np.random.default_rng(1).normal(size=scene[0].rest.shape))
    outputs = {"whole": lambda run: (run.last.positions * share).sum() + (run.last.velocities * share).sum()}
    loop, _ = derivatives_of(scene, variants, list(variants), outputs, "loop")
    backwards, made = derivatives_of(scene, variants, list(variants), outputs, "lanes")
    assert made.good.all()
    few = derivatives_of(scene, variants, ["young", "dt"], outputs, "lanes")[0]
    for key, want in loop.items():
        for found in (backwards, few if key in few else backwards):
            np.testing.assert_allclose(found[key], want, rtol=1e-6, atol=1e-7 * np.abs(want).max(), err_msg=str(key))


def test_elements_inside_out():
    """Pushed through themselves at the start: the nearest rotation there is that of everywhere else."""
    model, params, state = beam((2, 1, 1), young=1e4)
    starts = np.stack([np.asarray(state.positions)] * 2)
    starts[1, :, 0] = np.where(np.asarray(model.free) > 0, -0.3 * starts[1, :, 0], starts[1, :, 0])
    loop, lanes = both((model, params, state), {"state.positions": starts})
    assert lanes.inverted[1] > 0 == lanes.inverted[0]
    np.testing.assert_allclose(lanes["x"], loop["x"], atol=1e-6)


def derivatives_of(scene, variants, names, outputs, engine, **options):
    """The derivatives that an engine finds, by (output, variable)."""
    options = {"dt": DT, "steps": STEPS, "every": 5, **options}
    made = jf.sweep(*scene, variants, outputs=outputs, derivatives=names, engine=engine, **options)
    return {(output, name): made.derivative(output, name) for output in outputs for name in names}, made


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["backward_euler", "generalized_alpha"])
def test_derivatives_are_those_of_rollouts(scheme):
    """Forwards and backwards: materials by body, loads of all kinds, driven nodes, dt, the start; lane by lane."""
    scene = rich(scheme, tolerance=1e-11)
    name = next(iter(scene[0].bodies))
    variants = {
        f'young["{name}"]': np.array([1e4, 1e5, 1e6]),
        "poisson": np.array([[0.3, 0.42], [0.1, 0.2], [0.45, 0.4]]),
        "damping": np.array([[2e-3, 1e-3], [1e-3, 0.0], [1e-2, 1e-2]] if scheme == "backward_euler" else [2e-3] * 3),
        "density": np.array([1e3, 5e2, 2e3]),
        "loads[2]": np.array([20.0, 200.0, -20.0]),
        "motions[0].frequency": np.array([5.0, 10.0, 20.0]),
        "dt": np.array([5e-3, 5e-3, 1e-2]),
        "state.velocities": np.random.default_rng(0).normal(0, 0.02, (3, *scene[2].velocities.shape)),
    }
    variants["state.velocities"] *= np.asarray(scene[0].free)[:, None]
    share = jnp.asarray(np.random.default_rng(1).normal(size=scene[0].rest.shape))
    outputs = {"whole": lambda run: (run.last.positions * share).sum() + (run.last.velocities * share).sum()}
    loop, plain = derivatives_of(scene, variants, list(variants), outputs, "loop")
    backwards, made = derivatives_of(scene, variants, list(variants), outputs, "lanes")
    assert plain.good.all() and made.good.all()
    for key, want in loop.items():
        assert np.abs(want).max() > 0
        np.testing.assert_allclose(backwards[key], want, rtol=1e-6, atol=1e-8 * np.abs(want).max(), err_msg=str(key))
    few = [each for each in variants if each != "state.velocities"]
    places = {"x": lambda run: run.last.positions, "v": lambda run: run.last.velocities}
    forwards, _ = derivatives_of(scene, variants, few, places, "lanes")
    for each in few:
        found = sum(np.tensordot(forwards[key, each], share, [(1, 2), (0, 1)]) for key in places)
        want = loop["whole", each]
        np.testing.assert_allclose(found, want, rtol=1e-6, atol=1e-8 * np.abs(want).max(), err_msg=each)


def test_derivatives_are_slopes():
    """Of a beam that turns far, against central differences; a lane that fails leaves the others their bits."""
    scene = beam((2, 1, 1), young=2e4, build={"tolerance": 1e-12})
    young, h = np.array([1e4, 3e4]), 1e-4
    kept = {"tip": lambda run: run.last.positions[-1]}
    sides = [{"young": young * (1 + side * h)} for side in (-2, -1, 1, 2)]
    at = [jf.sweep(*scene, each, outputs=kept, dt=DT, steps=STEPS, engine="lanes")["tip"] for each in sides]
    want = (at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * h * young[:, None])
    found, made = derivatives_of(scene, {"young": young}, ["young"], kept, "lanes", every=1)
    np.testing.assert_allclose(found["tip", "young"], want, rtol=1e-7, atol=1e-9 * np.abs(want).max())
    mixed, told = derivatives_of(scene, {"young": np.array([1e4, -1.0])}, ["young"], kept, "lanes", every=1)
    np.testing.assert_array_equal(mixed["tip", "young"][0], found["tip", "young"][0])
    assert told.status[0] == 0 != told.status[1] and made.good.all()


@pytest.mark.slow
def test_derivatives_in_single_precision_and_inside_out():
    """Against those of double precision; elements that start inside out have the derivative of their rotation too."""
    wanted, variants = {"tip": lambda run: run.last.positions[-1, 2]}, {"young": np.array([1e5, 1e6])}
    found = {
        dtype: derivatives_of(beam((2, 1, 1), build={"dtype": dtype}), variants, ["young"], wanted, "lanes")
        for dtype in ("float32", "float64")
    }
    single, double = (found[dtype][0]["tip", "young"] for dtype in ("float32", "float64"))
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, double, rtol=2e-3)
    model, _, state = scene = beam((2, 1, 1), young=1e4, build={"tolerance": 1e-11})
    starts = np.stack([np.asarray(state.positions)] * 2)
    starts[1, :, 0] = np.where(np.asarray(model.free) > 0, -0.3 * starts[1, :, 0], starts[1, :, 0])
    variants = {"young": [1e4, 1e4], "state.positions": starts}
    loop, lanes = (derivatives_of(scene, variants, ["young"], wanted, engine)[0] for engine in ("loop", "lanes"))
    np.testing.assert_allclose(lanes["tip", "young"], loop["tip", "young"], rtol=1e-6)


def test_what_it_cannot_serve_goes_one_after_another():
    ball = jf.RigidBody(jf.Sphere(0.05), mass=0.2, position=(0, 0, 0.05), name="ball")
    rigid = jf.build(jf.Scene([ball], contacts=[jf.Contact(ball, jf.Plane(normal=(0, 0, 1)))]))
    smoothed = beam((2, 1, 1), strain="smoothed")
    rubber = beam((2, 1, 1), build={"rotation_update": "implicit"})
    refused = ((rigid, "rigid ones"), (smoothed, "smooths it"), (rubber, "as it is"))
    for scene, words in refused:
        made = sweeping.Sweep(*scene, {"gravity[2]": [0.0]}, dt=DT, steps=1, outputs={"e": "energies"})
        assert made.engine.name == "loop" and words in made.reason
        with pytest.raises(jf.SweepError, match=words):
            sweeping.Sweep(*scene, {"gravity[2]": [0.0]}, dt=DT, steps=1, outputs={"e": "energies"}, engine="lanes")
    made = sweeping.Sweep(*beam((2, 1, 1)), {"young": [1e5]}, dt=DT, steps=1, outputs={"e": "energies"})
    assert made.engine.name == "lanes" and jax.default_backend() == "cpu"


def test_padded_rows_hold_every_item_once():
    owner = np.random.default_rng(0).integers(0, 20, 200)
    counts = np.sort(np.bincount(owner, minlength=20))[::-1]
    rank = np.argsort(np.argsort(-np.bincount(owner, minlength=20), kind="stable"))
    rows = padded(rank[owner], np.arange(200), 20, 200)
    assert len(rows) <= 4 and sum(len(each) for each in rows) == 20
    held = [sorted(row[row < 200]) for each in rows for row in each]
    assert [len(row) for row in held] == counts.tolist()
    assert sorted(item for row in held for item in row) == list(range(200))
    assert all(len({rank[owner[item]] for item in row}) == 1 for row in held)
