"""Results as files that other tools open: VTU frames with a PVD index, and CSV tables; readable at any time."""

import contextlib
import csv
import glob
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
from jaxfem.io.checkpoints import checkpoint_path, listed_frames, table_head, trimmed_table
from jaxfem.io.fields import FIELDS, computed
from jaxfem.io.parts import PARTS, Part, Shown, parts_of, surfaces
from jaxfem.io.scene_files import SceneFileError
from jaxfem.io.skins import skin
from jaxfem.io.tracked import Tracked
from jaxfem.mesh.formats.foreign import write_foreign
from jaxfem.model import Model, Params, State

SHORT = 500  # frames that an index lists before it is rewritten less often


class Saved(NamedTuple):
    """What stays in memory of a frame: `time` [s], its `path` and `parts`."""

    time: float
    path: Path
    parts: dict[str, Path]


class Row(NamedTuple):
    """A row of the tables: `time` [s], `energies` [J], tracked `places` (q, 3)."""

    time: float
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
    it. energies.csv has what the states' account books too; `record` adds rows between frames. Frames of an earlier run
    of that name are removed, all but the first `kept`, behind which the writer goes on.
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
        self.rows: list[Row] = []
        self.kept = kept
        self.listed = False  # whether the index has the last frame
        self._last: dict[str, tuple[np.ndarray, Path]] = {}
        self._open = contextlib.ExitStack()

    def __enter__(self) -> "FrameWriter":
        frames = self.folder / "frames"
        frames.mkdir(parents=True, exist_ok=True)
        if self.kept:
            self._refuse_other_tables()
        else:  # an interruption before the first frame must not leave what --resume would take for this run
            tables = (self.folder / name for name in ("energies.csv", "points.csv", "rigid.csv"))
            for old in (self.index, checkpoint_path(self.index), *tables):
                old.unlink(missing_ok=True)
        for old in frames.glob(f"{glob.escape(self.name)}_*.vtu"):
            number, _, part = old.stem[len(self.name) + 1 :].partition("_")
            if number.isdigit() and int(number) >= self.kept and (not part or part in PARTS):
                old.unlink()
        if self.kept:
            self._recall()
        self._energy_row: Callable[[list[float]], None] | None = None  # its columns are the first state's
        self._point_row = None
        if self.points.names:
            self._point_row = self._table("points.csv", ["time_s", *self._point_columns])
        self._rigid_row = None
        if self.model.rigid is not None:
            self._rigid_row = self._table("rigid.csv", ["time_s", *self._rigid_columns])
        return self

    def _recall(self) -> None:
        """What is kept of an earlier run: its frames from the index, their energies and points from the tables."""
        frames = listed_frames(self.index)[: self.kept]
        self.saved = [Saved(*frame) for frame in frames]
        until = frames[-1][0]
        head, rows = trimmed_table(self.folder / "energies.csv", until)
        kinds = [name.removesuffix("_J") for name in head[1:]]
        places = np.zeros((len(rows), len(self.points.names), 3))
        if self.points.names:
            places = trimmed_table(self.folder / "points.csv", until)[1][:, 1:].reshape(places.shape)
        if self.model.rigid is not None:
            trimmed_table(self.folder / "rigid.csv", until)
        self.rows = [
            Row(float(row[0]), dict(zip(kinds, row[1:].tolist(), strict=True)), place)
            for row, place in zip(rows, places, strict=True)
        ]

    def _refuse_other_tables(self) -> None:
        """SceneFileError where kept tables have other columns than this run writes: nothing is cut from them then."""
        for name, columns in (("points.csv", self._point_columns), ("rigid.csv", self._rigid_columns)):
            path, wanted = self.folder / name, ["time_s", *columns]
            if columns and (not path.is_file() or table_head(path) != wanted):
                raise SceneFileError(
                    f"{path} has other columns than this run writes (points or bodies were renamed, added or put in "
                    "another order): give --force to begin anew, or --out FOLDER for another place"
                )

    @property
    def _point_columns(self) -> list[str]:
        return [f"{name}_{axis}_m" for name in self.points.names for axis in "xyz"]

    @property
    def _rigid_columns(self) -> list[str]:
        if self.model.rigid is None:
            return []
        columns = ["x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"]
        return [f"{name}_{column}" for name in self.model.rigid.names for column in columns]

    def __exit__(self, *problem: Any) -> None:
        self._open.close()
        if self.saved:  # the last frames may not be listed yet
            self.list_frames()

    def write(self, state: State, recorded: bool = False) -> Path:
        """Write one frame of the state and, unless it was `recorded` already, a row of each table; returns the frame's
        path."""
        fields, energy = _computed(self.model, self.params, state, tuple(FIELDS), self.tensors, self.fields)
        positions, time = np.asarray(state.positions), float(state.time)
        if self._rigid_row is not None and state.rigid is not None:
            poses = np.concatenate([np.asarray(state.rigid.positions), np.asarray(state.rigid.orientations)], 1)
            self._rigid_row([time, *poses.ravel()])
        path = self.folder / "frames" / f"{self.name}_{len(self.saved):05d}.vtu"
        mesh = _frame_mesh(self.model, state, {name: np.asarray(each) for name, each in fields.items()})
        with replaced(path) as temporary:
            write_foreign(temporary, *mesh, file_format="vtu")
        places = self.points.at(positions)
        parts = parts_of(self.shown, state, places)
        paths = {name: self._part_file(path, name, part) for name, part in parts.items()}
        self.saved.append(Saved(time, path, paths))
        self.listed = len(self.saved) % (1 + len(self.saved) // SHORT) == 0
        if self.listed:
            self.list_frames()
        if not recorded:
            self.record(time, {kind: float(value) for kind, value in energy.kinds.items()}, places)
        return path

    def record(self, time: float, energies: Mapping[str, float], places: np.ndarray) -> None:
        """A row of energies.csv [J] and of points.csv (q, 3) [m], also of a step between frames."""
        kinds = self.rows[0].energies if self.rows else energies  # in the order of the first
        energies = {kind: energies[kind] for kind in kinds}
        self.rows.append(Row(time, energies, places))
        if self._energy_row is None:
            self._energy_row = self._table("energies.csv", ["time_s", *(f"{kind}_J" for kind in energies)])
        self._energy_row([time, *energies.values()])
        if self._point_row is not None:
            self._point_row([time, *places.ravel()])

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
    def row_times(self) -> np.ndarray:
        """Times of the tables' rows (k,) [s]."""
        return np.array([each.time for each in self.rows])

    @property
    def energies(self) -> dict[str, np.ndarray]:
        """Kind -> energy at each row (k,) [J]."""
        kinds = self.rows[0].energies if self.rows else {}
        return {kind: np.array([each.energies[kind] for each in self.rows]) for kind in kinds}

    @property
    def paths(self) -> dict[str, np.ndarray]:
        """Name of each tracked point -> its places at each row (k, 3) [m]."""
        return {name: np.array([each.places[i] for each in self.rows]) for i, name in enumerate(self.points.names)}

    def files(self) -> list[Path]:
        """The index and the tables, for a summary."""
        tables = ["energies.csv"] + (["points.csv"] if self.points.names else [])
        tables += ["rigid.csv"] if self.model.rigid is not None else []
        return [self.index, *(self.folder / name for name in tables)]

    def list_frames(self) -> None:
        """Write the index of all frames so far."""
        self.listed = True
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
