"""Whether params have the structure and the shapes of those that `build` returned; on the host, once a call.

Shapes alone are looked at: traced params and lanes of a batch have them too.
"""

import dataclasses
import functools
from collections.abc import Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.answers import described
from jaxfem.loads import ResolvedLoad
from jaxfem.model import Model, Params
from jaxfem.pytrees import outline
from jaxfem.stepping.errors import StepError

TOGETHER = "params and model belong together: use the params that build returned, with changes"


def check_outline(model: Model, params: Params) -> None:
    """StepError that names the first of params, constants apart, that is not what the scene has there.

    A load takes values of another shape where its force does, as one for each node in place of one for all.
    """
    bare = params.replace(constants={})
    if model.outline is None or outline(bare) == model.outline:
        return
    structure, shapes = model.outline
    dtype = model.rest.dtype
    wanted: Params = jax.tree.unflatten(structure, [jax.ShapeDtypeStruct(shape, dtype) for shape in shapes])
    if isinstance(bare.loads, tuple) and len(bare.loads) == len(wanted.loads):
        every = zip(model.loads, bare.loads, wanted.loads, strict=True)
        bare = bare.replace(loads=tuple(like if _serves(model, load, own, like) else own for load, own, like in every))
    for name, flaw in _flaws(bare, wanted, ""):
        raise StepError(f"{name} {flaw}")


def _serves(model: Model, load: ResolvedLoad, value: Any, like: Any) -> bool:
    """Whether a load takes a value as it takes what is `like` this one: of as many components, that give it a force."""
    shape = getattr(value, "shape", None)
    if shape is None or shape[-1:] != like.shape[-1:]:
        return False
    leaves, kind = jax.tree.flatten(load)
    rest = model.rest.shape, model.rest.dtype
    return _forces_all(kind, tuple((jnp.shape(leaf), jnp.result_type(leaf)) for leaf in leaves), shape, rest)


@functools.lru_cache(maxsize=256)
def _forces_all(kind: Any, leaves: tuple[Any, ...], shape: tuple[int, ...], rest: tuple[Any, Any]) -> bool:
    """Whether a load of such leaves makes a force on all nodes of a value of that shape; looked at once for each."""
    load: Any = jax.tree.unflatten(kind, [jax.ShapeDtypeStruct(*leaf) for leaf in leaves])
    given = jax.ShapeDtypeStruct(shape, rest[1]), jax.ShapeDtypeStruct(*rest)
    try:
        force: Any = jax.eval_shape(lambda own, *given: own.force(*given), load, *given)
    except (TypeError, ValueError):
        return False
    return bool(force.shape == rest[0])


def _flaws(given: Any, wanted: Any, name: str) -> Iterator[tuple[str, str]]:
    """(name, what is wrong) of each place where a tree is not of the structure and shapes of another."""
    if isinstance(wanted, jax.ShapeDtypeStruct):
        found = getattr(given, "shape", None)
        if found != wanted.shape:
            known = f"is {described(given)}" if found is None else f"has shape {found}"
            yield name, f"{known}; give {_words(wanted.shape)}"
    elif dataclasses.is_dataclass(wanted):
        if type(given) is not type(wanted):
            yield f"params.{name}", f"is {described(given)} where the scene has a {type(wanted).__name__}: {TOGETHER}"
            return
        for field in dataclasses.fields(given):
            where = f"{name}.{field.name}" if name else field.name
            yield from _flaws(getattr(given, field.name), getattr(wanted, field.name), where)
    elif isinstance(wanted, Mapping):
        if not isinstance(given, Mapping) or given.keys() != wanted.keys():
            held = sorted(map(str, given)) if isinstance(given, Mapping) else described(given)
            yield f"params.{name}", f"holds {held}; the scene's groups are {sorted(wanted)}"
            return
        for key in wanted:
            yield from _flaws(given[key], wanted[key], f'{name}["{key}"]')
    elif isinstance(wanted, tuple | list):
        yield from _entry_flaws(given, wanted, name)
    elif given is not wanted and given != wanted:  # None, and flags of values
        yield f"params.{name}", f"is {described(given)} where the scene has {described(wanted)}: {TOGETHER}"


def _entry_flaws(given: Any, wanted: Any, name: str) -> Iterator[tuple[str, str]]:
    """Of a tuple; an array serves, of which each row is an entry."""
    if not isinstance(given, tuple | list) and not getattr(given, "shape", ()):
        yield f"params.{name}", f"is {described(given)}; give a tuple of {len(wanted)} values"
    elif len(given) != len(wanted):
        yield f"params.{name}", f"holds {len(given)} values; the scene declares {len(wanted)}"
    else:
        for number, (own, like) in enumerate(zip(given, wanted, strict=True)):
            yield from _flaws(own, like, f"{name}[{number}]")


def _words(shape: tuple[int, ...]) -> str:
    if not shape:
        return "one number"
    if shape == (3,):
        return "three numbers"
    return f"an array of shape {shape}, such as jnp.full({shape}, value)"
