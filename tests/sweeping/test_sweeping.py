"""jf.sweep: each variant is what a rollout of its own gives, and has a status of its own."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import beam

import jaxfem as jf
from jaxfem import sweeping
from jaxfem.solvers import Status
from jaxfem.sweeping.outputs import PointPath
from jaxfem.sweeping.result import write_csv
from jaxfem.sweeping.taking import Taken

CELLS, TIP, DT, STEPS = (2, 1, 1), (0.1, 0.015, 0.015), 5e-3, 10


@pytest.fixture(scope="module")
def scene():
    return beam(CELLS)


def test_variants_are_rollouts_of_their_own(scene, tmp_path):
    """Constants, an entry of a vector, the start and the time step; five variants in chunks of two, one of them bad."""
    model, params, state = scene
    kicks = np.random.default_rng(0).normal(0, 0.1, (5, *state.velocities.shape)) * np.asarray(model.free)[:, None]
    variants = {
        "young": np.array([1e5, 2e5, -1.0, 1e6, 1e5]),
        "gravity[2]": np.linspace(-10, 10, 5),
        "state.velocities": kicks,
        "dt": np.array([5e-3, 5e-3, 5e-3, 2e-3, 5e-3]),
    }
    seen = []
    result = jf.sweep(
        *scene,
        variants,
        dt=DT,
        steps=STEPS,
        every=5,
        outputs={"tip": PointPath(TIP), "energy": "energies", "speed": lambda run: jnp.abs(run.last.velocities).max()},
        width=2,
        engine="loop",
        progress=lambda *told: seen.append(told),
    )
    assert [told[:2] for told in seen] == [(2, 5), (4, 5), (5, 5)] and seen[-1][2] == 0
    assert result.good.tolist() == [True, True, False, True, True]
    assert Status(int(result.status[2])) == Status.INVALID_VALUE and "young" in str(result)
    for lane in (0, 1, 3, 4):
        own = params.replace(
            young=variants["young"][lane], gravity=params.gravity.at[2].set(variants["gravity[2]"][lane])
        )
        start = state.replace(velocities=jnp.asarray(kicks[lane]))
        states, _ = jf.rollout(model, own, start, variants["dt"][lane], STEPS, every=5)
        tip = sweeping.outputs.PointPath(TIP).measured(model)
        run = sweeping.Observed(model, own, start, states, None, DT)
        np.testing.assert_allclose(result["tip"][lane], tip(run), atol=1e-9)
        np.testing.assert_allclose(result["speed"][lane], jnp.abs(states.velocities[-1]).max(), rtol=1e-7)
        last = jf.energies(model, own, run.last)
        np.testing.assert_allclose(result["energy.elastic"][lane, -1], last.elastic, rtol=1e-6)
    columns = result.columns()
    assert "tip[1][2]" in columns and "state.velocities[0][0]" not in columns  # more than a table shows
    read = sweeping.table(result.to_csv(tmp_path / "sweep.csv"))
    np.testing.assert_array_equal(read["tip[1][2]"], result["tip"][:, 1, 2])


def test_contacts_paths_and_engines_agree():
    """A ball falls on a plate: vmap and one after another give the same, and the force on the plate is its weight. A
    contact's friction and a body's speed are named as fits name them."""
    ball = jf.RigidBody(jf.Sphere(0.05), mass=0.2, position=(0, 0, 0.05), name="ball")
    scene = jf.build(jf.Scene([ball], contacts=[jf.Contact(ball, jf.Plane(normal=(0, 0, 1)), name="floor")]))
    (group,) = scene[0].contacts
    variants = {"rigid.mass[0]": [0.1, 0.4], "contact.floor.friction": [0.0, 0.5], "velocity.ball.x": [0.1, 0.3]}
    variants = sweeping.table({name: np.array(each) for name, each in variants.items()})
    outputs = {"force": "contact_forces", "pose": "rigid"}
    made = [
        jf.sweep(*scene, variants, dt=DT, steps=STEPS, outputs=outputs, engine=engine) for engine in ("loop", "vmap")
    ]
    for result in made:
        assert result.good.all()
        np.testing.assert_allclose(result[f"force.{group}"][:, -1], 9.81 * variants["rigid.mass[0]"], rtol=1e-4)
    np.testing.assert_allclose(made[0]["pose.positions"], made[1]["pose.positions"], atol=1e-9)
    moved = made[0]["pose.positions"][:, -1, 0, 0]
    np.testing.assert_allclose(moved[0], 0.1 * DT * STEPS, rtol=1e-6)
    assert 0 < moved[1] < 0.95 * 0.3 * DT * STEPS  # friction sets it rolling
    assert made[0].engine == "loop" and made[0].reason == "asked for"
    with pytest.raises(jf.SweepError, match="there is no output 'push': there are force"):
        made[0]["push"]


def test_what_compiling_took_is_told_for_one_chunk_too(scene):
    result = jf.sweep(*scene, {"young": np.array([1e5, 2e5])}, dt=1e-2, steps=1, outputs={"x": "positions"})
    assert 0 < result.compiling < result.seconds and f"{result.compiling:.1f} s of them compiling" in str(result)


def test_a_change_of_the_users_own(scene):
    """Values that have no place go to `change`; frequencies rise with the root of stiffness."""

    def scaled(params, state, values):
        return params.replace(young=values["factor"] * params.young), state

    outputs = {"f": sweeping.outputs.Frequencies(2)}
    result = jf.sweep(*scene, {"factor": [1.0, 4.0]}, change=scaled, dt=DT, steps=1, outputs=outputs, engine="loop")
    np.testing.assert_allclose(result["f"][1], 2 * result["f"][0], rtol=1e-6)


@pytest.mark.slow
def test_derivatives_are_those_of_a_rollout(scene):
    """Of an output by `jax.grad` and `jax.jvp` of one's own rollout, forwards and backwards."""
    model, params, state = scene

    def height(young, gravity, velocities):
        own, start = params.replace(young=young, gravity=gravity), state.replace(velocities=velocities)
        return jf.rollout(model, own, start, DT, 5)[0].positions[-1, -1, 2]

    moving = 0.1 * np.asarray(model.free)[:, None] * np.ones((2, 1, 3))
    variants = {"young": np.array([1e5, 3e5]), "gravity": np.array([[0, 0, -9.81], [1, 0, -5]])}
    variants["state.velocities"] = moving
    kept = {"tip": lambda run: run.last.positions[-1, 2], "all": lambda run: run.last.positions}
    options = {"dt": DT, "steps": 5, "every": 5, "engine": "loop"}
    for outputs in (kept, {"tip": kept["tip"]}):  # forwards, then backwards
        names = ["gravity", "state.velocities"]
        result = jf.sweep(*scene, variants, outputs=outputs, derivatives=names, **options)
        for lane in range(2):
            want = jax.grad(height, (1, 2))(*(jnp.asarray(each[lane]) for each in variants.values()))
            for name, each in zip(names, want, strict=True):
                found = result.derivative("tip", name)[lane]
                np.testing.assert_allclose(found, each, rtol=1e-6, atol=1e-9 * np.abs(each).max())
    assert result.derivative("tip", "state.velocities").shape == (2, *state.velocities.shape)


def test_samples():
    grid = sweeping.grid({"a": [1, 2], "b": [3, 4, 5]})
    assert grid["a"].tolist() == [1, 1, 1, 2, 2, 2] and grid["b"].tolist() == [3, 4, 5] * 2
    ranges = {"young": (1e4, 1e6, "log"), "density": (900, 1100)}
    for draw in (sweeping.random, sweeping.latin_hypercube):
        made, again, other = draw(ranges, 16, 3), draw(ranges, 16, 3), draw(ranges, 16, 4)
        assert all((made[name] == again[name]).all() and (made[name] != other[name]).any() for name in ranges)
        assert (made["young"] >= 1e4).all() and (made["young"] <= 1e6).all() and len(made["density"]) == 16
    share = np.log(sweeping.latin_hypercube(ranges, 16)["young"] / 1e4) / np.log(100)
    assert sorted(np.floor(16 * share).astype(int)) == list(range(16))  # each part met once


def test_tables_keep_every_bit(tmp_path):
    values = {"x": np.random.default_rng(1).normal(size=5), "n": np.arange(5)}
    read = sweeping.table(write_csv(tmp_path / "t.csv", values))
    assert all((read[name] == values[name]).all() for name in values)


@dataclasses.dataclass(frozen=True)
class Answering(sweeping.outputs.Output):
    """An output of one's own, without a word, that answers what it holds."""

    answer: Any

    def measured(self, model):
        return self.answer


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"variants": {"yuong": [1.0]}}, "did you mean 'young'"),
        ({"variants": {"young": [1.0], "poisson": [0.1, 0.2]}}, "differ in how many values"),
        ({"variants": {"gravity": [1.0, 2.0]}}, r"there, \(3,\) is needed"),
        ({"variants": {"gravity[3]": [1.0]}}, "leads nowhere"),
        ({"variants": {'young["bar"]': [1.0]}}, "no soft body 'bar'; there are beam"),
        ({"variants": {}}, "at least one name"),
        ({"variants": {"young": ["soft"]}}, "no numbers"),
        ({"variants": {"young": np.ones((1, 4))}}, "one for each of the 1 bodies"),
        ({"outputs": {}}, "needs outputs"),
        ({"outputs": {"tip": "points"}}, "known are point"),
        ({"outputs": {"tip": "point"}}, "needs more than its word"),
        ({"outputs": {"tip": PointPath((9, 9, 9))}}, "outside the bodies"),
        ({"outputs": {"force": "contact_forces"}}, "no contacts"),
        ({"derivatives": ["poisson"]}, "give names of variables of this sweep: young"),
        ({"derivatives": ["young"], "outputs": {"n": lambda run: run.infos.iterations}}, "floating-point"),
        ({"engine": "fast"}, "known are auto, "),
        ({"width": 0}, "whole number of at least 1"),
        ({"variants": [1e5]}, "give a mapping from names"),
        ({"variants": {"gravity.xx": [1.0]}}, "did you mean 'gravity.x'"),
        ({"variants": {"gravity.x": [[1.0, 2.0]]}}, '"gravity.x" takes one number a variant'),
        ({"variants": {"state": [1.0]}}, "holds several numbers"),
        ({"variants": {"loads": [[0.0, 0.0, 1.0]]}}, "holds several numbers"),
        ({"variants": {'young["beam"]': [1e5], "young": [2e5]}}, "would be lost: 'young' behind it"),
        ({"outputs": "energies"}, "outputs are 'energies'; a sweep needs outputs"),
        ({"outputs": {3: "energies"}}, "3 is no name of an output"),
        ({"outputs": {"tip": PointPath}}, r"the class PointPath: give one of it"),
        ({"outputs": {"tip": PointPath((0, np.nan, 0))}}, 'output "tip": the point is .* give x, y and z'),
        ({"outputs": {"tip": PointPath("tip")}}, "give x, y and z"),
        ({"outputs": {"f": sweeping.outputs.Frequencies(2.5)}}, 'output "f": count is 2.5: give a whole number'),
        ({"outputs": {"f": sweeping.outputs.Frequencies(999)}}, 'output "f": count is 999'),
        (
            {"outputs": {"f": Answering(None)}},
            'output "f": `measured` of Answering gives None; .* a function of the run',
        ),
        (
            {"outputs": {"f": Taken(Answering(lambda run: 1.0))}},
            "gives 1.0; it must give an array with an entry for each",
        ),
        ({"outputs": {"f": lambda run: {}}}, 'output "f" gave nothing; give an array'),
        ({"change": lambda params, state, values: params}, "change gave a Params; give"),
        ({"devices": []}, "give some of jax.local_devices"),
        ({"devices": 2}, "give some of jax.local_devices"),
    ],
)
def test_mistakes(scene, changes, message):
    options = {"variants": {"young": [1e5]}, "outputs": {"energy": "energies"}, **changes}
    with pytest.raises(jf.SweepError, match=message):
        jf.sweep(*scene, options.pop("variants"), dt=DT, steps=STEPS, **options)


def test_an_output_that_raises_is_named(scene):
    """What a user's own function raises is left, with a note; so is what it raises as it meets traced values."""
    for own, error in ((lambda run: 1 / 0, ZeroDivisionError), (lambda run: float(run.last.time), TypeError)):
        with pytest.raises(error) as raised:
            sweeping.Sweep(*scene, {"young": [1e5]}, dt=DT, steps=STEPS, outputs={"mine": own})
        assert 'in output "mine" of a sweep' in raised.value.__notes__[0]


def test_a_step_that_cannot_be_is_its_variants_own(scene):
    """The first one too; and names are written with either quotes, widths as NumPy's numbers."""
    variants = {"dt": [-1.0, 5e-3], "young['beam']": [1e5, 1e5]}
    made = sweeping.Sweep(*scene, variants, dt=DT, steps=STEPS, outputs={"e": "energies"}, width=np.int64(2))
    assert made.width == 2 and made.task.places[1].keys == ("young", "beam")


@pytest.mark.parametrize(("ranges", "count"), [({"a": (2, 1)}, 3), ({"a": (0, 1, "log")}, 3), ({"a": (0, 1)}, 0)])
def test_mistakes_of_ranges(ranges, count):
    with pytest.raises(jf.SweepError):
        sweeping.random(ranges, count)


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (lambda: sweeping.grid({"a": ["soft"]}), "give a list of numbers"),
        (lambda: sweeping.grid([1.0]), "give a mapping from names"),
        (lambda: sweeping.grid({name: range(1000) for name in "abc"}), "1000000000 variants are more"),
        (lambda: sweeping.random({"a": (0, 1)}, 10**13), "are more than"),
        (lambda: sweeping.random({"a": (0, 1)}, 2, seed=-1), "seed is -1"),
        (lambda: sweeping.latin_hypercube([("a", (0, 1))], 2), "give a mapping from names"),
        (lambda: sweeping.table(None), "None is no table"),
    ],
)
def test_mistakes_of_samples(draw, message):
    with pytest.raises(jf.SweepError, match=message):
        draw()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no variants"),
        ("a,b\n\n1,2\n3\n", "line 4 .* has 1 cells, and the first one 2 names"),
        ("a,b\n1,2\n3,\n", "\"b\" in line 3 .* is '', which is no number"),
        ("a,a\n1,2\n", "names a variable twice"),
    ],
)
def test_mistakes_of_tables(tmp_path, text, message):
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(jf.SweepError, match=message):
        sweeping.table(tmp_path / "t.csv")
