"""What a page draws, gathered from frames: surfaces, lines and points over all frames, with values to colour by."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxfem.io.parts import Part
from jaxfem.io.reading import Frame
from jaxfem.mesh.topology import boundary_faces

COLOURS = {
    "bodies": (0.36, 0.60, 0.80),
    "rigid": (0.72, 0.72, 0.74),
    "ground": (0.55, 0.53, 0.48),
    "joints": (0.85, 0.20, 0.20),
    "contacts": (0.90, 0.45, 0.10),
    "loads": (0.15, 0.60, 0.30),
    "points": (0.80, 0.10, 0.55),
    "embedded": (0.45, 0.30, 0.70),
}
ARROW = 0.15
"""Length of the largest force's arrow, of the bodies' size."""
OTHER = (0.5, 0.5, 0.5)


@dataclasses.dataclass(frozen=True)
class Shown:
    """A part over all frames: `places` (N, 3) [m] one frame after the other, `starts` (frames + 1) of each, of one
    frame alone where it stands still; `cells` (m, k) of each frame where `indexed`, else each vertex in turn; `rest`
    (n, 3) where it moves as a body; `values` by name (N,)."""

    name: str
    kind: str
    places: np.ndarray
    starts: np.ndarray
    cells: np.ndarray
    rest: np.ndarray | None = None
    values: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)

    @property
    def indexed(self) -> bool:
        """Whether cells are the same in all frames."""
        return self.kind == "triangle"

    @property
    def is_body(self) -> bool:
        """Whether it is what one looks at."""
        return self.name in ("bodies", "rigid")

    @property
    def colour(self) -> tuple[float, float, float]:
        """Red, green, blue from 0 to 1."""
        return COLOURS.get(self.name, OTHER)


def shown_parts(frames: Sequence[Frame]) -> list[Shown]:
    """All parts of the frames."""
    found = [_soft(frames)] if frames[0].cells.shape[1] == 4 else []
    every = {name: part for frame in frames for name, part in frame.parts.items()}
    for name in sorted(every, key=_order):
        empty = _empty(every[name])  # what touches nothing for a while is not there
        each = [frame.parts.get(name, empty) for frame in frames]
        found.append(_surface(name, each) if each[0].kind == "triangle" else _marks(name, each, frames))
    if not found:
        found.append(_marks("bodies", [_centers(frame) for frame in frames], frames))
    return found


def _order(name: str) -> int:
    return list(COLOURS).index(name) if name in COLOURS else len(COLOURS)


def _empty(part: Part) -> Part:
    """A part like another, of nothing."""
    return dataclasses.replace(
        part, points=part.points[:0], cells=part.cells[:0], nodal={name: each[:0] for name, each in part.nodal.items()}
    )


def quantised(places: np.ndarray, low: np.ndarray, span: np.ndarray) -> np.ndarray:
    """Places (N, 3) as 16-bit shares of a box."""
    shares: np.ndarray = np.clip(65535 * (places - low) / span, 0, 65535).round().astype(np.uint16)
    return shares


def _soft(frames: Sequence[Frame]) -> Shown:
    """The soft bodies' surface, with all nodal and elementwise fields of one number or a length."""
    surface = boundary_faces(frames[0].cells)[0]
    nodes, numbers = np.unique(surface, return_inverse=True)
    places = [frame.positions[nodes] for frame in frames]
    first = frames[0]
    rest = (first.positions - first.fields["displacement"] if "displacement" in first.fields else first.positions)[
        nodes
    ]
    values = {}
    for name in first.fields:
        if name in ("displacement", "body"):
            continue
        each = np.concatenate([_nodal(frame, name, nodes) for frame in frames])
        if np.isfinite(each).any():
            values[name] = each
    return Shown("bodies", "triangle", *_joined(places), numbers.reshape(-1, 3), rest, values)


def _nodal(frame: Frame, name: str, nodes: np.ndarray) -> np.ndarray:
    """A field on `nodes` (k,): lengths of vectors, means of the elements around."""
    field = np.asarray(frame.fields[name], float)
    size = np.abs(field) if field.ndim == 1 else np.linalg.norm(field.reshape(len(field), -1), axis=1)
    if len(field) == len(frame.positions) and len(field) != len(frame.cells):
        chosen: np.ndarray = size[nodes]
        return chosen
    known = np.isfinite(size)
    corners, count = frame.cells[known], len(frame.positions)
    sums = np.bincount(corners.ravel(), np.repeat(size[known], 4), count)
    mean: np.ndarray = (sums / np.maximum(np.bincount(corners.ravel(), minlength=count), 1))[nodes]
    return mean


def _surface(name: str, parts: Sequence[Part]) -> Shown:
    """Triangles: once where they stand still."""
    places = [part.points for part in parts]
    if all(np.array_equal(each, places[0]) for each in places):
        places = places[:1]
    moved = parts[0].nodal.get("displacement")
    rest = None if moved is None else parts[0].points - moved
    speed = [np.linalg.norm(part.nodal["velocity"], axis=1) for part in parts if "velocity" in part.nodal]
    values = {"velocity": np.concatenate(speed)} if len(speed) == len(places) else {}
    return Shown(name, "triangle", *_joined(places), np.asarray(parts[0].cells), rest, values)


def _marks(name: str, parts: Sequence[Part], frames: Sequence[Frame]) -> Shown:
    """Lines as they are; points with forces as arrows without a head, others as dots."""
    if parts[0].kind == "line":
        return Shown(name, "line", *_joined([part.points[part.cells.ravel()] for part in parts]), parts[0].cells)
    forces = [part.nodal.get("force") for part in parts]
    if all(force is not None and force.ndim == 2 for force in forces):
        top = max(float(np.linalg.norm(force, axis=1).max(initial=0)) for force in forces if force is not None)
        scale = ARROW * _size(frames) / (top or 1.0)
        ends = [
            np.stack([part.points, part.points + scale * force], 1).reshape(-1, 3)
            for part, force in zip(parts, forces, strict=True)
            if force is not None
        ]
        return Shown(name, "line", *_joined(ends), parts[0].cells)
    return Shown(name, "vertex", *_joined([part.points for part in parts]), parts[0].cells)


def _centers(frame: Frame) -> Part:
    return Part(frame.positions, "vertex", np.arange(len(frame.positions))[:, None])


def _size(frames: Sequence[Frame]) -> float:
    bodies = [frames[0].positions] + [frames[0].parts[name].points for name in ("rigid",) if name in frames[0].parts]
    return float(np.ptp(np.concatenate(bodies), axis=0).max()) or 1.0


def _joined(places: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    return np.concatenate(places), np.cumsum([0, *(len(each) for each in places)])
