"""Fine surfaces embedded in soft bodies, carried along with the elements that hold them and shown in the frames."""

import dataclasses
from typing import Any

import numpy as np

from jaxfem.building.embedded import embedded
from jaxfem.declared.scene import Scene
from jaxfem.io.parts import Part, Shown, frame_part
from jaxfem.model import State


@dataclasses.dataclass(frozen=True)
class Skin:
    """Triangles (t, 3) of surfaces embedded in soft bodies: `nodes` (q, 4) and `weights` (q, 4) of their points, and
    the `number` (t,) of their body."""

    nodes: np.ndarray
    weights: np.ndarray
    triangles: np.ndarray
    number: np.ndarray

    def carried(self, field: Any) -> np.ndarray:
        """A nodal field (n, 3) at the points."""
        found: np.ndarray = np.einsum("qa,qai->qi", self.weights, np.asarray(field, np.float64)[self.nodes])
        return found


def skin(scene: Scene | None) -> Skin | None:
    """The surfaces that soft bodies of a scene declare; None without any."""
    if scene is None or all(body.surface is None for body in scene.soft):
        return None
    nodes, points, parts = 0, 0, list[tuple[np.ndarray, ...]]()
    for number, body in enumerate(scene.soft):
        if body.surface is not None:
            places, triangles = (np.asarray(each) for each in body.surface)
            cells, weights = embedded(body.mesh, places, f'surface of "{body.label}"')
            parts.append((cells + nodes, weights, triangles + points, np.full(len(triangles), number)))
            points += len(places)
        nodes += len(body.mesh.points)
    return Skin(*(np.concatenate(each) for each in zip(*parts, strict=True)))


@frame_part("surface")
def soft_surfaces(shown: Shown, state: State, points: np.ndarray) -> Part | None:
    """Surfaces embedded in soft bodies, with their displacement [m], velocity [m/s] and the number of their body."""
    drawn = shown.skin
    if drawn is None:
        return None
    places = drawn.carried(state.positions)
    moved = {"displacement": places - drawn.carried(shown.model.rest), "velocity": drawn.carried(state.velocities)}
    return Part(places, "triangle", drawn.triangles, moved, {"body": drawn.number})
