"""New kinds that cannot be are refused where they are defined or used, by name; none is passed over in silence."""

import dataclasses
from typing import Any, ClassVar

import numpy as np
import pytest
from derivatives import Parted

import jaxfem as jf
from jaxfem.cli.main import main
from jaxfem.declared.joints import Joint, Part
from jaxfem.declared.loads import Load
from jaxfem.inputs import Vector, takes
from jaxfem.io import parts
from jaxfem.io.fields import FIELDS, computed, frame_field
from jaxfem.loads import FacePressure
from jaxfem.materials.base import LAWS
from jaxfem.materials.constants import Constant
from jaxfem.methods import Condensed, ImplicitRotations
from jaxfem.rows.locks import PointLock
from jaxfem.schemes import BackwardEuler, GeneralizedAlpha, Scheme

MESH = jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1), name="beam")
SOFT = {"young": 1e5, "poisson": 0.3, "density": 1e3}
BALL = jf.RigidBody(jf.Sphere(0.1), mass=1.0)


def soft(**more):
    return jf.SoftBody(MESH, fixed="x-", **{**SOFT, **more})


class Follower(FacePressure):
    """A follower load of one's own, which does not say that it is symmetric, for it is not."""

    symmetric: ClassVar[bool] = False


@pytest.mark.slow
def test_equilibrium_under_a_follower_load_of_ones_own_has_its_true_derivative():
    model, params, state = jf.build(jf.Scene([soft(loads=[jf.Pressure("z+", 900.0)])], (0, 0, 0)), tolerance=1e-12)
    own = model.replace(loads=(Follower(model.loads[0].faces),))

    @Parted
    def tip(pressure):
        return jf.equilibrium(own, params.replace(loads=(pressure,)), state)[0].positions[-1, 2]

    (found,), h = tip.backwards(900.0), 0.5
    np.testing.assert_allclose(found, (tip(900.0 + h) - tip(900.0 - h)) / (2 * h), rtol=1e-5)


def test_a_scheme_on_rigid_bodies_alone_is_refused():
    class Damped(Scheme):
        name: ClassVar[str] = "damped_for_a_test"
        order: ClassVar[int] = 1
        rigid: ClassVar[bool] = True

        def stage(self, state, prescribed, free, dt): ...
        def advance(self, state, velocities, free, dt): ...

    with pytest.raises(jf.SceneError, match='scheme "damped_for_a_test" acts on the nodes of soft bodies'):
        jf.build(jf.Scene([BALL]), scheme=Damped())
    own = {"name": "another_for_a_test", "advance": lambda self, *given: BackwardEuler.advance(self, *given)}
    with pytest.raises(jf.SceneError, match='scheme "another_for_a_test" acts on the nodes of soft bodies'):
        jf.build(jf.Scene([BALL]), scheme=type("Another", (BackwardEuler,), own)())
    renamed = type("Renamed", (BackwardEuler,), {"name": "renamed_for_a_test"})
    assert jf.build(jf.Scene([BALL]), scheme=renamed())[0].scheme.euler  # by its rule
    with pytest.raises(TypeError, match=r'time scheme "half" \(Half\) has no `stage`'):
        type("Half", (Scheme,), {"name": "half"})


def test_a_method_that_rounds_would_pass_over_is_refused():
    @dataclasses.dataclass(frozen=True)
    class Thrice(Condensed):
        name = None

        def step(self, *given):
            raise AssertionError

    with pytest.raises(jf.SceneError, match="has a `step` of its own"):
        jf.build(jf.Scene([soft()]), solver=Thrice(), rotation_update="implicit")
    with pytest.raises(jf.SceneError, match="has no `round`"):
        jf.build(jf.Scene([soft()]), solver=ImplicitRotations(Condensed()), rotation_update="implicit")
    with pytest.raises(TypeError, match='calls itself "auto"'):
        type("Auto", (Condensed,), {"name": "auto"})


def test_a_fault_in_ones_own_method_is_not_taken_for_its_refusal():
    @dataclasses.dataclass(frozen=True)
    class Faulty(Condensed):
        name = None

        def plan(self, model, params, state):
            return np.zeros(2) + np.zeros(3)

    with pytest.raises(ValueError, match="could not be broadcast"):
        jf.build(jf.Scene([soft()]), solver=Faulty())


def test_scheme_damping_takes_rho_inf_or_refuses_it():
    with pytest.raises(ValueError, match=r"rho_inf = 0\.5 is no number"):
        jf.scheme_damping("backward_euler", [10.0], 0.01, rho_inf=0.5)
    named = jf.scheme_damping("generalized_alpha", [100.0], 0.01, rho_inf=0.1)
    np.testing.assert_allclose(jf.scheme_damping(GeneralizedAlpha(0.8), [100.0], 0.01, rho_inf=0.1), named)


def test_materials_are_equal_where_their_values_are():
    one, other = jf.Linear(young=1.0, poisson=0.3), jf.Linear(young=2.0, poisson=0.4)
    assert one != other and one == jf.Linear(young=1.0, poisson=0.3) and one.law == other.law
    assert len({one, other}) == 2 and len({one.law, other.law}) == 1


def test_laws_that_contradict_themselves():
    constant = jf.Constant("modulus", "Pa", "must be > 0 Pa", low=0.0)
    with pytest.raises(TypeError, match="has no `stiffness`"):
        type("Bare", (jf.Material,), {"constants": (constant,)}, word="bare")
    body = {"constants": (constant, constant), "stiffness": lambda self, values: (1.0, 1.0)}
    with pytest.raises(TypeError, match="two things called 'modulus'"):
        type("Twice", (jf.Material,), body, word="twice")
    assert "bare" not in LAWS and "twice" not in LAWS
    for wrong, text in (
        ({"name": "lambda"}, "plain Python name"),
        ({"low": 2.0, "high": 1.0}, "give low < high"),
        ({"low": 0.0, "default": -1.0}, "the default of nu2 is -1"),
        ({"low": -0.4, "high": 0.4}, "fits search its logarithm"),
        ({"name": 3}, "a constant is named 3"),
        ({"default": "a"}, "'nu2' has default = 'a': give a number, or None"),
        ({"default": np.ones(2)}, r"default = an array of shape \(2,\)"),
        ({"default": np.nan}, "the default of nu2 is nan"),
        ({"low": None}, "low = None: give a number"),
        ({"unit": 3}, "unit = 3: give a text"),
        ({"bounds": (3.0, 1.0)}, r"bounds = \(3.0, 1.0\): give two numbers, the lower one first"),
        ({"plausible": (1.0,)}, r"plausible = \(1.0,\): give two numbers"),
        ({"closed": "no"}, "closed = 'no': give True or False"),
        ({"transform": "log"}, "transform = 'log': give a Transform"),
        ({"doubt": 3}, "doubt = 3: give a number and a text"),
    ):
        with pytest.raises(TypeError, match=text):
            jf.Constant(**{"name": "nu2", "unit": "", "advice": "must be", **wrong})


class Pinned(Joint):
    """Two points, declared as the documentation shows."""

    first: Any = dataclasses.field(default=None, metadata=takes(Vector("m")))

    def parts(self, bodies, where):
        ends = bodies.point(self.a, self.first, where), bodies.point(self.b, self.first, where)
        yield Part("point", PointLock(*ends), self.softness)


@pytest.mark.parametrize(
    ("first", "text"),
    [(None, '"Pinned" needs `first`: give 3 finite numbers in m'), ((0, 0), "first of"), ((0, 0, np.nan), "first of")],
)
def test_a_joints_fields_are_checked_as_they_are_declared(first, text):
    with pytest.raises(jf.SceneError, match=text):
        jf.build(jf.Scene([BALL], joints=[Pinned(None, BALL, first=first)]))


def test_loads_are_checked_as_they_are_declared():
    with pytest.raises(TypeError, match=r'the load "halved" \(Halved\) needs'):
        type("Halved", (Load,), {"__annotations__": {"nodes": Any}, "place": "nodes"}, kind="halved")
    for force in ((0, -0.1), "abc", (0, 0, np.nan)):
        with pytest.raises(jf.SceneError, match='force of a NodalForce on "beam" is'):
            jf.build(jf.Scene([soft(loads=[jf.NodalForce("x+", force)])]))


def test_fields_of_the_frames_are_not_mistaken():
    with pytest.raises(ValueError, match='two fields of the frames are called "velocity"'):

        @frame_field("velocity", "m/s", "node")
        def _velocity(model, params, state):
            return state.velocities

    with pytest.raises(ValueError, match="\"edges\" is given on 'edge'"):
        frame_field("edges", "", "edge")(len)
    scene = jf.build(jf.Scene([soft()]))
    frame_field("short", "", "node")(lambda model, params, state: state.velocities[:3])
    try:
        with pytest.raises(ValueError, match=r'"short" has shape \(3, 3\); it needs an entry for each of the 12 nodes'):
            computed(*scene)
    finally:
        del FIELDS["short"]
    frame_field("nothing", "", "node")(lambda model, params, state: None)
    try:
        with pytest.raises(ValueError, match='the field "nothing" gives None; it must give an array'):
            computed(*scene)
    finally:
        del FIELDS["nothing"]
    frame_field("words", "", "node")(lambda model, params, state: np.full(12, "x"))
    try:
        with pytest.raises(ValueError, match=r'the field "words" gives an array .*; it must give an array of numbers'):
            computed(*scene)
    finally:
        del FIELDS["words"]


@pytest.mark.parametrize(
    ("part", "text"),
    [
        (np.zeros((2, 3)), r"gives an array of shape \(2, 3\) .*; it must give a Part of vertex, line, triangle"),
        (parts.Part(np.zeros((2, 3)), "quad", np.zeros((1, 4), int)), 'gives cells of the kind "quad"'),
        (parts.Part(np.zeros((2, 3)), "line", np.zeros(2, int)), r".* cells \(2,\); it needs points .* cells \(m, 2\)"),
        (parts.Part(np.zeros(3), "vertex", np.zeros((1, 1), int)), r"has points \(3,\)"),
    ],
)
def test_parts_of_the_frames_are_looked_at(part, text, monkeypatch):
    monkeypatch.setattr(parts, "PARTS", {"mine": lambda shown, state, points: part})
    with pytest.raises(ValueError, match=f'the part "mine" {text}'):
        parts.parts_of(None, None, np.zeros((0, 3)))
    monkeypatch.setattr(parts, "PARTS", {"mine": lambda shown, state, points: None})
    assert parts.parts_of(None, None, np.zeros((0, 3))) == {}


FILE = """
import jaxfem as jf


class Stiff(jf.Material, word="stiff_of_a_file"):
    constants = (jf.Constant("strain", "Pa", "must be > 0 Pa", low=0.0),)

    def stiffness(self, values):
        return 2 * values["strain"], values["strain"]
"""
SCENE = """
[time]
step = 0.01
steps = 1
[[body]]
mesh = { box = [1, 1, 1], cells = 1 }
material = "stiff_of_a_file"
density = 1e3
"""


def test_the_command_line_imports_ones_own_file_and_a_constant_may_not_hide_a_key(tmp_path, capsys):
    (tmp_path / "own.py").write_text(FILE)
    (tmp_path / "scene.toml").write_text(SCENE)
    scene = str(tmp_path / "scene.toml")
    assert main(["simulate", scene]) == 2
    assert "'material' in [[body]] 1 is 'stiff_of_a_file'" in capsys.readouterr().err
    try:
        assert main(["--import", str(tmp_path / "own.py"), "simulate", scene]) == 2
        assert "Stiff calls a constant or option 'strain', a key of every [[body]]" in capsys.readouterr().err
    finally:
        LAWS.remove("stiff_of_a_file")
    assert main(["simulate", scene, f"--import={tmp_path / 'none.py'}"]) == 2
    assert "none.py" in capsys.readouterr().err


def test_a_file_that_cannot_be_imported_is_named(tmp_path, capsys):
    (tmp_path / "json.py").write_text("x = 1")
    (tmp_path / "wrong.py").write_text("raise TypeError('no stage')")
    (tmp_path / "one_beside_it.py").write_text("VALUE = 3")
    (tmp_path / "with_a_neighbour.py").write_text("import one_beside_it")
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE)
    for given, text in (("json.py", "has the name of another module"), ("wrong.py", "wrong.py: no stage")):
        assert main(["--import", str(tmp_path / given), "simulate", str(scene)]) == 2
        assert text in capsys.readouterr().err
    assert main(["simulate", str(scene), "--import"]) == 2
    assert "--import needs a module" in capsys.readouterr().err
    assert main(["--import", str(tmp_path / "with_a_neighbour.py"), "simulate", str(scene)]) == 2
    assert "'material' in [[body]] 1" in capsys.readouterr().err


def test_names_that_sweeps_have_for_other_things_are_no_constants():
    class Timed(jf.Material):
        constants = (Constant("dt", "s", "must be > 0 s", low=0.0),)

        def stiffness(self, values):
            return values["dt"], values["dt"]

    with pytest.raises(jf.SceneError, match="calls a constant 'dt', which is something else in params"):
        jf.build(jf.Scene([jf.SoftBody(jf.mesh.box((1, 1, 1), 1), material=Timed(dt=1.0), density=1e3)]))


def test_a_method_with_an_init_of_its_own_is_refused():
    """Compiled programs tell methods apart by their fields: others would be shared."""
    with pytest.raises(TypeError, match="Hidden has an __init__ of its own"):
        type("Hidden", (Condensed,), {"name": None, "__init__": lambda self, share: None})


def test_a_shape_whose_solid_is_none_is_refused():
    class Flat(jf.Sphere):
        def mass_properties(self):
            return 1.0, np.zeros(3), np.zeros((3, 3))

    with pytest.raises(jf.SceneError, match=r'the shape of "flat", Flat, has mass_properties that no solid has'):
        jf.build(jf.Scene([jf.RigidBody(Flat(0.1), mass=1.0)]))
