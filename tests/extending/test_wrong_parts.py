"""Joints and loads of one's own whose parts do not fit are refused in `build`, by name and with what to do."""

from dataclasses import field
from typing import Any

import numpy as np
import pytest

import jaxfem as jf
from jaxfem.declared.joints import Joint, Part
from jaxfem.declared.loads import Load
from jaxfem.loads import WeightedForce
from jaxfem.materials.quantities import positive
from jaxfem.pytrees import Pytree
from jaxfem.rows.locks import FrameLock, PointLock, Softness

BALL = jf.RigidBody(jf.Sphere(0.1), mass=1.0, name="ball")
OTHER = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(1, 0, 0), name="other")


def points(joint, bodies, where):
    return tuple(bodies.point(body, (0.0, 0.0, 0.0), where) for body in (joint.a, joint.b))


def frames(joint, bodies, where):
    return tuple(bodies.frame(body, np.eye(3), where) for body in (joint.a, joint.b))


class Own(Joint):
    """A point of each body; `made` (rows, values, word) says what else than a lock of these it is made of."""

    made: Any = None

    def parts(self, bodies, where):
        yield self.made(self, bodies, where)


def built(*made, **more):
    pairs = zip(made, (BALL, OTHER), strict=False)
    joints = [Own(None, body, made=each, name=f"pin{number}", **more) for number, (each, body) in enumerate(pairs)]
    return jf.build(jf.Scene([BALL, OTHER], joints=joints))


def lock(joint, bodies, where):
    return Part("point", PointLock(*points(joint, bodies, where)), joint.softness)


def turning(held, values=None):
    def made(joint, bodies, where):
        return Part("turn", FrameLock(*frames(joint, bodies, where), held), values or joint.softness)

    return made


class Kept(PointLock):
    """A lock with an array and a flag of its own."""

    more: Any = 0.0


def kept(more):
    return lambda joint, bodies, where: Part("kept", Kept(*points(joint, bodies, where), more), joint.softness)


def row(answer, **more):
    """Rows with another answer."""

    def rows(self, at, values, stage):
        return answer(PointLock.rows(self, at, values, stage))

    made = type("Wrong", (PointLock,), {"rows": rows, **more})
    return lambda joint, bodies, where: Part("wrong", made(*points(joint, bodies, where)), joint.softness)


class Twofold(Softness):
    """Softness with another number of the same name in fits."""

    more: Any = field(default=0.0, metadata=positive("compliance", "m/N", "another compliance"))


MADE = [
    (
        [lambda *given: lock(*given)._replace(values=Twofold(0.0, 0.0))],
        r"""the values of "point" call both compliance and more 'compliance' in fits: give one of them another name""",
    ),
    ([lambda *given: None], "`parts` yields None; it must yield a Part"),
    ([lambda *given: ("point", 1, 2)], r"`parts` yields \('point', 1, 2\)"),
    ([lambda *given: Part(3, *lock(*given)[1:])], "`parts` yields the word 3; give a text"),
    ([lambda *given: Part("point", None, 1.0)], 'the rows of "point" are None; give a JointRows'),
    ([lambda *given: lock(*given)._replace(values=Softness("soft", 0.0))], "compliance of the values .* is 'soft'"),
    (
        [lambda *given: lock(*given)._replace(values=Softness(True, 0.0))],
        "values .* is True; give a real number",
    ),
    ([lambda *given: lock(*given)._replace(values=None)], "the values of .* are None; a PointLock takes a Softness"),
    ([lambda *given: lock(*given)._replace(values=3.0)], "are 3.0; .* with compliance, damping"),
    ([row(lambda found: found, combined=lambda self, values: 3)], "`combined` gives 3; .* and their Range"),
    ([row(lambda found: found, idle=lambda self, values: None)], "`idle` of .* gives None; it must give a mapping"),
    ([kept("text")], 'more of the rows of "kept" of joint "pin0" is \'text\'; give a number, an index, a flag'),
    ([turning(3), turning(2)], 'the rows of "turn" have held = 2, where those of joint "pin0" have held = 3'),
    ([turning(3), turning(3, (1.0,))], 'the values of "turn" have .*, where those of joint "pin0" have a Softness'),
    ([kept(np.zeros(2)), kept(np.zeros(3))], r"have more of shape \(3,\), where those of joint .* have shape \(2,\)"),
    ([row(lambda found: None)], "`rows` gives None; it must give PointRows"),
    ([row(lambda found: found.replace(bias=found.bias[0]))], "`rows` gives"),
    ([row(lambda found: found.replace(compliance=found.compliance[:, :1]))], r"compliance = .* it must be \(1, 3\)"),
    ([row(lambda found: found.replace(jacobian=found.jacobian[:, :, :3]))], r"jacobian = .* must be \(1, 3, 6\)"),
    ([row(lambda found: found.replace(triples=1.0 * found.triples))], "triples = .* they must be indices"),
]


@pytest.mark.parametrize(("made", "text"), MADE, ids=range(len(MADE)))
def test_a_joint_is_told_what_is_wrong_with_its_parts(made, text):
    with pytest.raises(jf.SceneError, match=text):
        built(*made)


def test_parts_that_are_no_list_of_parts():
    none = type("Empty", (Joint,), {"parts": lambda self, bodies, where: None})
    with pytest.raises(jf.SceneError, match="`parts` gives None; it must yield a Part"):
        jf.build(jf.Scene([BALL], joints=[none(None, BALL)]))


@pytest.mark.parametrize(
    ("hook", "answer", "text"),
    [
        ("parts", [], "`parts` yields nothing; it must yield a Part"),
        ("open_by", None, '`open_by` of "Wrong", a Wrong, gives None; it must give a number and its unit'),
        ("open_by", ("far", "m"), "`open_by` of .* gives .'far', 'm'."),
        ("unused", None, '`unused` of "Wrong", Wrong, gives None; it must give a list of texts'),
        ("unused", "ab", "`unused` of .* gives 'ab'"),
    ],
)
def test_a_joint_is_told_which_answer_is_wrong(hook, answer, text):
    wrong = type("Wrong", (Own,), {hook: lambda self, *given: answer})
    with pytest.raises(jf.SceneError, match=text):
        jf.build(jf.Scene([BALL], joints=[wrong(None, BALL, made=lock)]))


def test_flags_among_the_arrays_of_rows_stay_flags():
    model, params, state = built(kept(True), kept(False))
    assert model.joints["kept world-rigid"].more.dtype == bool and model.joints["kept world-rigid"].more.tolist() == [
        True,
        False,
    ]
    _, info = jf.step(model, params, state, 1e-2)
    assert int(info.status) == 0


@pytest.mark.parametrize("name", ["compliance", "damping"])
def test_what_all_joints_inherit_is_used_or_refused(name):
    hard = turning(3, Softness(0.0, 0.0))
    built(hard)
    with pytest.raises(jf.SceneError, match=rf'joint "pin0" has {name} = 0.001, which a Own does not use'):
        built(hard, **{name: 1e-3})
    _, params, _ = built(lock, **{name: 1e-3})
    assert float(getattr(params.joints["point world-rigid"], name)[0]) == 1e-3


class Pushing(Load):
    """A force on all nodes, as `made` has it."""

    nodes: Any
    total: Any
    made: Any = None

    place, amount, unit = "nodes", "total", "N"

    def resolved(self, body, offset, dtype):
        return self.made


class Flat(Pytree):
    symmetric = True

    def force(self, value, positions):
        return value


@pytest.mark.parametrize(
    ("made", "text"),
    [
        (None, "`resolved` gives None; it must give a Pytree with `force`"),
        (Flat(), r"its force is an array of shape \(3,\).* here \(8, 3\)"),
        (type("Half", (), {"force": 1, "symmetric": True})(), "`resolved` gives a Half"),
        (WeightedForce(np.zeros((2, 1), int), np.ones(2)), None),
    ],
)
def test_a_load_is_told_what_is_wrong(made, text):
    body = jf.SoftBody(
        jf.mesh.box((1, 1, 1), 1),
        young=1e5,
        poisson=0.3,
        density=1e3,
        name="block",
        loads=[Pushing("all", (0, 0, 1.0), made)],
    )
    if text is None:
        with pytest.raises(ValueError):  # its own fault, in its own words
            jf.build(jf.Scene([body]))
        return
    with pytest.raises(jf.SceneError, match=f'a Pushing on "block": {text}'):
        jf.build(jf.Scene([body]))
