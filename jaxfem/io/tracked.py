"""Material points whose paths a run records."""

from typing import Any

import numpy as np

from jaxfem.declared.scene import SceneError
from jaxfem.mesh import locate
from jaxfem.model import Model

OUTSIDE = 1e-6  # of the bodies' size: how far a tracked point may lie off the mesh


class Tracked:
    """Material points by their element's nodes and weights."""

    def __init__(self, model: Model, points: dict[str, Any]):
        self.names = tuple(points)
        rest, cells = np.asarray(model.rest, np.float64), np.asarray(model.elements.cells, np.int64)
        places = np.array([np.asarray(points[name], float) for name in self.names]).reshape(-1, 3)
        if not len(cells) and self.names:
            raise SceneError(f'the tracked point "{self.names[0]}" needs a soft body; rigid.csv has the rigid bodies')
        if not self.names:
            self.nodes, self.weights = np.zeros((0, 4), np.int64), np.zeros((0, 4))
            return
        elements, self.weights, distance = locate(rest, cells, places)
        self.nodes = cells[elements]
        near = self.at(rest)
        for name, place, off, closest in zip(self.names, places, distance, near, strict=True):
            if off > OUTSIDE * np.ptp(rest, axis=0).max():
                raise SceneError(
                    f'the tracked point "{name}" at {_listed(place)} lies {off:.3g} m outside the bodies: the nearest '
                    f"point of their mesh is {_listed(closest)}"
                )

    def at(self, positions: np.ndarray) -> np.ndarray:
        """Where the points (q, 3) are when the nodes are at `positions` (n, 3)."""
        places: np.ndarray = np.einsum("qa,qai->qi", self.weights, positions[self.nodes])
        return places


def _listed(place: np.ndarray) -> str:
    return "[" + ", ".join(f"{value:.6g}" for value in place) + "]"
