"""Frames that a run wrote, read back."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from jaxfem.io.checkpoints import listed_frames
from jaxfem.io.parts import Part
from jaxfem.mesh.formats.foreign import read_block


@dataclasses.dataclass(frozen=True)
class Frame:
    """One saved frame: `time` [s], `positions` (n, 3) [m], `cells` (E, 4), and its `fields` by name, each an attribute
    too: `displacement` [m] and `velocity` [m/s] (n, 3), of each element (E,) its `body` (number in the scene) and
    `von_mises` stress [Pa], and whatever else is registered in `jaxfem.io.fields`; of laws with a memory von Mises
    values of what they remember, like `von_mises_plastic_strain`; where a run asks for them the tensors `stress` [Pa],
    `strain`, `plastic_strain`, ... (E, 6): xx, yy, zz, xy, yz, xz in the world's axes. `parts`: what else there is to
    see, by the names of `jaxfem.io.parts`; a part that is empty is not there."""

    time: float
    positions: np.ndarray
    cells: np.ndarray
    fields: dict[str, np.ndarray]
    parts: dict[str, Part] = dataclasses.field(default_factory=dict)

    def __getattr__(self, name: str) -> np.ndarray:  # only for what is no attribute of its own
        fields: dict[str, np.ndarray] = vars(self).get("fields", {})
        if name in fields:
            return fields[name]
        raise AttributeError(f"the frame has no field {name!r}; it has {', '.join(fields)}")


def read_frames(index: Any) -> list[Frame]:
    """All frames that a PVD index lists, in its order. FileNotFoundError where a file is missing."""
    index = Path(index)
    if not index.is_file():
        raise FileNotFoundError(f"no index of frames {index}: give the .pvd file that a run wrote")
    frames = []
    for time, path, parts in listed_frames(index):
        frames.append(read_frame(path, time))
        frames[-1].parts.update({name: read_part(each) for name, each in parts.items()})
    return frames


def read_frame(path: Any, time: float = 0.0) -> Frame:
    """One VTU frame; `time` [s] is not in the file but in the index."""
    if not Path(path).is_file():
        raise FileNotFoundError(f"no frame {path}: was it moved away from its index?")
    points, _, cells, nodal, elementwise = read_block(path)
    return Frame(time, points, cells, {**nodal, **elementwise})


def read_part(path: Path) -> Part:
    """A part of a frame."""
    points, kind, cells, nodal, cellwise = read_block(path)
    return Part(points, kind, cells, nodal, cellwise)
