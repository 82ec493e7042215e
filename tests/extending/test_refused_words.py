"""What classes of one's own say of themselves, words, flags and numbers, is looked at where they are defined."""

import pytest

import jaxfem as jf
from jaxfem.io.fields import frame_field
from jaxfem.methods import Condensed
from jaxfem.schemes import BackwardEuler
from jaxfem.sweeping.outputs import Positions

MESH = jf.mesh.box((0.1, 0.1, 0.1), 1)
Pinned = jf.BallJoint


@pytest.mark.parametrize("word", [3, ("a", "b"), True])
@pytest.mark.parametrize(
    "defined",
    [
        lambda word: type("Odd", (jf.Material,), {"stiffness": len}, word=word),
        lambda word: type("Odd", (jf.Sphere,), {}, word=word),
        lambda word: type("Odd", (Pinned,), {}, kind=word),
        lambda word: type("Odd", (Pinned,), {}, kind="odd_for_a_test", variants={word: {}}),
        lambda word: type("Odd", (BackwardEuler,), {"name": word}),
        lambda word: type("Odd", (Condensed,), {"name": word}),
    ],
)
def test_a_word_that_is_no_text_is_refused(defined, word):
    with pytest.raises(TypeError, match=r"Odd (calls itself .*: give a word|has variants.*: give a mapping of words)"):
        defined(word)


@pytest.mark.parametrize(
    ("defined", "text"),
    [
        (lambda: type("Odd", (jf.Material,), {"stiffness": len, "relaxes": 3}, word="odd"), "has relaxes = 3"),
        (lambda: type("Odd", (BackwardEuler,), {"name": "odd", "order": True}), "has order = True: give an integer"),
        (lambda: type("Odd", (BackwardEuler,), {"name": "odd", "rigid": "a"}), "has rigid = 'a': give True or False"),
        (lambda: type("Odd", (jf.Sphere,), {"flat": 1.0}, word="odd"), "Odd has flat = 1.0: give True or False"),
        (lambda: type("Odd", (jf.Sphere,), {"crease": "a"}, word="odd"), "Odd has crease = 'a': give a number"),
        (lambda: type("Odd", (jf.Sphere,), {}, word="odd", leading="size"), "leads with 'size', .* fields radius"),
        (lambda: type("Odd", (jf.NodalForce,), {"unit": 3}, kind="odd"), r'"odd" \(Odd\) has unit = 3: give a text'),
        (lambda: type("Odd", (jf.NodalForce,), {"place": "force"}, kind="odd"), "has place = 'force': give \"nodes\""),
        (
            lambda: type("Odd", (Positions,), {"frames": "all"}, word="odd"),
            "has frames = 'all': give True",
        ),
        (lambda: type("Odd", (Condensed,), {"name": "odd", "nonlinear": "no"}), "has nonlinear = 'no'"),
        (lambda: type("Odd", (Pinned,), {}, kind="odd_for_a_test", variants={"a": {"b c": 1}}), "its fields are a, b"),
    ],
)
def test_what_a_class_says_of_itself_is_looked_at(defined, text):
    with pytest.raises(TypeError, match=text):
        defined()


@pytest.mark.parametrize(("name", "unit", "text"), [(3, "", "the name .* is 3"), ("odd", None, "the unit .* is None")])
def test_fields_of_the_frames_have_texts_for_name_and_unit(name, unit, text):
    with pytest.raises(ValueError, match=text):
        frame_field(name, unit, "node")


SHEAR = jf.Constant("shear", "Pa", "must be > 0 Pa", low=0.0)


@pytest.mark.parametrize(
    ("hook", "answer", "text"),
    [
        ("constants_of", 3, "Odd, by its `constants_of`, has constants = 3"),
        ("combined", 3, "`combined` of Odd gives 3"),
        ("combined", {"ratio": (1.0, 2.0)}, r"`combined`\['ratio'\] of Odd gives .*: .* a value and its Range"),
        ("doubts", 3, "`doubts` of the material of .*, Odd, gives 3; it must give a list of texts"),
        ("doubts", "ab", "`doubts` of the material of .*, Odd, gives 'ab'"),
    ],
)
def test_a_law_is_told_which_words_are_wrong(hook, answer, text):
    body = {"constants": (SHEAR,), "stiffness": lambda self, values: (4 * values["shear"], 2 * values["shear"])}
    odd = type("Odd", (jf.Material,), {**body, hook: lambda self, *given: answer})
    if hook == "constants_of":
        odd.constants_of = classmethod(lambda cls, options: answer)
    with pytest.raises((TypeError, jf.SceneError), match=text):
        jf.build(jf.Scene([jf.SoftBody(MESH, material=odd(shear=1e5), density=1e3)]))
