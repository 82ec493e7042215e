"""Where numbers stand in params and state beyond the materials' constants, and how values get there; pure."""

import dataclasses
from collections.abc import Mapping
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.model import Params, State
from jaxfem.rigid.dynamics import turned
from jaxfem.rotation import rotation_vector_to_matrix

Array = jax.Array
Keys = tuple[str | int, ...]


class Spot(Protocol):
    """Where a number stands. Static, hashable."""

    def read(self, params: Params, state: State) -> float:
        """Its value."""

    def put(self, params: Params, state: State, value: Array) -> tuple[Params, State]:
        """Params and state with the value there; pure."""


@dataclasses.dataclass(frozen=True)
class Entries:
    """The same number in several arrays of params: (keys that lead to an array, entries of its first axis; None: all
    of it)."""

    places: tuple[tuple[Keys, tuple[int, ...] | None], ...]

    def read(self, params: Params, state: State) -> float:
        """Their mean."""
        found = [np.asarray(_at(params, keys)) for keys, _ in self.places]
        parts = [
            each if where is None else each[list(where)] for each, (_, where) in zip(found, self.places, strict=True)
        ]
        return float(np.mean(np.concatenate([part.ravel() for part in parts])))

    def put(self, params: Params, state: State, value: Array) -> tuple[Params, State]:
        """The value in all of them."""
        for keys, where in self.places:
            held = jnp.asarray(_at(params, keys))
            new = jnp.broadcast_to(value, held.shape) if where is None else held.at[np.array(where)].set(value)
            params = _with(params, keys, new.astype(held.dtype))
        return params, state


@dataclasses.dataclass(frozen=True)
class Factor:
    """A multiple of load number `load` as the scene declares it."""

    load: int

    def read(self, params: Params, state: State) -> float:
        """1, as declared."""
        return 1.0

    def put(self, params: Params, state: State, value: Array) -> tuple[Params, State]:
        """The load times the value."""
        return _with(params, ("loads", self.load), jnp.asarray(params.loads[self.load]) * value), state


@dataclasses.dataclass(frozen=True)
class Turn:
    """A turn [rad] of gravity about a world axis from the direction that the scene gives; its strength stays."""

    axis: int

    def read(self, params: Params, state: State) -> float:
        """0, as declared."""
        return 0.0

    def put(self, params: Params, state: State, value: Array) -> tuple[Params, State]:
        """Gravity turned."""
        gravity = jnp.asarray(params.gravity)
        vector = value * jnp.eye(3, dtype=gravity.dtype)[self.axis]
        return params.replace(gravity=(rotation_vector_to_matrix(vector) @ gravity).astype(gravity.dtype)), state


@dataclasses.dataclass(frozen=True)
class Start:
    """A component of the velocity with which a body starts: of the `field` of `state` or, with `rigid`, of
    `state.rigid`, on its `rows`, those that move freely. A soft body keeps what its nodes move by beside their mean."""

    field: str
    rigid: bool
    rows: tuple[int, ...]
    axis: int

    def read(self, params: Params, state: State) -> float:
        """The mean of the rows."""
        return float(np.mean(np.asarray(getattr(self._holder(state), self.field))[list(self.rows), self.axis]))

    def put(self, params: Params, state: State, value: Array) -> tuple[Params, State]:
        """The rows' mean moved to the value."""
        holder = self._holder(state)
        held = jnp.asarray(getattr(holder, self.field))
        rows = np.array(self.rows)
        shift = (value - jnp.mean(held[rows, self.axis])).astype(held.dtype)
        changed = dataclasses.replace(holder, **{self.field: held.at[rows, self.axis].add(shift)})
        return params, state.replace(rigid=changed) if self.rigid else changed

    def _holder(self, state: State) -> Any:
        return state.rigid if self.rigid else state


@dataclasses.dataclass(frozen=True)
class StartTurn:
    """A turn [rad] of rigid body number `body` about a world axis, from the orientation with which it starts."""

    body: int
    axis: int

    def read(self, params: Params, state: State) -> float:
        """0, as declared."""
        return 0.0

    def put(self, params: Params, state: State, value: Array) -> tuple[Params, State]:
        """The body turned about its centre of mass."""
        assert state.rigid is not None
        held = jnp.asarray(state.rigid.orientations)
        vector = value * jnp.eye(3, dtype=held.dtype)[self.axis]
        new = turned(held[self.body], vector).astype(held.dtype)
        return params, state.replace(rigid=state.rigid.replace(orientations=held.at[self.body].set(new)))


@dataclasses.dataclass(frozen=True)
class Shift:
    """How far the place of marker number `marker` is off the given one along an axis [m]: no number of the scene, so
    that whoever looks at markers adds it."""

    marker: int
    axis: int

    def read(self, params: Params, state: State) -> float:
        """0, as given."""
        return 0.0

    def put(self, params: Params, state: State, value: Array) -> tuple[Params, State]:
        """Nothing of the scene changes."""
        return params, state


@dataclasses.dataclass(frozen=True)
class OfBody:
    """A material constant of soft body number `body` of `bodies`; `elements`: its elements, where there is one a
    piece. Several values change in proportion."""

    name: str
    body: int
    bodies: int
    elements: tuple[int, int]

    def read(self, params: Params, state: State) -> float:
        """Its mean."""
        return float(np.mean(np.asarray(self._own(jnp.asarray(params.constants[self.name])))))

    def put(self, params: Params, state: State, value: Array) -> tuple[Params, State]:
        """The value as its mean."""
        held = jnp.asarray(params.constants[self.name])
        if held.size == 1:
            held = jnp.broadcast_to(held.reshape(()), (self.bodies,))
        own = self._own(held)
        mean = jnp.mean(own)
        shares = jnp.where(mean == 0, 1.0, own / jnp.where(mean == 0, 1.0, mean))
        new = held.at[self._slice(held)].set((shares * value).astype(held.dtype))
        return params.replace(**{self.name: new}), state

    def _slice(self, held: Array) -> slice:
        first, last = (self.body, self.body + 1) if held.shape[0] == self.bodies else self.elements
        return slice(first, last)

    def _own(self, held: Array) -> Array:
        return held.reshape(-1) if held.size == 1 else held[self._slice(held)]


@dataclasses.dataclass(frozen=True)
class Region:
    """A material constant on some `elements`, the others keeping theirs; `owner`: the body of every element. Several
    values change in proportion."""

    name: str
    elements: tuple[int, ...]
    owner: tuple[int, ...]

    def read(self, params: Params, state: State) -> float:
        """Its mean."""
        return float(np.mean(np.asarray(self._each(params))[list(self.elements)]))

    def put(self, params: Params, state: State, value: Array) -> tuple[Params, State]:
        """The value as its mean."""
        held, where = self._each(params), np.array(self.elements)
        mean = jnp.mean(held[where])
        shares = jnp.where(mean == 0, 1.0, held[where] / jnp.where(mean == 0, 1.0, mean))
        return params.replace(**{self.name: held.at[where].set((shares * value).astype(held.dtype))}), state

    def _each(self, params: Params) -> Array:
        """One value an element (E,)."""
        held, count = jnp.asarray(params.constants[self.name]), len(self.owner)
        if held.size == 1:
            return jnp.broadcast_to(held.reshape(()), (count,))
        return held if held.shape == (count,) else held[np.array(self.owner)]


def _at(tree: Any, keys: Keys) -> Any:
    for key in keys:
        tree = getattr(tree, key) if isinstance(key, str) and dataclasses.is_dataclass(tree) else tree[key]
    return tree


def _with(tree: Any, keys: Keys, value: Any) -> Any:
    """A tree of dataclasses, dictionaries and tuples with a value where the keys lead."""
    if not keys:
        return value
    first, rest = keys[0], keys[1:]
    new = _with(_at(tree, (first,)), rest, value)
    if isinstance(tree, Mapping):
        return {**tree, first: new}
    if isinstance(tree, tuple):
        return tuple(new if k == first else each for k, each in enumerate(tree))
    return dataclasses.replace(tree, **{str(first): new})
