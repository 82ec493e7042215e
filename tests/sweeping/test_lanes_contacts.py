"""Joints and contacts with lanes last: each variant is what a rollout of its own gives, in positions and impulses."""

import numpy as np
import pytest

import jaxfem as jf
from jaxfem import sweeping
from jaxfem.solvers import Status

SLOW = pytest.mark.slow
DT, STEPS = 5e-3, 12
KEPT = {
    "x": "positions",
    "v": lambda run: run.last.velocities,
    "force": "contact_forces",
    "push": lambda run: jf.impulses(run.model, run.last),
}
BOX = jf.mesh.box((0.1, 0.06, 0.04), (2, 1, 1))


def dropped(scheme="backward_euler", ground=None, height=0.002, dtype=np.float64, **contact):
    """A soft box just above a slope, or above another `ground` at a height."""
    place = (-0.05, -0.03, height)
    body = jf.SoftBody(
        BOX.translated(place), young=1e5, poisson=0.3, density=1e3, damping=1e-3, name="b", velocity=(0, 0, -0.3)
    )
    slope = jf.Plane(normal=(0.3, 0.0, 1.0), point=(0, 0, -0.015)) if ground is None else ground
    touch = jf.Contact("b", slope, **{"friction": 0.4, "restitution": 0.2, **contact})
    scene = jf.Scene([body], contacts=[touch], gravity=(0, 0, -9.81))
    return jf.build(scene, scheme=scheme, dtype=dtype, tolerance=1e-10 if dtype == np.float64 else 1e-6)


def both(scene, variants, outputs=KEPT, **options):
    """The same sweep one after another and with lanes last."""
    options = {"dt": DT, "steps": STEPS, "every": 4, "outputs": outputs, **options}
    return [jf.sweep(*scene, variants, engine=engine, **options) for engine in ("loop", "lanes")]


def same(loop, lanes, model, share=1e-6):
    """Positions, velocities and impulses agree to a share of how far, how fast and how hard."""
    assert lanes.status.tolist() == loop.status.tolist()
    moved = np.abs(loop["x"] - np.asarray(model.rest)).max()
    assert moved > 1e-3
    np.testing.assert_allclose(lanes["x"], loop["x"], atol=share * moved)
    np.testing.assert_allclose(lanes["v"], loop["v"], atol=share * np.abs(loop["v"]).max())
    for name in loop.outputs:
        if name.startswith(("force", "push")):
            np.testing.assert_allclose(
                lanes[name], loop[name], atol=20 * share * np.abs(loop[name]).max(), err_msg=name
            )


def sloped(model):
    """Sticking, sliding and bouncing, over a factor of 100 in E; steps of three lengths."""
    ((group, candidates),) = model.contacts.items()
    count = candidates.margin.shape[0]
    return {
        "young": np.array([1e5, 1e4, 1e6, 1e5, 1e5]),
        f'contacts["{group}"].friction': np.repeat([[0.4], [0.1], [0.8], [0.2], [0.4]], count, 1),
        f'contacts["{group}"].restitution': np.repeat([[0.0], [0.0], [0.5], [0.2], [0.0]], count, 1),
        "gravity[0]": np.array([0.0, 5.0, 0.0, 0.0, -4.0]),
        "dt": np.array([5e-3, 5e-3, 4e-3, 5e-3, 3e-3]),
    }


@pytest.mark.parametrize("scheme", ["backward_euler", pytest.param("generalized_alpha", marks=SLOW)])
def test_dropped_on_a_slope(scheme):
    """Sticking, sliding and bouncing, over a factor of 100 in E, by both schemes; in the air before."""
    scene = dropped(scheme)
    loop, lanes = both(scene, sloped(scene[0]))
    (force,) = (each for name, each in loop.outputs.items() if name.startswith("force"))
    assert lanes.good.all() and (force.max(1) > 0).sum() >= 4
    same(loop, lanes, scene[0])


@SLOW
def test_in_the_true_cone():
    """At the default tolerance: rounding may still decide that the search of one variant ends at the limit, which its
    status then says; all others agree."""
    model, *rest = dropped(cone=True)
    scene = model.replace(tolerance=1e-8), *rest
    made, whole = both(scene, sloped(model)), len(sloped(model)["young"])
    assert all(set(each.status.tolist()) <= {0, int(Status.ITERATION_LIMIT)} for each in made)
    good = made[0].good & made[1].good
    assert good.sum() >= whole - 1
    for name in ("x", "v"):
        loop, lanes = (each[name][good] for each in made)
        np.testing.assert_allclose(
            lanes, loop, atol=1e-6 * np.abs(loop - (np.asarray(model.rest) if name == "x" else 0)).max()
        )


@SLOW
def test_in_single_precision():
    """As near to double precision as one after another is."""
    variants = {"young": np.array([1e5, 1e4])}
    loop, lanes = both(dropped(dtype=np.float32), variants)
    exact, _ = both(dropped(), variants)
    assert lanes["x"].dtype == np.float32 and lanes.good.all()
    off = [np.abs(each["x"] - exact["x"]).max() for each in (loop, lanes)]
    assert off[1] < 3 * off[0] + 1e-7


FLAT = jf.HeightField(np.zeros((3, 3)), origin=(-1, -1), spacing=(1, 1))
GROUNDS = {
    "sphere": (jf.Sphere(0.5), 0.501),
    "box": (jf.Box((0.5, 0.5, 0.1)), 0.051),
    "heights": (FLAT, 0.001),
    "function": (jf.SignedDistance(lambda place, _: place[2] + 0.1 * place[0] ** 2), 0.001),
}


@SLOW
@pytest.mark.parametrize("name", list(GROUNDS))
def test_other_grounds(name):
    ground, height = GROUNDS[name]
    scene = dropped(ground=ground, height=height)
    same(*both(scene, {"young": np.array([1e5, 1e4])}), scene[0])


@SLOW
def test_joints_and_soft_partners():
    """A box lies on another, which is held, and hangs by one corner on a soft pin, and by another on a rope."""
    first = jf.SoftBody(BOX.translated((0, 0, 0)), young=2e5, poisson=0.3, density=1e3, fixed="z-", name="low")
    second = jf.SoftBody(BOX.translated((0.02, 0.005, 0.042)), young=5e4, poisson=0.3, density=1e3, name="high")
    touch = jf.Contact("high", "low", friction=0.3)
    corner, other = (0.12, 0.065, 0.082), (0.02, 0.065, 0.082)
    joints = [
        jf.BallJoint("high", None, corner, name="pin", compliance=1e-4),
        jf.DistanceJoint("high", None, other, (0.02, 0.15, 0.12), rope=True, name="rope"),
    ]
    parts = {"contacts": [touch], "joints": joints, "gravity": (0, 0, -9.81)}
    scene = jf.build(jf.Scene([first, second], **parts), tolerance=1e-10)
    variants = {"young": np.array([[2e5, 5e4], [1e5, 2e4], [2e5, 5e4]]), "gravity[1]": np.array([0.0, -3.0, -3.0])}
    loop, lanes = both(scene, variants | {"joint.pin.compliance": np.array([1e-4, 1e-4, 1e-3])})
    same(loop, lanes, scene[0])
    assert np.abs(lanes["x"][1] - lanes["x"][2]).max() > 1e-4  # the joint tells them apart
    pulled = {name: np.abs(each).max() for name, each in lanes.outputs.items() if name.startswith("push")}
    assert sum("rope" in name or "distance" in name for name in pulled) == 1 and min(pulled.values()) > 0


def test_a_bad_lane_spoils_no_other():
    scene = dropped()
    options = {"dt": DT, "steps": STEPS, "every": 4, "outputs": KEPT, "engine": "lanes"}
    good = {"young": np.full(3, 1e5), "gravity[2]": np.full(3, -9.81)}
    bad = {"young": np.array([1e5, -1.0, 1e5]), "gravity[2]": np.array([-9.81, -9.81, -1e300])}
    clean, mixed = (jf.sweep(*scene, each, **options) for each in (good, bad))
    np.testing.assert_array_equal(mixed["x"][0], clean["x"][0])
    found = [Status(int(code)) for code in mixed.status]
    assert found[:2] == [Status.CONVERGED, Status.INVALID_VALUE] and found[2] != Status.CONVERGED
    model = scene[0].replace(max_iterations=scene[0].max_iterations * 0 + 1)
    assert {Status(int(code)) for code in jf.sweep(model, *scene[1:], good, **options).status} == {
        Status.ITERATION_LIMIT
    }


def slopes(scene, variants, names, outputs, engine):
    """Derivatives by (output, variable)."""
    options = {"dt": DT, "steps": STEPS, "every": STEPS, "outputs": outputs, "derivatives": names, "engine": engine}
    made = jf.sweep(*scene, variants, **options)
    assert made.good.all()
    return {(output, name): made.derivative(output, name) for output in outputs for name in names}


@pytest.mark.slow
def test_a_derivative_through_friction_is_that_of_rollouts():
    """The least of the kind, which runs each time; the tests below wait to be asked for."""
    scene = dropped(restitution=0.0)
    variants, put = {"gravity[0]": np.array([0.0, 5.0])}, {"z": lambda run: run.last.positions[0, 0]}
    want, found = (slopes(scene, variants, ["gravity[0]"], put, engine) for engine in ("loop", "lanes"))
    for key, value in want.items():
        assert np.abs(value).min() > 0
        np.testing.assert_allclose(found[key], value, rtol=1e-5)


@SLOW
@pytest.mark.parametrize(("scheme", "cone"), [("backward_euler", True), ("generalized_alpha", False)])
def test_derivatives_are_those_of_rollouts(scheme, cone):
    """Of what sticks and of what slides, forwards and backwards."""
    scene = dropped(scheme, cone=cone, restitution=0.0)
    variants = sloped(scene[0])
    (group,) = scene[0].contacts
    del variants[f'contacts["{group}"].restitution']
    variants = {name: each[[0, 1, 4]] for name, each in variants.items()}
    variants["state.velocities"] = np.random.default_rng(0).normal(0, 0.02, (3, *scene[2].velocities.shape))
    share = np.random.default_rng(1).normal(size=scene[0].rest.shape)
    whole = {"whole": lambda run: (run.last.positions * share).sum() + (run.last.velocities * share).sum()}
    few = ["young", "gravity[0]", "dt"]
    wanted = slopes(scene, variants, list(variants), whole, "loop")
    found = slopes(scene, variants, list(variants), whole, "lanes")
    for key, want in wanted.items():
        np.testing.assert_allclose(found[key], want, rtol=1e-5, atol=1e-6 * np.abs(want).max(), err_msg=str(key))
    places = {"x": lambda run: run.last.positions, "v": lambda run: run.last.velocities}
    forwards = slopes(scene, variants, few, places, "lanes")
    for name in few:
        found, want = sum((forwards[key, name] * share).sum((1, 2)) for key in places), wanted["whole", name]
        np.testing.assert_allclose(found, want, rtol=1e-5, atol=1e-6 * np.abs(want).max(), err_msg=name)


def test_one_after_another_unless_asked_for():
    options = {"dt": DT, "steps": 1, "outputs": {"x": "positions"}}
    made = sweeping.Sweep(*dropped(), {"young": [1e5]}, **options)
    assert made.engine.name == "loop" and "no faster" in made.reason
