"""Whether what a joint kind of one's own is made of can be used: each part, and all of a group together."""

import copy
import dataclasses
import functools
from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.answers import asked, described, is_array, odd_pair, static_flaw, structure
from jaxfem.building.bodies import BodyIndex
from jaxfem.declared.errors import SceneError
from jaxfem.declared.joints import Joint, Part
from jaxfem.materials.quantities import quantities_of
from jaxfem.model import Model, Params
from jaxfem.ranges import Range
from jaxfem.rows.attachments import Configuration
from jaxfem.rows.locks import JointRows
from jaxfem.rows.points import PointRows
from jaxfem.schemes import Stage

SOFT = ("compliance", "damping")
"""What all joints inherit."""


def checked_parts(joint: Joint, index: BodyIndex, where: str) -> list[Part]:
    """The parts of a joint; SceneError for what is none."""
    found: Any = joint.parts(index, where)
    if not isinstance(found, Iterable):
        raise SceneError(f"{where}: `parts` gives {described(found)}; it must yield a Part(word, rows, values) a time")
    parts = list(found)
    if not parts:
        raise SceneError(f"{where}: `parts` yields nothing; it must yield a Part for each kind of its rows")
    for part in parts:
        if not isinstance(part, Part):
            raise SceneError(f"{where}: `parts` yields {described(part)}; it must yield a Part(word, rows, values)")
        if not isinstance(part.word, str) or not part.word:
            raise SceneError(
                f"{where}: `parts` yields the word {part.word!r}; give a text, which names a group of rows"
            )
        if not isinstance(part.rows, JointRows):
            raise SceneError(f'{where}: the rows of "{part.word}" are {described(part.rows)}; give a JointRows')
        check_once(part.values, f'{where}: the values of "{part.word}"')
    return parts


def check_once(values: Any, of: str) -> None:
    """SceneError where two fields are one constant to fits: a fit of the one would set the other."""
    fields: dict[str, str] = {}
    for field, quantity in quantities_of(values):
        name = quantity.constant.name
        if (other := fields.setdefault(name, field)) != field:
            raise SceneError(f"{of} call both {other} and {field} {name!r} in fits: give one of them another name")


LEAVES = {
    "rows": ("biuf", "a number, an index, a flag, or an array of such; what is fixed for the program is `static()`"),
    "values": ("iuf", "a real number, or an array of such"),
}
"""Kinds of NumPy types that rows and values may hold, and words for them."""


def signature(part: Part) -> Any:
    """What all parts of one group share: structure, flags and shapes."""
    leaves, kind = jax.tree.flatten((part.rows, part.values))
    return kind, tuple(np.shape(leaf) for leaf in leaves)


def check_leaves(parts: Iterable[tuple[str, Part]]) -> None:
    """SceneError where the rows or values of (joint, part) hold what is no array, like a text."""
    for name, part in parts:
        needed = [] if part.rows.valued is None else [each.name for each in dataclasses.fields(part.rows.valued)]
        if not all(hasattr(part.values, each) for each in needed):
            raise SceneError(
                f'the values of "{part.word}" of joint "{name}" are {described(part.values)}; a '
                f"{type(part.rows).__name__} takes a {part.rows.valued.__name__}, with {', '.join(needed)}"
            )
        for what, (known, wanted) in LEAVES.items():
            for path, leaf in jax.tree_util.tree_flatten_with_path(getattr(part, what))[0]:
                if np.asarray(leaf).dtype.kind not in known:
                    place = jax.tree_util.keystr(path).lstrip(".")
                    of = f'the {what} of "{part.word}" of joint "{name}"'
                    raise SceneError(f"{place} of {of} is {described(leaf)}; give {wanted}")


def check_alike(part: Part, other: Part, where: str, whose: str) -> None:
    """SceneError where two parts of one word cannot be of one group; `whose`: the joint that the `other` is of."""
    if type(part.rows) is not type(other.rows):
        kinds = type(part.rows).__name__, type(other.rows).__name__
        raise SceneError(f'{where} calls its {kinds[0]} "{part.word}", as others call a {kinds[1]}: rename it')
    for what in ("rows", "values"):
        own, its = getattr(part, what), getattr(other, what)
        if flaw := _difference(own, its):
            raise SceneError(
                f'{where}: the {what} of "{part.word}" have {flaw[0]}, where those of {whose} have {flaw[1]}; all of '
                "one word are one group of arrays: give these a word of their own"
            )


def _difference(own: Any, its: Any) -> tuple[str, str] | None:
    """What two trees of one group differ in, in words for each; None where numbers alone do."""
    if structure(own) != structure(its):
        for field in dataclasses.fields(own) if dataclasses.is_dataclass(own) and type(own) is type(its) else ():
            pair = getattr(own, field.name), getattr(its, field.name)
            static = bool(field.metadata.get("static"))
            if pair[0] != pair[1] if static else structure(pair[0]) != structure(pair[1]):
                first, second = (f"{field.name} = {described(each)}" for each in pair)
                return first, second
        return f"{described(own)}", f"{described(its)}"
    pairs = zip(jax.tree_util.tree_flatten_with_path(own)[0], jax.tree.leaves(its), strict=True)
    for (path, leaf), other in pairs:
        if np.shape(leaf) != np.shape(other):
            name = jax.tree_util.keystr(path).lstrip(".")
            return f"{name} of shape {np.shape(leaf)}", f"shape {np.shape(other)}"
    return None


def check_softness(joint: Joint, index: BodyIndex, where: str, parts: list[Part], known: set[Any]) -> None:
    """SceneError for a compliance or damping of the joint's that none of its rows feels.

    With twice as much its parts must differ: seen once for each kind and its words, which are then `known`.
    """
    for name in SOFT:
        value, case = getattr(joint, name), (type(joint), name, *sorted({part.word for part in parts}))
        if not value or case in known:
            continue
        known.add(case)
        other = copy.copy(joint)
        object.__setattr__(other, name, 2 * value)
        both = parts, list(other.parts(index, where))
        leaves = [jax.tree.leaves([(part.rows, part.values) for part in each]) for each in both]
        if len(leaves[0]) == len(leaves[1]) and all(np.array_equal(*pair) for pair in zip(*leaves, strict=True)):
            raise SceneError(
                f"{where} has {name} = {value:g}, which a {type(joint).__name__} does not use: leave it out, or hand "
                f"`self.{name}` (or `self.softness`) to the rows in its `parts`"
            )


def check_rows(model: Model, params: Params) -> None:
    """SceneError for a group of joints whose `rows` are none; each kind of group is asked once, without numbers."""
    bodies = 0 if model.rigid is None else model.rigid.count
    for label, group in model.joints.items():
        leaves, kind = jax.tree.flatten((group.replace(names=()), params.joints[label]))
        shapes = tuple((leaf.shape, leaf.dtype) for leaf in leaves)
        asked_with = (kind, shapes, len(group.names), model.nodes, bodies, model.rest.dtype)
        if flaw := static_flaw(group) or _rows_flaw(*asked_with):
            names = ", ".join(dict.fromkeys(group.names[:3]))
            raise SceneError(f'{type(group).__name__}, the rows "{label}" of joints {names}: {flaw}')


@functools.lru_cache(maxsize=256)
def _rows_flaw(kind: Any, shapes: tuple[Any, ...], count: int, nodes: int, bodies: int, dtype: Any) -> str:
    def array(*shape: int) -> Any:
        return jax.ShapeDtypeStruct(shape, dtype)

    group, values = jax.tree.unflatten(kind, [jax.ShapeDtypeStruct(*each) for each in shapes])
    at = Configuration(array(nodes, 3), array(bodies, 3), array(bodies, 3, 3))
    stage = Stage(at.nodes, None, None, at.nodes, array(), array(), array())

    def ranged(found: Any) -> str:
        odd = odd_pair(found, Range)
        wanted = "a mapping of words to numbers (m,) and their Range"
        return "" if odd is None else f"`combined`{odd[0]} gives {described(odd[1])}; it must give {wanted}"

    def look(found: Any) -> str:
        if not isinstance(found, PointRows):
            return f"`rows` gives {described(found)}; it must give PointRows"
        m, r = count, jnp.shape(found.bias)[-1] if jnp.ndim(found.bias) == 2 else 1
        k = jnp.shape(found.triples)[-1] if jnp.ndim(found.triples) == 2 else 0
        block = [(m, r)]
        if jnp.shape(found.triples) != (m, k) or not jnp.issubdtype(found.triples.dtype, jnp.integer):
            return f"`rows` gives triples = {described(found.triples)}; they must be indices (m, k) of {m} joints"
        if not is_array(found.jacobian, [(m, r, 3 * k)], dtype):
            return f"`rows` gives jacobian = {described(found.jacobian)}; it must be {(m, r, 3 * k)}, (m, r, 3 k)"
        for name in ("compliance", "bias", "lower", "upper"):
            value = getattr(found, name)
            if not is_array(value, block, dtype) and not (value is None and name in ("lower", "upper")):
                return f"`rows` gives {name} = {described(value)}; it must be {(m, r)}, one number a row of each joint"
        if found.unknowns != nodes + 2 * bodies:
            return f"`rows` gives unknowns = {found.unknowns}; they are `at.unknowns`, {nodes + 2 * bodies} here"
        return ""

    flaw = asked(look, lambda own, *given: own.rows(*given), group, at, values, stage)
    return flaw or asked(ranged, lambda own, own_values: own.combined(own_values), group, values)
