"""Kinds of one's own are told apart by all that they are, and what no program would see of them is refused."""

import dataclasses
import functools
import os
import subprocess
import sys
from typing import Any, ClassVar

import numpy as np
import pytest

import jaxfem as jf
from jaxfem.io.checkpoints import scene_mark
from jaxfem.methods import Condensed
from jaxfem.pytrees import static
from jaxfem.rigid.shapes.base import Shape
from jaxfem.schemes import BackwardEuler

MESH = jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1))
SHEAR = jf.Constant("shear", "Pa", "must be > 0 Pa", low=0.0)


def beam(loads=(), **more):
    law = {"young": 2e5, "poisson": 0.3} if "material" not in more else {}
    options = {name: more.pop(name) for name in ("scheme", "solver", "rho_inf", "mass") if name in more}
    body = jf.SoftBody(MESH, density=1e3, fixed="x-", loads=loads, **law, **more)
    return jf.build(jf.Scene([body]), **options)


class HalfSteps:
    """Each step as two, of whatever stands behind it."""

    def step(self, model, params, state, dt, forces, cache):
        middle, _ = super().step(model, params, state, dt / 2, forces, cache)
        return super().step(model, params, middle, dt / 2, forces, cache)


class Slower:
    """Nine tenths of the velocity at each start."""

    def stage(self, state, prescribed, free, dt):
        made = super().stage(state, prescribed, free, dt)
        return made.replace(start=0.9 * made.start)


class Halves(HalfSteps, Condensed):
    name: ClassVar[str] = "halves_told_apart"


class Lossy(Slower, BackwardEuler):
    name: ClassVar[str] = "lossy_told_apart"


class Renamed(BackwardEuler):
    name: ClassVar[str] = "renamed_told_apart"


class Behind(Renamed, Lossy):
    name: ClassVar[str] = "behind_told_apart"


class Solves(Condensed):
    name: ClassVar[str] = "solves_told_apart"

    def solve(self, *given):
        return super().solve(*given)


class Steps(Condensed):
    """Whose step is another way to the same, as it says; it knows of no other solve."""

    as_it_is: ClassVar[bool] = True
    name: ClassVar[str] = "steps_told_apart"

    def step(self, *given):
        return super().step(*given)


def test_a_flag_does_not_outlive_the_hooks_that_it_speaks_of():
    """Whoever defines them: the class itself, one beside it, or one behind it in line."""
    assert Condensed.as_it_is and Steps.as_it_is and not Halves.as_it_is and not Solves.as_it_is
    for bases in ((Steps, Solves), (Solves, Steps)):
        assert not type("Both", bases, {"name": "both_told_apart"}).as_it_is
    assert Renamed.euler and Renamed.lanes and not (Lossy.euler or Lossy.lanes or Behind.euler or Behind.lanes)
    assert type("Same", (Condensed,), {"name": "same_told_apart"}).as_it_is
    wavy = type("Wavy", (jf.Plane,), {"distance": lambda self, point: point[2] - point[0] ** 2})
    assert jf.Plane.flat and type("Level", (jf.Plane,), {}).flat and not wavy.flat
    late = type("Late", (jf.Viscoelastic,), {"commit": lambda self, values, internal, *given: internal})
    assert jf.Viscoelastic.relaxes and type("Again", (jf.Viscoelastic,), {}).relaxes and not late.relaxes
    with pytest.raises(jf.SceneError, match='takes scheme = "backward_euler" alone, not "lossy_told_apart"'):
        beam(scheme="lossy_told_apart", solver="assembled")


@pytest.mark.slow
def test_sweeps_take_the_steps_of_a_class_beside():
    scene = beam(solver=Halves())
    swept = jf.sweep(*scene, {"young": np.array([2e5, 4e5])}, dt=1e-2, steps=2, outputs={"x": "positions"})
    assert swept.engine != "lanes" and swept.good.all()
    np.testing.assert_allclose(swept["x"][0, -1], jf.rollout(*scene, 1e-2, 2)[0].positions[-1], atol=1e-9)


def test_a_setting_of_the_method_that_is_given_to_build_is_told():
    with pytest.raises(jf.SceneError, match=r"it is one of the method: give solver=MassSpring\(calibration=...\)"):
        jf.build(jf.Scene([jf.SoftBody(MESH, 2e5, 0.3, density=1e3)]), solver="mass_spring", calibration="lloyd")


def test_methods_are_told_apart_by_all_their_fields():
    with pytest.raises(TypeError, match=r"Loose\.rounds is left out of comparison \(compare=False\)"):
        field = dataclasses.field(default=1, compare=False)
        type("Loose", (Condensed,), {"__annotations__": {"rounds": int}, "rounds": field, "name": "loose"})
    with pytest.raises(TypeError, match="Alike compares in a way of its own"):
        type("Alike", (Condensed,), {"__eq__": lambda self, other: True, "name": "alike"})


class Scaled(jf.Material, word="scaled_told_apart"):
    constants = (SHEAR,)
    factor = 1.0

    def __init__(self, factor=1.0, **given):
        super().__init__(**given)
        object.__setattr__(self, "factor", factor)

    def stiffness(self, values):
        return 4 * values["shear"] * self.factor, 2 * values["shear"] * self.factor


def test_a_law_whose_attributes_no_program_would_see_is_refused():
    with pytest.raises(jf.MaterialError, match="Scaled has the attribute factor, which no program would see: declare"):
        beam(material=Scaled(2.0, shear=1e5))


class Found(Scaled, word="found_told_apart"):
    factor = 1.0
    __init__ = jf.Material.__init__

    @functools.cached_property
    def half(self):
        return 0.5

    def stiffness(self, values):
        return 4 * self.half * values["shear"], 2 * self.half * values["shear"]


def test_what_a_law_finds_once_is_no_attribute_that_gets_lost():
    law = Found(shear=1e5)
    assert law.half == 0.5 and beam(material=law)[0].laws[0] == Found(shear=1e5).law


@pytest.mark.parametrize("hook", ["response", "commit", "rest_strain"])
def test_a_law_that_answers_for_a_memory_that_it_has_not_is_refused(hook):
    body = {"constants": (SHEAR,), "stiffness": Scaled.stiffness, hook: lambda self, *given: None}
    with pytest.raises(TypeError, match=f"has `{hook}` and no memory, so that it is never asked: define `internal0`"):
        type("Late", (jf.Material,), body, word="late")


class Hill(Shape):
    """Level ground, .2 m higher where its flag is True and no number."""

    mode: Any = static(default=1)

    def distance(self, point):
        return point[2] - (0.2 if self.mode is True else 0.0)


def test_equal_values_of_two_types_are_two_shapes():
    balls = [jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(place, 0, 0.31)) for place in (0.0, 1.0)]
    touch = [jf.Contact(ball, Hill(mode)) for ball, mode in zip(balls, (True, 1), strict=True)]
    scene = jf.build(jf.Scene(balls, contacts=touch))
    assert len(scene[0].contacts) == 2
    states, info = jf.rollout(*scene, 1e-2, 40)
    assert not info.status.any()
    np.testing.assert_allclose(states.rigid.positions[-1, :, 2], [0.3, 0.1], atol=1e-3)


def test_a_static_field_that_tells_nothing_apart_is_named():
    text = "its static field (mode|turned) cannot tell compiled programs apart .*: give a tuple"
    ball = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(0, 0, 1))
    with pytest.raises(jf.SceneError, match=text):
        jf.build(jf.Scene([ball], contacts=[jf.Contact(ball, Hill(mode=[1.0]))]))
    body = {"__annotations__": {"turned": Any}, "turned": static(default=()), "name": "listed_told_apart"}
    listed = type("Listed", (Renamed,), body)
    with pytest.raises(jf.SceneError, match=text):
        beam(scheme=listed(turned=np.zeros(2)))


def test_the_mark_of_a_run_knows_kinds():
    """By which `--resume` sees that a scene is another one, though its numbers are the same."""
    scenes = [
        beam(),
        beam(material=jf.NeoHookean(young=2e5, poisson=0.3)),
        beam(mass="consistent"),
        *(beam(scheme="generalized_alpha", rho_inf=share) for share in (0.8, 0.1)),
        *(beam(loads=[jf.Pressure(face, 10.0)]) for face in ("x+", "z+")),
        beam(strain="smoothed"),
    ]
    marks = [scene_mark(*scene[:2]) for scene in scenes]
    assert len({*marks}) == len(scenes)
    assert scene_mark(*beam()[:2]) == marks[0] == scene_mark(*beam(solver="assembled")[:2])


def test_the_mark_is_that_of_another_process():
    """Which writes the words of a set in another order, and keeps functions elsewhere."""
    code = (
        "import jaxfem as jf\nfrom typing import Any\nfrom jaxfem.io.checkpoints import scene_mark\n"
        "from jaxfem.pytrees import static\nfrom jaxfem.schemes import BackwardEuler\n"
        "words = frozenset({'alpha', 'beta', 'gamma', 'delta'})\n"
        "body = {'__annotations__': {'words': Any}, 'words': static(default=words), 'name': 'words'}\n"
        "made = type('Words', (BackwardEuler,), body)\n"
        "soft = jf.SoftBody(jf.mesh.box((1, 1, 1), 1), 1e5, 0.3, density=1e3)\n"
        "ground = jf.SignedDistance(lambda point, values: point[2] + 0.1)\n"
        "model, params, _ = jf.build(jf.Scene([soft], contacts=[jf.Contact(soft, ground)]), scheme=made())\n"
        "print(scene_mark(model, params))"
    )
    told = {
        subprocess.run(
            [sys.executable, "-c", code], env=os.environ | {"PYTHONHASHSEED": seed}, capture_output=True, check=True
        ).stdout
        for seed in ("1", "2")
    }
    assert len(told) == 1
