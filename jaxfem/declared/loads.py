"""Loads as a user declares them; plain host data, resolved to node indices and weights by `build`."""

import dataclasses
from typing import Any

from jaxfem.declared.errors import refuse_traced


class _Host:
    """Declared with the host's numbers."""

    def __post_init__(self) -> None:
        refuse_traced(self)


@dataclasses.dataclass(frozen=True)
class NodalForce(_Host):
    """The same `force` (3,) [N] on each of `nodes` (a group's name, a mask or indices), or one row a node."""

    nodes: Any
    force: Any


@dataclasses.dataclass(frozen=True)
class Traction(_Host):
    """Dead `traction` (3,) [Pa], force per *undeformed* area, on `faces` (a group's name or (k, 3) node indices)."""

    faces: Any
    traction: Any


@dataclasses.dataclass(frozen=True)
class Pressure(_Host):
    """Follower `pressure` [Pa] on `faces`: pushes against the outward normal of the deformed faces."""

    faces: Any
    pressure: Any


@dataclasses.dataclass(frozen=True)
class PointForce(_Host):
    """Dead `force` (3,) [N] at the material `point` (3,) [m] of the undeformed body, inside a tetrahedron."""

    point: Any
    force: Any


Load = NodalForce | Traction | Pressure | PointForce
