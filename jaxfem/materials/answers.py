"""Whether what a law of one's own answers can be used: asked once, before anything is compiled, without numbers."""

import functools
from collections.abc import Callable, Iterator
from typing import Any

import jax

from jaxfem.answers import alike, asked, described, is_array, odd_entry, odd_leaf
from jaxfem.materials.base import Material
from jaxfem.materials.nonlinear import Nonlinear
from jaxfem.tensors import matrix_of

COUNT = 7
"""Domains that a law is asked about: no other number of its arrays."""


class Question:
    """What a law is asked with: `values` of its constants, one an element where they are `spread`; the strain's `rows`.

    Arrays are shapes alone.
    """

    def __init__(self, law: Material, spread: frozenset[str], rows: slice, dtype: Any):
        self.law, self.rows, self.dtype = law, rows, dtype
        self.values = {each.name: self.array(*[COUNT] * (each.name in spread)) for each in law.constants}
        self.count = rows.stop - rows.start
        self.strain, self.dt = self.array(self.count, COUNT), self.array()

    def array(self, *shape: int) -> jax.ShapeDtypeStruct:
        """An array's shape and type."""
        return jax.ShapeDtypeStruct(shape, self.dtype)

    def numbers(self, value: Any) -> bool:
        """Whether a value is one number, or one a domain."""
        return is_array(value, [(), (COUNT,)], self.dtype)

    def asked(self, hook: str, wanted: str, good: Callable[[Any], bool], call: Callable[..., Any], *given: Any) -> str:
        """What is wrong with a hook's answer: that it is not `good`."""

        def look(answer: Any) -> str:
            return "" if good(answer) else f"`{hook}` gives {described(answer)}: it must give {wanted}"

        return asked(look, call, *given)

    def asked_words(self, hook: str, count: tuple[int, ...], wanted: str, call: Callable[..., Any], *given: Any) -> str:
        """The same of a hook that gives arrays by their words."""

        def look(answer: Any) -> str:
            odd = odd_entry(answer, [count, *[(6, COUNT)] * (len(count) == 2)], self.dtype)
            return "" if odd is None else f"`{hook}`{odd[0]} is {described(odd[1])}: it must give {wanted}"

        return asked(look, call, *given)


@functools.lru_cache(maxsize=512)
def law_flaw(law: Material, spread: frozenset[str], start: int, stop: int, dtype: Any) -> str:
    """What is wrong with a law's answers, in words; empty where nothing is. Each kind of question is asked once.

    `spread`: constants that are given one an element; `start`, `stop`: rows of the strain that it is asked for.
    """
    question = Question(law, spread, slice(start, stop), dtype)
    return next((flaw for flaw in _flaws(question) if flaw), "")


def _flaws(question: Question) -> Iterator[str]:
    law, number = question.law, "one number, or one a domain (D,), in the type of its values"
    yield question.asked(
        "stiffness",
        f"two values, 3K and 2 mu [Pa], each {number}",
        lambda pair: isinstance(pair, tuple | list) and len(pair) == 2 and all(map(question.numbers, pair)),
        law.stiffness,
        question.values,
    )
    yield question.asked("damping", f"{number} [s]", question.numbers, law.damping, question.values)
    memory = _remembered(question)
    if isinstance(memory, str):
        yield memory
        return
    if isinstance(law, Nonlinear):
        yield from _nonlinear_flaws(question, law, memory)
    if memory is not None:
        yield from _memory_flaws(question, memory)


def _remembered(question: Question) -> Any:
    """Shapes of what is remembered, None without a memory; a text that says what is wrong with it."""
    found: list[Any] = []

    def look(answer: Any) -> str:
        if (odd := odd_leaf(answer)) is not None:
            return f"`internal0`{odd[0]} is {described(odd[1])}: it must give a tree of arrays, or None for no memory"
        found.append(jax.eval_shape(lambda: answer))
        return ""

    return asked(look, question.law.internal0, question.strain) or found[0]


def _nonlinear_flaws(question: Question, law: Nonlinear, memory: Any) -> Iterator[str]:
    gradient = question.array(3, 3, COUNT)
    each = "an array (D,), one number a domain, in the type of its values"
    domains = functools.partial(is_array, shapes=[(COUNT,)], dtype=question.dtype)

    def shape(values: Any, gradient: Any, internal: Any, dt: Any) -> Any:
        return law.distortion(values, matrix_of(gradient), internal, dt)

    dt = None if memory is None else question.dt
    if question.rows.stop > 1 and type(law).distortion is not Nonlinear.distortion:
        given = (question.values, gradient, memory, dt)
        yield question.asked("distortion", f"{each}, of energy [J/m^3]", domains, shape, *given)
    yield question.asked("dilation", each, domains, lambda h: law.dilation(matrix_of(h)), gradient)


def _memory_flaws(question: Question, memory: Any) -> Iterator[str]:
    law, rows, values, strain, dt = question.law, question.rows, question.values, question.strain, question.dt
    domains = functools.partial(is_array, shapes=[(COUNT,)], dtype=question.dtype)
    every = functools.partial(is_array, shapes=[(question.count, COUNT)], dtype=question.dtype)

    def with_rows(hook: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *given: hook(*given, rows)

    def answers(found: Any) -> bool:
        if not isinstance(found, tuple) or len(found) != 2 or not isinstance(found[0], tuple) or len(found[0]) != 2:
            return False
        return all(map(question.numbers, found[0])) and every(found[1])

    if not isinstance(law, Nonlinear):
        yield question.asked(
            "response",
            "a Response: two factors, each a number or one a domain (D,), and an offset (r, D)",
            answers,
            with_rows(law.response),
            *(values, memory, dt),
        )
    same = "what `internal0` gives, in the same shapes and types"
    yield question.asked("commit", same, lambda v: alike(v, memory), with_rows(law.commit), values, memory, strain, dt)
    yield question.asked("internal_at_once", same, lambda v: alike(v, memory), law.internal_at_once, values, strain)
    step = (values, memory, memory, strain)
    yield question.asked_words("counts", (), "a mapping of words to one number each", with_rows(law.counts), *step, dt)
    told = "a mapping of words to strains (r, D)"
    yield question.asked_words("tensors", (question.count, COUNT), told, with_rows(law.tensors), values, memory, strain)
    lost = "a mapping of words to densities (D,)"
    yield question.asked_words("dissipated", (COUNT,), lost, with_rows(law.dissipated), *step, strain, dt)
    kept = "a density (D,), or None"
    yield question.asked("stored", kept, or_none(domains), with_rows(law.stored), values, memory, strain)
    rest = "a strain (r, D), or None"
    yield question.asked("rest_strain", rest, or_none(every), with_rows(law.rest_strain), values, memory)


def or_none(good: Callable[[Any], bool]) -> Callable[[Any], bool]:
    """The same check, that lets None pass."""
    return lambda value: value is None or good(value)
