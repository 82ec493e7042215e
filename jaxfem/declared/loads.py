"""Loads as a user declares them; plain host data, resolved to node indices and weights by `build`."""

import dataclasses
from typing import Any


@dataclasses.dataclass(frozen=True)
class NodalForce:
    """The same `force` (3,) [N] on each of `nodes` (a group's name, a mask or indices), or one row a node."""

    nodes: Any
    force: Any


@dataclasses.dataclass(frozen=True)
class Traction:
    """Dead `traction` (3,) [Pa], force per *undeformed* area, on `faces` (a group's name or (k, 3) node indices)."""

    faces: Any
    traction: Any


@dataclasses.dataclass(frozen=True)
class Pressure:
    """Follower `pressure` [Pa] on `faces`: pushes against the outward normal of the deformed faces."""

    faces: Any
    pressure: Any


@dataclasses.dataclass(frozen=True)
class PointForce:
    """Dead `force` (3,) [N] at the material `point` (3,) [m] of the undeformed body, inside a tetrahedron."""

    point: Any
    force: Any


Load = NodalForce | Traction | Pressure | PointForce
