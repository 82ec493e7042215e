"""The same force on each of some nodes."""

from typing import Any

import numpy as np

from jaxfem.declared.loads.base import Load, Loaded, weighted
from jaxfem.loads import ResolvedLoad


class NodalForce(Load, kind="nodal_force"):
    """The same `force` (3,) [N] on each of `nodes` (a group's name, a mask or indices), or one row a node."""

    nodes: Any
    force: Any

    place = "nodes"
    amount = "force"
    unit = "N"

    def resolved(self, body: Loaded, offset: int, dtype: Any) -> ResolvedLoad:
        """Each node takes the whole force, or its row."""
        nodes = body.nodes_of("load", self.nodes)
        self.checked(body, "force", (3,), (len(nodes), 3))
        return weighted(nodes + offset, np.ones(len(nodes)), dtype)
