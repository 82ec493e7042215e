"""Results as files that other tools open: VTU frames with a PVD index, and CSV tables; readable at any time."""

import contextlib
import csv
import dataclasses
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import jax
import numpy as np

from jaxfem.declared.scene import Scene
from jaxfem.energies import energies
from jaxfem.io.checkpoints import listed_frames, trimmed_table
from jaxfem.io.fields import FIELDS, computed
from jaxfem.io.parts import PARTS, Part, Shown, surfaces
from jaxfem.io.skins import skin
from jaxfem.io.tracked import Tracked
from jaxfem.mesh.formats.foreign import read_block, write_foreign
from jaxfem.model import Model, Params, State

SHORT = 500  # frames that an index lists before it is rewritten less often


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


class Saved(NamedTuple):
    """What stays in memory of a frame: `time` [s], its `path` and `parts`, `energies` [J], tracked `places` (q, 3)."""

    time: float
    path: Path
    parts: dict[str, Path]
    energies: dict[str, float]
    places: np.ndarray


class FrameWriter:
    """Writes frames of a run as they come; a context manager.

    In `folder`: NAME.pvd, the index to open in ParaView, rewritten after every frame (from 500 frames on after every
    second, and so on, or a long run would do little else) and at the end; frames/NAME_00000.vtu and so on,
    with the nodes where they are at that time; energies.csv [J]; points.csv, the paths of `points` (name -> (3,) [m], a
    material point of the undeformed bodies); rigid.csv, the poses of rigid bodies (place of the centre of mass, unit
    quaternion). Frames of rigid bodies alone hold a vertex for each. Beside each frame, listed with it, are its parts,
    frames/NAME_00000_contacts.vtu and so on: joints, contacts, loads, tracked points, embedded surfaces and, where the
    `scene` is given, the surfaces of rigid bodies and ground; forces in them where the time step `dt` [s] is.
    `tensors`: whether frames hold stress and strain as tensors; `fields`: names of those that they hold, all without
    it. energies.csv has what the states' account books too. Frames of an earlier run of that name are removed, all but
    the first `kept`, behind which the writer goes on.
    SceneError for a point outside every body or an unknown field.
    """

    def __init__(
        self,
        folder: Any,
        name: str,
        model: Model,
        params: Params,
        points: Mapping[str, Any] | None = None,
        tensors: bool = False,
        *,
        scene: Scene | None = None,
        dt: float | None = None,
        fields: Sequence[str] | None = None,
        kept: int = 0,
    ) -> None:
        self.folder, self.name, self.model, self.params = Path(folder), name, model, params
        self.index = self.folder / f"{name}.pvd"
        self.tensors = tensors
        self.points = Tracked(model, dict(points or {}))
        self.fields = None if fields is None else tuple(fields)
        self.shown = Shown(model, params, *surfaces(scene, model), dt, skin(scene))
        self.saved: list[Saved] = []
        self.kept = kept
        self._last: dict[str, tuple[np.ndarray, Path]] = {}
        self._open = contextlib.ExitStack()

    def __enter__(self) -> "FrameWriter":
        frames = self.folder / "frames"
        frames.mkdir(parents=True, exist_ok=True)
        for old in frames.glob(f"{self.name}_*.vtu"):
            number, _, part = old.stem[len(self.name) + 1 :].partition("_")
            if number.isdigit() and int(number) >= self.kept and (not part or part in PARTS):
                old.unlink()
        if self.kept:
            self._recall()
        self._energy_row: Callable[[list[float]], None] | None = None  # its columns are the first state's
        self._point_row = None
        if self.points.names:
            columns = [f"{name}_{axis}_m" for name in self.points.names for axis in "xyz"]
            self._point_row = self._table("points.csv", ["time_s", *columns])
        self._rigid_row = None
        if self.model.rigid is not None:
            columns = ["x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"]
            names = [f"{name}_{column}" for name in self.model.rigid.names for column in columns]
            self._rigid_row = self._table("rigid.csv", ["time_s", *names])
        return self

    def _recall(self) -> None:
        """What is kept of an earlier run: its frames from the index, their energies and points from the tables."""
        head, rows = trimmed_table(self.folder / "energies.csv", self.kept)
        kinds = [name.removesuffix("_J") for name in head[1:]]
        energies = [dict(zip(kinds, row[1:].tolist(), strict=True)) for row in rows]
        places = np.zeros((self.kept, len(self.points.names), 3))
        if self.points.names:
            places = trimmed_table(self.folder / "points.csv", self.kept)[1][:, 1:].reshape(places.shape)
        if self.model.rigid is not None:
            trimmed_table(self.folder / "rigid.csv", self.kept)
        frames = listed_frames(self.index)[: self.kept]
        self.saved = [Saved(*frame, row, place) for frame, row, place in zip(frames, energies, places, strict=True)]

    def __exit__(self, *problem: Any) -> None:
        self._open.close()
        if self.saved:  # the last frames may not be listed yet
            self._write_index()

    def write(self, state: State) -> Path:
        """Write one frame of the state and a row of each table; returns the frame's path."""
        fields, energy = _computed(self.model, self.params, state, tuple(FIELDS), self.tensors, self.fields)
        positions, time = np.asarray(state.positions), float(state.time)
        if self._rigid_row is not None and state.rigid is not None:
            poses = np.concatenate([np.asarray(state.rigid.positions), np.asarray(state.rigid.orientations)], 1)
            self._rigid_row([time, *poses.ravel()])
        path = self.folder / "frames" / f"{self.name}_{len(self.saved):05d}.vtu"
        mesh = _frame_mesh(self.model, state, {name: np.asarray(each) for name, each in fields.items()})
        with replaced(path) as temporary:
            write_foreign(temporary, *mesh, file_format="vtu")
        row, places = {kind: float(value) for kind, value in energy.kinds.items()}, self.points.at(positions)
        made = {name: make(self.shown, state, places) for name, make in PARTS.items()}
        parts = {name: part for name, part in made.items() if part is not None and len(part.points)}
        paths = {name: self._part_file(path, name, part) for name, part in parts.items()}
        self.saved.append(Saved(time, path, paths, row, places))
        if len(self.saved) % (1 + len(self.saved) // SHORT) == 0:
            self._write_index()
        if self._energy_row is None:
            self._energy_row = self._table("energies.csv", ["time_s", *(f"{kind}_J" for kind in row)])
        self._energy_row([time, *row.values()])
        if self._point_row is not None:
            self._point_row([time, *self.saved[-1].places.ravel()])
        return path

    def _part_file(self, frame: Path, name: str, part: Part) -> Path:
        """Write a part beside its frame; one that stands still, the very points of the last, is in its file already."""
        if name in self._last and self._last[name][0] is part.points:
            return self._last[name][1]
        path = frame.with_name(f"{frame.stem}_{name}.vtu")
        with replaced(path) as temporary:
            _write_part(temporary, part)
        self._last[name] = part.points, path
        return path

    @property
    def times(self) -> np.ndarray:
        """Times of the saved frames (k,) [s]."""
        return np.array([each.time for each in self.saved])

    @property
    def energies(self) -> dict[str, np.ndarray]:
        """Kind -> energy at each saved frame (k,) [J]."""
        kinds = self.saved[0].energies if self.saved else {}
        return {kind: np.array([each.energies[kind] for each in self.saved]) for kind in kinds}

    @property
    def paths(self) -> dict[str, np.ndarray]:
        """Name of each tracked point -> its places (k, 3) [m]."""
        return {name: np.array([each.places[i] for each in self.saved]) for i, name in enumerate(self.points.names)}

    def files(self) -> list[Path]:
        """The index and the tables, for a summary."""
        tables = ["energies.csv"] + (["points.csv"] if self.points.names else [])
        tables += ["rigid.csv"] if self.model.rigid is not None else []
        return [self.index, *(self.folder / name for name in tables)]

    def _write_index(self) -> None:
        number = {name: place for place, name in enumerate(("bodies", *PARTS))}
        lines = [
            f'    <DataSet timestep="{frame.time:.9g}" part="{number[name]}" name="{name}" '
            f"file={quoteattr(path.relative_to(self.folder).as_posix())}/>"
            for frame in self.saved
            for name, path in {"bodies": frame.path, **frame.parts}.items()
        ]
        order = "LittleEndian" if sys.byteorder == "little" else "BigEndian"
        head = f'<?xml version="1.0"?>\n<VTKFile type="Collection" version="1.0" byte_order="{order}">\n  <Collection>'
        with replaced(self.index) as temporary:
            temporary.write_text("\n".join([head, *lines, "  </Collection>", "</VTKFile>", ""]), encoding="utf-8")

    def _table(self, name: str, columns: list[str]) -> Callable[[list[float]], None]:
        """Open a CSV file, with a header where it is new; returns what adds a row and flushes it."""
        mode = "a" if self.kept else "w"
        file = self._open.enter_context(open(self.folder / name, mode, newline="", encoding="utf-8"))
        writer = csv.writer(file, lineterminator="\n")

        def add(row: list[Any]) -> None:
            writer.writerow([value if isinstance(value, str) else f"{value:.9g}" for value in row])
            file.flush()

        if not self.kept:
            add(columns)
        return add


def _write_part(path: Path, part: Part) -> None:
    cellwise = {name: [np.asarray(value)] for name, value in part.cellwise.items()}
    nodal = {name: np.asarray(value) for name, value in part.nodal.items()}
    write_foreign(path, np.asarray(part.points), [(part.kind, part.cells)], nodal, cellwise, file_format="vtu")


def _frame_mesh(model: Model, state: State, fields: dict[str, np.ndarray]) -> tuple[Any, Any, Any, Any]:
    """The soft bodies' mesh with its fields or, where there is none, the rigid bodies' centres: points, blocks of
    cells, values of points and of cells."""
    if not model.bodies and model.rigid is not None and state.rigid is not None:
        count, places = model.rigid.count, np.asarray(state.rigid.positions)
        moved = {"displacement": places - np.asarray(model.rigid.start), "velocity": np.asarray(state.rigid.velocities)}
        each = {"body": [np.arange(count)], "von_mises": [np.zeros(count)]}
        return places, [("vertex", np.arange(count)[:, None])], moved, each
    cells = [("tetra", np.asarray(model.elements.cells, np.int64))]
    on_nodes = {name for name in fields if name in FIELDS and FIELDS[name].on == "node"}
    nodal = {name: value for name, value in fields.items() if name in on_nodes}
    elementwise = {name: [value] for name, value in fields.items() if name not in on_nodes}
    return np.asarray(state.positions), cells, nodal, elementwise


@partial(jax.jit, static_argnames=("names", "whole", "asked"))
def _computed(
    model: Model, params: Params, state: State, names: tuple[str, ...], whole: bool, asked: tuple[str, ...] | None
) -> tuple[dict[str, Any], Any]:
    """Fields `asked` for and the energies of a frame; `names`: of all, since a later one is compiled too."""
    return computed(model, params, state, whole, asked), energies(model, params, state)


@contextlib.contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` that takes its place at the end, or is removed when something goes wrong."""
    temporary = path.with_name(path.name + ".part")
    try:
        yield temporary
        os.replace(temporary, path)
    except BaseException:  # an interruption too must leave nothing half written
        temporary.unlink(missing_ok=True)
        raise


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
