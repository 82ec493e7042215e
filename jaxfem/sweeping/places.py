"""Where a variable goes: names such as "young", 'young["beam"]', "gravity[2]" or "state.velocities".

Names are those by which Python reaches a number in `params`, with "state." before those of the state; behind a name may
stand indices. `dt` is the time step. The paths of fits are names too, like contact.floor.friction and velocity.ball.x.
"""

import dataclasses
import difflib
import re
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.model import Model, Params, State
from jaxfem.ranges import ranges_of
from jaxfem.sweeping.errors import SweepError

STEP, PATH = "dt", "path"
_TOKEN = re.compile(r"""\.?([A-Za-z_]\w*)|\[(\d+)\]|\["([^"]+)"\]|\['([^']+)'\]""")
Key = str | int


def known_names(model: Model, params: Params, state: State) -> dict[str, tuple[int, ...]]:
    """Names that can be swept, with the shape of the numbers behind each."""
    found: dict[str, tuple[int, ...]] = {STEP: ()}
    found |= {name: np.shape(value) for name, value in params.constants.items()}
    for each in (ranges_of(params.replace(constants={})), ranges_of(state, "state")):
        found |= {name: np.shape(value) for name, value, _ in each}
    return found


@dataclasses.dataclass(frozen=True)
class Place:
    """A variable's place: of which `root` ("dt", "params", "state", "path"), the `keys` that lead there, of a path of
    fits its `spot`."""

    name: str
    root: str
    keys: tuple[Key, ...]
    spot: Any = None


def place_of(name: str, model: Model, params: Params, state: State, value: np.ndarray) -> Place:
    """The place of a variable, of whose values (...) one is `value`; SweepError says what does not fit."""
    paths = _paths(name, model, params, state)
    if name in paths:
        if np.shape(value) != ():
            raise SweepError(f'"{name}" takes one number a variant, not an array of shape {np.shape(value)}')
        return Place(name, PATH, (name,), paths[name].spot)
    keys = _keys(name)
    root = STEP if name == STEP else "state" if keys and keys[0] == "state" else "params"
    place = Place(name, root, keys[1:] if root == "state" else keys)
    if root == STEP:
        if np.shape(value) != ():
            raise SweepError(f'"dt" takes one number a variant, not an array of shape {np.shape(value)}')
        return place
    try:
        placed(model, params, state, 1.0, [place], {name: jnp.asarray(value, model.rest.dtype)})
    except (AttributeError, KeyError, IndexError, TypeError) as problem:
        names = [*known_names(model, params, state), *paths]
        near = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
        hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(names)}"
        raise SweepError(f"there is nothing called {name!r} to sweep ({problem}): {hint}") from None
    return place


def _paths(name: str, model: Model, params: Params, state: State) -> dict[str, Any]:
    """The paths of fits, by name; none where the name is no such path at first sight."""
    first, dot, _ = name.partition(".")
    if not dot or first == "state" or first in params.constants:
        return {}
    from jaxfem.fitting.paths import placed_constants  # which takes lanes from here

    return dict(placed_constants(model, params, state))


def check_places(places: Sequence[Place]) -> None:
    """SweepError where the values of a variable would be lost, since one behind it sets all of the same number."""
    for number, first in enumerate(places):
        for second in places[number + 1 :]:
            if first.root == second.root and first.keys[: len(second.keys)] == second.keys:
                raise SweepError(
                    f"the values of {first.name!r} would be lost: {second.name!r} behind it sets the same number; give "
                    "the one of all before that of a part"
                )


def check_counts(places: Sequence[Place], state: State, variants: Mapping[str, np.ndarray], dtype: Any) -> None:
    """SweepError where a count or a flag that is remembered would be cut down to a whole number."""
    for place in places:
        if place.root != "state":
            continue
        held = jnp.result_type(_at(state, place.keys))
        if jnp.issubdtype(held, jnp.floating):
            continue
        given = variants[place.name]
        wrong = np.asarray(given, dtype).astype(held) != np.asarray(given)
        if wrong.any():
            raise SweepError(
                f'"{place.name}" is {np.asarray(given)[wrong][0]} in a variant, and holds {held} there: give whole '
                f"numbers of that type, as far as {np.dtype(dtype)} tells them apart"
            )


def _at(tree: Any, keys: tuple[Key, ...]) -> Any:
    """What the keys lead to."""
    for key in keys:
        tree = getattr(tree, str(key)) if dataclasses.is_dataclass(tree) else tree[key]
    return tree


def placed(
    model: Model, params: Params, state: State, dt: Any, places: list[Place], values: Mapping[str, Any]
) -> tuple[Params, State, Any]:
    """Params, state and dt with one variant's `values` in their places; pure."""
    for place in places:
        value = values[place.name]
        if place.root == STEP:
            dt = value
        elif place.spot is not None:
            params, state = place.spot.put(params, state, value)
        elif place.root == "state":
            state = _set(state, place.keys, value, place.name)
        elif place.keys[0] in params.constants:
            name = str(place.keys[0])
            params = params.replace(**{name: _constant(model, params.constants[name], place, value)})
        else:
            params = _set(params, place.keys, value, place.name)
    return params, state, dt


def _constant(model: Model, held: Any, place: Place, value: Any) -> Any:
    """A constant whole, or of one body, or of one entry."""
    if len(place.keys) == 1:
        if np.shape(value) not in ((), (len(model.bodies),), (model.elements.count,)):
            raise SweepError(
                f'the values of "{place.name}" have shape {np.shape(value)}; give a variant one number, one for each '
                f"of the {len(model.bodies)} bodies, or one for each of the {model.elements.count} elements"
            )
        return value
    held = jnp.asarray(held)
    if isinstance(place.keys[1], str):
        if place.keys[1] not in model.bodies:
            raise KeyError(f"no soft body {place.keys[1]!r}; there are {', '.join(model.bodies)}")
        if held.shape not in ((), (1,), (len(model.bodies),)):
            raise SweepError(f'"{place.name}" cannot be set: the scene gives this constant by elements')
        every = jnp.broadcast_to(held, (len(model.bodies),))
        return every.at[model.bodies.index(place.keys[1])].set(value)
    return _set(held, place.keys[1:], value, place.name)


def _set(tree: Any, keys: tuple[Key, ...], value: Any, name: str) -> Any:
    """`tree` with the value where the keys lead."""
    if not keys:
        if not _is_number(tree):
            raise KeyError("it holds several numbers: name one of them")
        if np.shape(value) != np.shape(tree):
            raise SweepError(
                f'the values of "{name}" have shape {np.shape(value)} a variant; there, {np.shape(tree)} is needed'
            )
        counted = isinstance(tree, jax.Array) and not jnp.issubdtype(tree.dtype, jnp.floating)
        return jnp.asarray(value, tree.dtype) if counted else value
    first, rest = keys[0], keys[1:]
    if dataclasses.is_dataclass(tree) and not isinstance(tree, type):
        return dataclasses.replace(tree, **{str(first): _set(getattr(tree, str(first)), rest, value, name)})
    if isinstance(tree, Mapping):
        return {**tree, first: _set(tree[first], rest, value, name)}
    if isinstance(tree, tuple | list) and isinstance(first, int):
        parts = [*tree[:first], _set(tree[first], rest, value, name), *tree[first + 1 :]]
        return getattr(type(tree), "_make", type(tree))(parts)
    held = jnp.asarray(tree)
    if not isinstance(first, int) or first >= (held.shape[0] if held.ndim else 0):
        raise IndexError(f"{first!r} leads nowhere in numbers of shape {held.shape}")
    return held.at[first].set(_set(held[first], rest, value, name))


def _is_number(tree: Any) -> bool:
    """Whether that is one array, and no group of them."""
    return isinstance(tree, int | float | jax.Array | np.ndarray | np.generic)


def _keys(name: str) -> tuple[Key, ...]:
    keys, at = list[Key](), 0
    while at < len(name):
        match = _TOKEN.match(name, at)
        if match is None:
            raise SweepError(
                f'{name!r} is no name of a number: write it like young, young["beam"], gravity[2] or loads[0][2]'
            )
        word, index, *quoted = match.groups()
        keys.append(int(index) if index is not None else word or quoted[0] or quoted[1])
        at = match.end()
    return tuple(keys)


def stacked(value: Any, dtype: Any) -> jax.Array:
    """Values of a chunk on the device."""
    return jnp.asarray(np.asarray(value), dtype)
