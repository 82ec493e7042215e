"""Frozen dataclasses as JAX sees them: kinds that differ in nothing but their class are never taken for each other."""

import dataclasses
import enum
import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.answers import without_hash
from jaxfem.pytrees import Pytree, outline, static

KINDS = 150


def like(names, words=()):
    """A class with these fields, of which `words` belong to the structure."""
    fields = {name: None for name in names} | {word: static(default="") for word in words}
    return type("Like", (Pytree,), {"__annotations__": dict.fromkeys(fields, Any), **fields})


@pytest.mark.parametrize(("names", "words"), [((), ()), (("x",), ()), (("x", "y"), ("word",))])
def test_classes_of_equal_fields_have_structures_of_their_own(names, words):
    one, two = like(names, words)(), like(names, words)()
    assert jax.tree.structure(one) == jax.tree.structure(type(one)())
    assert jax.tree.structure(one) != jax.tree.structure(two)
    assert jax.tree.structure({"in": [one]}) != jax.tree.structure({"in": [two]})
    assert outline(one) != outline(two)


def test_no_kind_runs_the_program_of_another():
    """By the hashes of the structures alone, of which seven bits are compared, some of so many would."""
    kinds = [like(("x",)) for _ in range(KINDS)]
    number = {kind: place for place, kind in enumerate(kinds)}
    told = jax.jit(lambda whole: whole.x + number[type(whole)])
    zero = jnp.zeros((), jnp.int32)
    assert [int(told(kind(zero))) for kind in kinds] == list(range(KINDS))


class Text(str):
    """A text of another kind."""

    def __repr__(self):
        return f"Text({super().__repr__()})"


def below(made):
    """All classes under one, as the package defines them."""
    for each in made.__subclasses__():
        yield from below(each)
        if each.__module__.startswith("jaxfem."):
            yield each


def test_no_two_classes_that_there_are_have_one_structure():
    structures = []
    for made in below(Pytree):
        blank = object.__new__(made)
        blank.__dict__.update(dict.fromkeys(made.__dataclass_fields__))
        structures.append(jax.tree.structure(blank))
    assert len(structures) > 40
    assert all(one != two for one, two in itertools.combinations(structures, 2))


def test_leaves_names_and_statics_come_back():
    whole = like(("x", "y"), ("word",))(x=jnp.ones(2), y=None, word="here")
    named, structure = jax.tree.flatten_with_path(whole)
    assert [jax.tree_util.keystr(path) for path, _ in named] == [".x"]
    again = jax.tree.unflatten(structure, [leaf for _, leaf in named])
    assert again.word == "here" and again.y is None and np.array_equal(again.x, whole.x)
    assert jax.tree.structure(whole.replace(word="there")) != structure
    with pytest.raises(AttributeError):
        again.x = 0.0


class Converts:
    """What would be done again each time that a program makes the object again."""

    def __post_init__(self):
        object.__setattr__(self, "x", 2 * self.x)


@pytest.mark.parametrize("own", ["__init__", "__post_init__"])
def test_what_programs_would_not_do_once_is_refused(own):
    with pytest.raises(TypeError, match=f"Own has {own} of its own: programs make it again from its fields alone"):
        type("Own", (Pytree,), {"__annotations__": {"x": Any}, own: lambda self, x=0: None})
    with pytest.raises(TypeError, match="Inherits has __post_init__ of its own"):
        type("Inherits", (Converts, Pytree), {"__annotations__": {"x": Any}})


class Level(enum.IntEnum):
    UP = 1


class Other(enum.IntEnum):
    DOWN = 1


@pytest.mark.parametrize(
    ("one", "two"),
    [(True, 1), (1, 1.0), (0.0, -0.0), (Level.UP, Other.DOWN), ((1, (True,)), (1, (1,))), ("a", Text("a"))],
)
def test_values_that_python_takes_for_equal_have_programs_of_their_own(one, two):
    made = like(("x",), ("word",))
    told = jax.jit(lambda whole: whole.x + len(repr(whole.word)))
    pair = [made(x=jnp.zeros(()), word=value) for value in (one, two)]
    assert outline(pair[0]) != outline(pair[1]) and outline(pair[0]) == outline(made(x=jnp.ones(()), word=one))
    assert [int(told(each)) for each in pair] == [len(repr(value)) for value in (one, two)]
    assert type(jax.tree.map(jnp.ones_like, pair[1]).word) is type(two)


def test_static_fields_without_a_hash_are_found_within_others():
    outer, inner = like(("x",)), like((), ("word",))
    assert without_hash(outer(x=(1.0, {"a": inner(word=[1])}))) == "word"
    assert without_hash(outer(x=inner(word=(1,)))) == without_hash(1.0) == ""


def test_a_field_that_the_constructor_does_not_take_is_refused():
    with pytest.raises(TypeError, match=r"Half\.x is left out of its constructor \(init=False\): make it a property"):
        type("Half", (Pytree,), {"__annotations__": {"x": Any}, "x": dataclasses.field(default=0.0, init=False)})


def test_a_state_of_another_kind_is_refused():
    state = jf.build(jf.Scene([jf.RigidBody(jf.Sphere(1.0), mass=1.0)]))[2]
    with pytest.raises(ValueError, match="different types"):
        jax.tree.map(lambda one, two: one, state.rigid, like(vars(state.rigid))(**vars(state.rigid)))
