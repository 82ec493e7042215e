"""Frames of a run in a live viewer (viser): turned, played and coloured in a notebook or a browser."""

import importlib
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxfem.io.page_meshes import Shown, shown_parts
from jaxfem.io.reading import Frame, read_frames

MISSING = "to look at frames live, install viser: pip install 'jaxfem[live]'"
PLAIN = "plain"
PACE = 1 / 24
"""s a frame, where frames are not further apart in time."""
RAMP = np.array([[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], float)
"""Colours from nothing to the most of a field (viridis, van der Walt & Smith 2015)."""


class LiveError(ImportError):
    """viser is not installed."""


class Live:
    """A viewer that runs until `stop()`: `server` is viser's; `frame` the number of the frame it shows.

    In notebooks the last line of a cell, `jaxfem.io.live.show(...)`, tells the address to open.
    """

    def __init__(self, parts: Sequence[Shown], times: Sequence[float], server: Any) -> None:
        self.parts, self.times, self.server = list(parts), [float(time) for time in times], server
        fields = dict.fromkeys(name for part in parts for name in part.values)
        self._tops = {name: max(_top(part, name) for part in parts if name in part.values) for name in fields}
        self._drawing, self._over = threading.Lock(), threading.Event()
        server.scene.set_up_direction("+z")
        gui = server.gui
        self._slider = gui.add_slider("frame", min=0, max=max(1, len(times) - 1), step=1, initial_value=0)
        self._time = gui.add_text("time", initial_value="", disabled=True)
        self._playing = gui.add_checkbox("play", initial_value=False)
        self._field = gui.add_dropdown("colour by", (PLAIN, *fields), initial_value=PLAIN)
        self._slider.on_update(lambda _: self.draw())
        self._field.on_update(lambda _: self.draw())
        self.draw()
        self._thread = threading.Thread(target=self._play, daemon=True)
        self._thread.start()

    def __repr__(self) -> str:
        return f"Live({len(self.times)} frames at {self.address})"

    @property
    def address(self) -> str:
        """Where a browser finds it."""
        return f"http://{self.server.get_host()}:{self.server.get_port()}"

    @property
    def frame(self) -> int:
        """Number of the frame that is shown."""
        return min(int(self._slider.value), len(self.times) - 1)

    def go(self, frame: int, field: str | None = None) -> None:
        """Show a frame, coloured by a `field` of the frames where one is named. ValueError where there is none such."""
        if field is not None and field not in (PLAIN, *self._tops):
            raise ValueError(f"there is no field {field!r} to colour by: give one of {', '.join((PLAIN, *self._tops))}")
        if not 0 <= frame < len(self.times):
            raise ValueError(f"there is no frame {frame} of {len(self.times)}")
        self._slider.value = frame
        self._field.value = field or self._field.value
        self.draw()

    def play(self, on: bool = True) -> None:
        """Start playing, or pause."""
        self._playing.value = on

    def stop(self) -> None:
        """End the viewer and free its address."""
        self._over.set()
        self._thread.join(timeout=2)
        self.server.stop()

    def draw(self) -> None:
        """Send the frame that is chosen."""
        with self._drawing, self.server.atomic():
            number, field = self.frame, self._field.value
            self._time.value = f"{self.times[number]:.4g} s"
            for part in self.parts:
                _draw(self.server.scene, part, number, field, self._tops.get(field, 0.0))

    def _play(self) -> None:
        while not self._over.wait(PACE):
            if self._playing.value and len(self.times) > 1:
                self._slider.value = (self.frame + 1) % len(self.times)
                self.draw()


def show(frames: Any, *, host: str = "127.0.0.1", port: int = 8080) -> Live:
    """Show `frames` (a sequence of Frame, or the path of a .pvd index) in a viewer at http://host:port.

    Returns at once; the viewer runs until its `stop()` or the end of the process. Where the port is taken the next free
    one serves. LiveError without viser, ValueError without a frame.
    """
    if not 0 <= port <= 65535:
        raise ValueError(f"port is {port}: give one from 0 to 65535")
    try:
        viser = importlib.import_module("viser")
    except ImportError as problem:
        raise LiveError(f"{MISSING} ({problem})") from problem
    found: Sequence[Frame] = read_frames(frames) if isinstance(frames, str | Path) else list(frames)
    if not found:
        raise ValueError("there is no frame to show")
    server = viser.ViserServer(host=host, port=port, verbose=False)
    return Live(shown_parts(found), [frame.time for frame in found], server)


def _top(part: Shown, name: str) -> float:
    return float(np.nanmax(part.values[name], initial=0.0))


def _draw(scene: Any, part: Shown, number: int, field: str, top: float) -> None:
    """One part of a frame, in place of what has its name; one that stands still is drawn once."""
    first = min(number, len(part.starts) - 2)
    rows = slice(part.starts[first], part.starts[first + 1])
    places, label, plain = part.places[rows], f"/{part.name}", (255 * np.array(part.colour)).astype(np.uint8)
    if not len(places):
        scene.remove_by_name(label)
    elif part.kind == "line":
        scene.add_line_segments(label, places.reshape(-1, 2, 3), plain, thickness=2.0, thickness_units="screen")
    elif part.kind != "triangle":
        size = 0.01 * float(np.ptp(part.places, axis=0).max() or 1.0)
        scene.add_point_cloud(label, places, plain, point_size=size, precision="float32")
    elif field in part.values and top > 0:
        scene.add_mesh_trimesh(label, _coloured(places, part.cells, part.values[field][rows] / top))
    else:
        scene.add_mesh_simple(label, places, part.cells, color=tuple(int(each) for each in plain), side="double")


def _coloured(places: np.ndarray, cells: np.ndarray, shares: np.ndarray) -> Any:
    """A mesh with a colour a vertex, by `shares` from 0 to 1; trimesh comes with viser."""
    trimesh = importlib.import_module("trimesh")
    known = np.clip(np.nan_to_num(shares), 0, 1)
    colours = [np.interp(known, np.linspace(0, 1, len(RAMP)), RAMP[:, channel]) for channel in range(3)]
    rgba = np.stack([*colours, np.full(len(known), 255.0)], 1).astype(np.uint8)
    return trimesh.Trimesh(places, cells, process=False, vertex_colors=rgba)
