"""Whether what a scheme of one's own answers can be used: asked once, before anything is compiled, without numbers."""

import functools
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.answers import asked, described, is_array, is_exact, static_flaw
from jaxfem.pytrees import Pytree
from jaxfem.schemes.base import Scheme, Stage

COUNT = 7
"""Nodes that a scheme is asked about."""
FIELD = (COUNT, 3)
NUMBERS = [(), (COUNT, 1)]


class Nodes(Pytree):
    """What a scheme sees of a state."""

    positions: Any
    velocities: Any
    accelerations: Any


def scheme_flaw(scheme: Scheme, dtype: Any) -> str:
    """What is wrong with a scheme's answers, in words that follow its name; empty where nothing is."""
    leaves, kind = jax.tree.flatten(scheme)
    if flaw := static_flaw(scheme):
        return flaw
    return _flaw(kind, tuple(jnp.shape(leaf) for leaf in leaves), dtype)


@functools.lru_cache(maxsize=64)
def _flaw(kind: Any, shapes: tuple[Any, ...], dtype: Any) -> str:
    scheme = jax.tree.unflatten(kind, [jax.ShapeDtypeStruct(shape, dtype) for shape in shapes])
    return next((flaw for flaw in _flaws(scheme, dtype) if flaw), "")


def _flaws(scheme: Any, dtype: Any) -> Iterator[str]:
    field, dt = jax.ShapeDtypeStruct(FIELD, dtype), jax.ShapeDtypeStruct((), dtype)
    free = jax.ShapeDtypeStruct((COUNT, 1), jnp.bool_)
    carries: list[bool] = []

    def begun(found: Any) -> str:
        carries.append(found is not None)
        if found is None or is_exact(found, [FIELD], dtype):
            return ""
        return f"`begin` gives {described(found)}: it must give accelerations (n, 3) of the type {dtype}, or None"

    def staged(found: Any) -> str:
        if not isinstance(found, Stage):
            return f"`stage` gives {described(found)}: it must give a Stage"
        return next((flaw for flaw in _stage_flaws(found, dtype) if flaw), "")

    def advanced(found: Any) -> str:
        pair = isinstance(found, tuple) and len(found) == 2 and is_exact(found[0], [FIELD], dtype)
        if pair and (is_exact(found[1], [FIELD], dtype) if carries[0] else found[1] is None):
            return ""
        second = "accelerations (n, 3), as `begin` does" if carries[0] else "None, as `begin` does"
        wanted = f"two values, positions (n, 3) and {second}, of the type {dtype}"
        return f"`advance` gives {described(found)}: it must give {wanted}"

    yield asked(begun, lambda s, x: s.begin(Nodes(x, x, None), lambda: x), scheme, field)
    first = Nodes(field, field, field if carries[0] else None)
    yield asked(staged, lambda s, *given: s.stage(*given), scheme, first, field, free, dt)
    yield asked(advanced, lambda s, *given: s.advance(*given), scheme, first, field, free, dt)


def _stage_flaws(stage: Stage, dtype: Any) -> Iterator[str]:
    for name in ("base", "ahead", "before", "start"):
        value, optional = getattr(stage, name), name in ("ahead", "before")
        if not (is_exact(value, [FIELD], dtype) or (optional and value is None)):
            wanted = f"(n, 3), of the type {dtype}" + (" or None" if optional else "")
            yield f"`stage` gives {name} = {described(value)}: it must be {wanted}"
    for name in ("reach", "follow", "weight"):
        value = getattr(stage, name)
        if not is_array(value, NUMBERS, dtype):
            yield f"`stage` gives {name} = {described(value)}: it must be one number, or (n, 1)"
    if (stage.ahead is None) != (stage.before is None):
        yield "`stage` gives one of `ahead` and `before`: it must give both, or None for both"
