"""What functions of a method of one's own answer is looked at in `build` or as its step is traced: by name, and what
it must be."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.materials.linear import POISSON
from jaxfem.methods import METHODS, Condensed, Mprgp
from jaxfem.methods.base import Elasticity
from jaxfem.solvers import describe
from jaxfem.solvers.status import SolveInfo, Status

BLOCK = jf.SoftBody(jf.mesh.box((0.1, 0.1, 0.1), 1), young=1e5, poisson=0.3, density=1e3, name="block")
BALL = jf.RigidBody(jf.Sphere(0.1), mass=1.0, name="ball")


def constant(name, unit=""):
    return jf.Constant(name, unit, "must be > 0", low=0.0)


SCALE = constant("scale")


def wrong(base=Condensed, **hooks):
    """A method of which these functions answer something else."""
    made = type("Wrong", (base,), {"name": "wrong", **hooks})
    METHODS.remove("wrong")
    return made()


def built(method, body=BLOCK, **more):
    return jf.build(jf.Scene([body]), solver=method, **more)


class Undecorated(Condensed):
    """A method as one would write it, without a decorator."""

    name: ClassVar[str] = "undecorated_for_a_test"
    rounds: int = 3


def test_a_method_is_a_frozen_dataclass_of_itself():
    assert Undecorated() == Undecorated(rounds=3) != Undecorated(rounds=4) and hash(Undecorated()) == hash(
        Undecorated()
    )
    with pytest.raises(AttributeError, match="a method does not change: make another Undecorated"):
        Undecorated().rounds = 2
    model, *_ = built(Undecorated(rounds=5))
    assert model.method.rounds == 5 and "rounds=5" in repr(model.method)
    with pytest.raises(jf.SceneError, match=r"has rounds = \[1\], by which no compiled program can tell"):
        built(Undecorated(rounds=[1]))


HOOKS = [
    ("refuses", lambda s, facts: True, "`refuses` gives True; it must give words that follow its name, or None"),
    ("plan", lambda s, *scene: {"way": "fast"}, r"`plan\['way'\]` gives 'fast'; it must give a tree of arrays"),
    ("start", lambda s, *scene: ("none",), r"`start\[0\]` gives 'none'"),
    ("constants", lambda s: [1.0], "`constants` gives .1.0.; it must give a mapping of Constant"),
    *(
        (
            "constants",
            lambda s, own=name: {constant(own): 1.0},
            f"`constants` gives a constant called '{name}', which is",
        )
        for name in ("density", "mass_damping", "gravity", "rigid", "replace", "dt", "delay")
    ),
    (
        "constants",
        lambda s: {constant("young"): 1.0},
        """`constants` gives .*'young', which params hold for the material of "block" .Linear.: read that value in""",
    ),
    (
        "constants",
        lambda s: {POISSON: 0.3},
        """`constants` gives .*'poisson', which params hold for the material of "block".*another name""",
    ),
    (
        "constants",
        lambda s: {constant("share"): 1.0, constant("share", "Pa"): 2.0},
        "`constants` gives 2 constants called 'share': rename all but one",
    ),
    (
        "constants",
        lambda s: {SCALE: None},
        "`constants` gives what it cannot: scale .* is None: give one num",
    ),
    (
        "constants",
        lambda s: {SCALE: np.nan},
        "`constants` gives what it cannot: scale .* is nan: it must be",
    ),
    ("constants", lambda s: {SCALE: "a"}, "`constants` gives what it cannot: scale .* is 'a': give one num"),
    (
        "constants",
        lambda s: {SCALE: (1.0, 2.0)},
        r"`constants` gives what it cannot: scale .* has shape \(2,\); give one number",
    ),
]


@pytest.mark.parametrize(("hook", "answer", "text"), HOOKS)
def test_a_method_is_told_which_answer_is_wrong(hook, answer, text):
    with pytest.raises(jf.SceneError, match=f'solver "wrong": {text}'):
        built(wrong(**{hook: answer}))


def stepped(base=Condensed, **more):
    """A step whose next state or info has something else."""

    def step(self, *given):
        following, info = base.step(self, *given)
        own = {name: answer(following) for name, answer in more.items()}
        info = info.replace(**{name: own.pop(name) for name in list(own) if hasattr(info, name)})
        return following.replace(**own), info

    return step


def solved(**more):
    return lambda self, *given: Condensed.solve(self, *given).replace(**more)


STAY = "as in the state that it was given"
STEPS = [
    ("step", lambda s, *given: None, jf.StepError, "gives None; it must give the next State and a StepInfo"),
    ("step", stepped(positions=lambda f: f.positions[:2]), jf.StepError, r"positions = .*; it must stay .*\(8, 3\)"),
    ("step", stepped(memory=lambda f: jnp.zeros(2)), jf.StepError, "gives another memory than it found"),
    ("step", stepped(accelerations=lambda f: f.positions), jf.StepError, f"accelerations = .* must stay None, {STAY}"),
    ("step", stepped(internal=lambda f: 1.0), jf.StepError, "internal = 1.0; it must stay None"),
    ("step", stepped(iterations=lambda f: None), jf.StepError, "an info whose iterations = None: give one integer"),
    ("step", stepped(residual=lambda f: jnp.ones(2)), jf.StepError, r"residual = .*\(2,\).*: give one real number"),
    ("step", stepped(status=lambda f: jnp.bool_(True)), jf.StepError, "an info whose status = .* bool: give one"),
    ("step", stepped(inverted=lambda f: "none"), jf.StepError, "an info whose inverted = 'none'"),
    ("step", stepped(counts=lambda f: {"a": "b"}), jf.StepError, r"info\.counts\['a'\] = 'b'; it must be an array"),
    ("prepare", lambda s, *given: {"a": "b"}, jf.StepError, r"`prepare\['a'\]` of .* gives 'b'; .* a tree of arrays"),
    ("solve", lambda s, *given: given[0].target, TypeError, "`solve` of the method .* it must give a Solved"),
    ("solve", solved(info=None), TypeError, "`solve` .* gives info = None; it must give a SolveInfo"),
    ("solve", solved(info=SolveInfo(0.0, 1, 0.0, 1)), TypeError, "an info whose status = 0.0: give one integer"),
    (
        "solve",
        solved(impulses="a"),
        TypeError,
        "impulses that are 'a'; it must give those of the rows: none; .* `solved_rows` says so",
    ),
    ("solve", solved(impulses={"a": 1.0}), TypeError, "impulses that are {'a': '1.0'}"),
]


@pytest.mark.parametrize(("hook", "answer", "error", "text"), STEPS)
def test_a_method_whose_step_is_none_is_named(hook, answer, error, text):
    scene = built(wrong(**{hook: answer}))
    with pytest.raises(error, match=text):
        jf.rollout(*scene, 1e-2, 2)


@pytest.mark.parametrize("answer", [lambda f: None, lambda f: f.rigid.replace(positions=f.rigid.positions[0])])
def test_rigid_bodies_stay_as_they_were_given(answer):
    scene = built(wrong(Mprgp, step=stepped(Mprgp, rigid=answer)), BALL)
    for call in (jf.step, lambda *given: jf.rollout(*given, 2)):
        with pytest.raises(jf.StepError, match=f'`step` of the method "wrong" gives rigid = .*, {STAY}'):
            call(*scene, 1e-2)


@pytest.mark.parametrize("answer", [None, "a", [1.0], {"a": None}, {3: np.zeros(2)}])
def test_impulses_that_are_no_arrays_by_name(answer):
    model, _, state = built(wrong(impulses=lambda self, *given: answer))
    with pytest.raises(jf.StepError, match=r'`impulses.* of the method "wrong" gives .*; it must give a mapping'):
        jf.impulses(model, state)


@pytest.mark.parametrize("answer", [3, (1.0, 2.0), Elasticity(1.0, np.zeros(3), 0.0)])
def test_an_elasticity_that_is_none(answer):
    scene = built(wrong(elasticity=lambda self, *given: answer))
    with pytest.raises(TypeError, match=r'`elasticity` of the method "wrong" gives .*; it must give an Elasticity'):
        jf.energies(*scene)


def test_one_number_of_whichever_library_is_a_number():
    for low in (0, 0.0, np.array(0.0), np.float32(0), jnp.float32(0)):
        jf.Constant("share", "", "must be > 0", low=low)
    with pytest.raises(TypeError):
        jf.Constant("share", "", "must be > 0", low=np.zeros(2))


def test_params_of_a_short_type_are_real_numbers():
    model, params, state = built(Condensed())
    short = params.replace(gravity=jnp.asarray(params.gravity, jnp.bfloat16))
    assert int(jf.step(model, short, state, 1e-2)[1].status) == 0


def test_rounds_that_are_none():
    scene = built(wrong(round=lambda self, *given: None), rotation_update="implicit")
    with pytest.raises(TypeError, match=r"`round` of Wrong gives None; it must give a Solved with velocities \(8, 3\)"):
        jf.step(*scene, 1e-2)


def test_a_status_that_is_none_is_told():
    for code in (99, -1, 99 + 3 * 256):
        assert Status(code) is Status.UNKNOWN and f"none of jaxfem.solvers.Status: {code}" in describe(code)
    assert describe([0, 99]).startswith("1 of 2: converged; 1 of 2: gave a status")
    for given in (None, "a"):
        with pytest.raises(TypeError, match=f"describe got {given!r}; give a status"):
            describe(given)
