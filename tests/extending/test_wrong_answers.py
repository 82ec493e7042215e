"""What functions of one's own kinds answer is looked at once, in `build`: a wrong one is named, and what it must be."""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.io import load_scene
from jaxfem.pytrees import static
from jaxfem.schemes import SCHEMES, Scheme, Stage

SHEAR = jf.Constant("shear", "Pa", "must be > 0 Pa", low=0.0)
MESH = jf.mesh.box((0.1, 0.1, 0.1), 1)


def numbered(cases):
    return [f"{hook}{number}" for number, (hook, *_) in enumerate(cases)]


def soft(material=None, **more):
    own = {"young": 1e5, "poisson": 0.3} if material is None else {"material": material}
    return jf.SoftBody(MESH, density=1e3, name="block", **own, **more)


class Plain(jf.Material):
    constants = (SHEAR,)

    def stiffness(self, values):
        return 4 * values["shear"], 2 * values["shear"]


class Flowing(Plain):
    """With a memory of all its strain."""

    def internal0(self, strain):
        return jnp.zeros_like(strain)

    def response(self, values, internal, dt, rows):
        return jf.Response((1.0, 1.0), -internal)

    def commit(self, values, internal, strain, dt, rows):
        return strain


class Energetic(jf.Nonlinear):
    constants = (SHEAR,)
    stiffness = Plain.stiffness

    def distortion(self, values, gradient, internal, dt):
        return values["shear"] * sum(gradient[i][j] ** 2 for i in range(3) for j in range(3))


TWICE = np.array([2.0, 2.0])
LAWS = [
    (Plain, "stiffness", lambda s, v: None, "`stiffness` gives None: it must give two values, 3K and 2 mu"),
    (Plain, "stiffness", lambda s, v: (v["shear"],) * 3, "`stiffness` gives .*, .*, .* must give two values"),
    (Plain, "stiffness", lambda s, v: (v["shear"] * TWICE, 1.0), r"`stiffness` gives .*shape \(2,\)"),
    (Plain, "stiffness", lambda s, v: (True, 1.0), "`stiffness` gives .True, 1.0."),
    (Plain, "damping", lambda s, v: TWICE, r"`damping` gives an array of shape \(2,\)"),
    (Flowing, "internal0", lambda s, e: {"state": "none"}, r"`internal0`\['state'\] is 'none'"),
    (Flowing, "response", lambda s, v, i, dt, r: (1.0, -i), "`response` gives .* a Response: two factors"),
    (Flowing, "response", lambda s, v, i, dt, r: jf.Response((1.0, 1.0), -i[0]), "`response` gives a Response"),
    (Flowing, "commit", lambda s, v, i, e, dt, r: None, "`commit` gives None: it must give what `internal0` gives"),
    (Flowing, "commit", lambda s, v, i, e, dt, r: e[0], r"`commit` gives an array of shape \(7,\)"),
    (Flowing, "internal_at_once", lambda s, v, e: [e], "`internal_at_once` gives"),
    (Flowing, "counts", lambda s, v, b, a, e, dt, r: {"many": e[0] > 0}, r"`counts`\['many'\] is an array"),
    (Flowing, "tensors", lambda s, v, i, e, r: {"flow": e[0]}, r"`tensors`\['flow'\] is .* strains \(r, D\)"),
    (Flowing, "dissipated", lambda s, v, b, a, e, w, dt, r: [e[0]], "`dissipated` is .*a mapping of words"),
    (Flowing, "stored", lambda s, v, i, w, r: 0.0, r"`stored` gives 0.0: it must give a density \(D,\), or None"),
    (Flowing, "rest_strain", lambda s, v, i, r: i[0], r"`rest_strain` gives .* a strain \(r, D\), or None"),
    (Energetic, "distortion", lambda s, v, h, i, dt: v["shear"], "`distortion` gives .* one number a domain"),
    (Energetic, "dilation", lambda s, h: None, "`dilation` gives None"),
]


@pytest.mark.parametrize(("law", "hook", "answer", "text"), LAWS, ids=numbered(each[1:] for each in LAWS))
def test_a_law_is_told_which_answer_is_wrong(law, hook, answer, text):
    wrong = type("Wrong", (law,), {hook: answer})
    with pytest.raises(jf.SceneError, match=f'Wrong, the material of "block": {text}'):
        jf.build(jf.Scene([soft(wrong(shear=1e5))]))


def test_a_law_that_makes_single_precision_double_is_named():
    double = type("Double", (Flowing,), {"commit": lambda s, v, i, e, dt, r: e * np.ones((1, 1))})
    jf.build(jf.Scene([soft(double(shear=1e5))]))
    with pytest.raises(jf.SceneError, match=r"`commit` gives an array of shape .* and type float64"):
        jf.build(jf.Scene([soft(double(shear=1e5))]), dtype=np.float32)


def test_laws_are_asked_for_what_bodies_give_them():
    """One number is fine alone; beside another body there is one an element."""
    scalar = type("Scalar", (Plain,), {"damping": lambda s, v: jnp.reshape(v["shear"], ()) * 0})
    jf.build(jf.Scene([soft(scalar(shear=1e5))]))
    with pytest.raises(TypeError, match="reshape"):  # its own fault, in its own words
        jf.build(jf.Scene([soft(scalar(shear=np.full(len(MESH.cells), 1e5)))]))


def test_what_a_law_declares_is_checked_where_it_is_defined():
    body = {"stiffness": Plain.stiffness}
    with pytest.raises(TypeError, match=r"\(Alone\) has constants = .*: give a tuple of Constant"):
        type("Alone", (jf.Material,), {**body, "constants": SHEAR}, word="alone")
    with pytest.raises(TypeError, match="has the option parts = None: give a flag, a number or a text"):
        type("Odd", (jf.Material,), {**body, "constants": (SHEAR,), "options": {"parts": None}}, word="odd")
    assert jf.Linear(young=1.0, poisson=0.3).linear and not Energetic(shear=1.0).linear


class Euler(Scheme):
    """Backward Euler, as one would write it."""

    order: ClassVar[int] = 1
    name = None

    def stage(self, state, prescribed, free, dt):
        return Stage(state.positions, None, None, state.velocities, dt, 1.0, dt)

    def advance(self, state, velocities, free, dt):
        return state.positions + dt * velocities, None


def half(self, state, prescribed, free, dt):
    return Euler.stage(self, state, prescribed, free, dt).replace(ahead=state.positions)


def staged(**more):
    def stage(self, state, prescribed, free, dt):
        return Euler.stage(self, state, prescribed, free, dt).replace(
            **{name: answer(state.positions, dt) for name, answer in more.items()}
        )

    return stage


ASKED = [
    ("stage", staged(base=lambda x, dt: x.astype(int)), r"`stage` gives base = .* \(n, 3\), of the type float64"),
    ("stage", staged(start=lambda x, dt: x.astype(np.float32)), "`stage` gives start = .* float32: it must be"),
    *[
        (
            "stage",
            staged(**{name: lambda x, dt: dt[None]}),
            rf"`stage` gives {name} = .*\(1,\).*: it must",
        )
        for name in ("reach", "follow", "weight")
    ],
    ("advance", lambda s, x, v, f, dt: (v.astype(np.float32), None), "`advance` gives .*, of the type float64"),
    ("begin", lambda s, x, a: a().astype(int), "`begin` gives .* of the type float64, or None"),
    ("stage", lambda s, *given: None, "`stage` gives None: it must give a Stage"),
    ("stage", half, "`stage` gives one of `ahead` and `before`: it must give both"),
    ("stage", lambda s, x, p, f, dt: Euler.stage(s, x, p, f, dt).replace(base=x.positions[0]), r".* base = .*\(n, 3\)"),
    (
        "stage",
        lambda s, x, p, f, dt: Euler.stage(s, x, p, f, dt).replace(weight=None),
        r".* weight = None: it must be one",
    ),
    ("advance", lambda s, x, v, f, dt: x.positions + dt * v, "`advance` gives an array .*: it must give two values"),
    ("advance", lambda s, x, v, f, dt: (x.positions, v), "`advance` gives .* positions .* and None, as `begin` does"),
    ("begin", lambda s, x, a: a()[0], r"`begin` gives an array of shape \(3,\)"),
]


@pytest.mark.parametrize(("hook", "answer", "text"), ASKED, ids=numbered(ASKED))
def test_a_scheme_is_told_which_answer_is_wrong(hook, answer, text):
    wrong = type("Wrong", (Euler,), {"name": f"wrong_{hook}", hook: answer})
    SCHEMES.remove(wrong.name)
    with pytest.raises(jf.SceneError, match=f'scheme "wrong_{hook}", a Wrong: {text}'):
        jf.build(jf.Scene([soft()]), scheme=wrong())


class Flagged(Euler):
    """Euler with a flag of the program and a flag that would be a number."""

    name: ClassVar[str] = "flagged_for_a_test"
    turned: Any = static(default=False)
    share: Any = 1.0

    def slope(self, turn):
        return turn[0]


def test_flags_and_numbers_of_a_scheme(tmp_path):
    model, _, _ = jf.build(jf.Scene([soft()]), scheme="flagged_for_a_test", turned=True)
    assert model.scheme.turned is True and float(model.scheme.share) == 1.0
    for share in (True, "half", None):
        with pytest.raises(jf.SceneError, match=r'share = .* of the scheme "flagged_for_a_test" is no number'):
            jf.build(jf.Scene([soft()]), scheme=Flagged(share=share))
    with pytest.raises(ValueError, match=r"`slope` of the scheme .* gives an array of shape"):
        jf.scheme_damping("flagged_for_a_test", [1.0, 2.0], 1e-2)
    real = type("Real", (Flagged,), {"slope": lambda self, turn: turn})
    with pytest.raises(ValueError, match=r"`slope` of the scheme .* it must give a complex array of shape \(2,\)"):
        jf.scheme_damping(real(), [1.0, 2.0], 1e-2)
    file = tmp_path / "scene.toml"
    body = "[[body]]\nmesh = { box = [1, 1, 1], cells = 1 }\nyoung = 1e5\npoisson = 0.3\ndensity = 1e3\n"
    file.write_text(
        f'[time]\nstep = 0.01\nsteps = 1\nscheme = "flagged_for_a_test"\nturned = true\nshare = 0.5\n{body}'
    )
    scheme = load_scene(file).scheme
    assert scheme.turned is True and scheme.share == 0.5


def test_numbers_of_a_scheme_stand_beside_its_name():
    scene = jf.Scene([soft()])
    here = jf.build(scene, scheme="generalized_alpha", rho_inf=0.3)[0].scheme
    there = jf.build(scene, scheme=jf.GeneralizedAlpha(rho_inf=0.3))[0].scheme
    assert float(here.rho_inf) == float(there.rho_inf) == 0.3
    with pytest.raises(jf.SceneError, match=r"toleranse = 1e-06 is no number of .*; did you mean build's `tolerance`"):
        jf.build(scene, toleranse=1e-6)
    with pytest.raises(ValueError, match='2 numbers are given for the scheme "generalized_alpha", which takes rho_inf'):
        jf.scheme_damping("generalized_alpha", 1.0, 1e-2, 0.5, 0.5)
