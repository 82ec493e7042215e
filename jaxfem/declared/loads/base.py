"""What a load is: where it acts, how much, and the nodal forces that come of it.

A kind of load is a subclass, wherever it is defined: a frozen dataclass with one field that says where it acts and one
that says how much, and `resolved`. It registers itself under the word that scene files call it.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar, Literal, Protocol, dataclass_transform

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.answers import TEXT, Wanted, asked, described, flaw_of, is_array, odd_leaf
from jaxfem.declared.errors import SceneError, refuse_traced
from jaxfem.loads import ResolvedLoad, WeightedForce
from jaxfem.mesh import TetMesh
from jaxfem.pytrees import on_device
from jaxfem.registry import Registry

PLACE = Wanted('"nodes", "faces" or "point"', lambda value: value in ("nodes", "faces", "point"))
"""The fields that say where a load acts."""


class Loaded(Protocol):
    """A soft body, as loads see it."""

    @property
    def mesh(self) -> TetMesh:
        """Its mesh at rest."""

    @property
    def label(self) -> str:
        """Its name in messages."""

    def nodes_of(self, what: str, selection: Any) -> np.ndarray:
        """Node indices of a selection."""


@dataclass_transform(frozen_default=True)
class Load:
    """What all loads share. `place`: the field that says where a load acts, "nodes", "faces" or "point"; `amount`: the
    field that says how much, of `unit`, one number where it is a `scalar`, else (3,)."""

    word: ClassVar[str] = ""
    place: ClassVar[Literal["nodes", "faces", "point"]]
    amount: ClassVar[str]
    unit: ClassVar[str]
    scalar: ClassVar[bool] = False

    def __init_subclass__(cls, kind: str = "", **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        dataclasses.dataclass(frozen=True)(cls)
        if not kind:
            return
        missing = [name for name in ("place", "amount", "unit") if not hasattr(cls, name)]
        fields = {each.name for each in dataclasses.fields(cls)}  # type: ignore[arg-type]
        if missing or cls.resolved is Load.resolved or not {cls.place, cls.amount} <= fields:
            raise TypeError(
                f'the load "{kind}" ({cls.__name__}) needs `place` ("nodes", "faces" or "point"), `amount` and `unit`, '
                "a field for each of the first two, and `resolved`"
            )
        if flaw := flaw_of(cls, {"place": PLACE, "unit": TEXT}):
            raise TypeError(f'the load "{kind}" ({cls.__name__}) has {flaw}')
        cls.word = kind
        LOADS.add(kind, cls)

    def __post_init__(self) -> None:
        refuse_traced(self)

    @property
    def value(self) -> Any:
        """How much: what goes into `params.loads`."""
        return getattr(self, self.amount)

    def entered(self, body: Loaded, offset: int, dtype: Any) -> ResolvedLoad:
        """`resolved`, once what all loads share is checked: that the amount is made of finite numbers."""
        try:
            array = np.asarray(self.value, dtype=float)
        except (TypeError, ValueError):
            array = np.full(0, np.nan)
        if not np.isfinite(array).all() or array.size == 0 or array.shape[-1:] != (() if self.scalar else (3,)):
            self.checked(body, self.amount, () if self.scalar else (3,))
        found = self.resolved(body, offset, dtype)
        if flaw := _flaw(found, array.shape, offset + len(body.mesh.points), dtype):
            raise SceneError(f'a {type(self).__name__} on "{body.label}": {flaw}')
        return found

    def resolved(self, body: Loaded, offset: int, dtype: Any) -> ResolvedLoad:
        """What enters the compiled step; a body's nodes are counted from `offset`. SceneError where it cannot act."""
        raise NotImplementedError

    def checked(self, body: Loaded, name: str, *shapes: tuple[int, ...]) -> np.ndarray:
        """The field `name` as finite numbers of one of `shapes`."""
        value = getattr(self, name)
        try:
            array = np.asarray(value, dtype=float)
        except (TypeError, ValueError):
            array = np.full(0, np.nan)
        if array.shape not in shapes or not np.isfinite(array).all():
            kind = type(self).__name__
            raise SceneError(
                f'{name} of a {kind} on "{body.label}" is {value!r}; give finite numbers of shape {shapes[0]}'
            )
        return array


def _flaw(load: Any, value: tuple[int, ...], nodes: int, dtype: Any) -> str:
    """What is wrong with a resolved load, asked for the force of a value of that shape; empty where nothing is."""
    said = callable(getattr(load, "force", None)) and isinstance(getattr(load, "symmetric", None), bool)
    if not said or odd_leaf(load) is not None:
        return f"`resolved` gives {described(load)}; it must give a Pytree with `force` and `symmetric`"
    field = jax.ShapeDtypeStruct((nodes, 3), dtype)

    def look(found: Any) -> str:
        good = is_array(found, [field.shape], dtype)
        return "" if good else f"its force is {described(found)}; it must be nodal forces (n, 3), here {field.shape}"

    return asked(look, lambda own, *given: own.force(*given), load, jax.ShapeDtypeStruct(value, dtype), field)


LOADS: Registry[Load] = Registry("load")
"""Every kind of load by its word in scene files."""


def weighted(nodes: np.ndarray, weights: np.ndarray, dtype: Any) -> WeightedForce:
    """Shares of a value on nodes, on the device."""
    return WeightedForce(on_device(nodes, jnp.int32), on_device(weights, dtype))


def surface_faces(body: Loaded, faces: Any) -> np.ndarray:
    """Faces (k, 3) of a body's surface, from a group's name or as they are."""
    if isinstance(faces, str):
        named: np.ndarray = body.mesh.faces(faces)
        return named
    array, known = np.asarray(faces), {tuple(sorted(f)) for f in body.mesh.surface.tolist()}
    if array.ndim != 2 or array.shape[1] != 3 or not _all_known(array.tolist(), known):
        raise SceneError(
            f'faces of a load on "{body.label}" must be triangles (k, 3) of its surface; see mesh.surface, or name one '
            f"of its face groups: {', '.join(body.mesh.face_groups) or 'none'}"
        )
    return array


def _all_known(faces: Sequence[Sequence[int]], known: set[tuple[int, ...]]) -> bool:
    return all(tuple(sorted(face)) in known for face in faces)
