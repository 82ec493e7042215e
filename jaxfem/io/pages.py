"""Frames of a run as one page of HTML that plays them, by itself: no server, no network."""

import base64
import csv
import html
import json
import string
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxfem.io.fields import FIELDS
from jaxfem.io.page_meshes import Shown, quantised, shown_parts
from jaxfem.io.reading import Frame

HERE = Path(__file__).parent / "page"
TEXTS = {"STYLE": ("page.css",), "SCRIPT": ("numbers.js", "parts.js", "graphs.js", "player.js")}
MOST_ROWS = 4000  # of a graph: more than a screen is wide
UNITS = {"displacement": "m", "velocity": "m/s"}


def write_page(
    path: Any,
    frames: Sequence[Frame],
    title: str,
    tables: Mapping[str, tuple[np.ndarray, Mapping[str, np.ndarray]]] | None = None,
    most: float = 10e6,
) -> tuple[Path, int]:
    """Write a page that plays `frames`; returns its path and how many of them it holds.

    `tables`: title with unit, like "energy (J)" -> times (k,) [s] and lines by name (k,), drawn in step. A page larger
    than `most` bytes takes every second frame, every third, and so on. ValueError without a frame.
    """
    if not frames:
        raise ValueError("there is no frame to show")
    if not most > 0:
        raise ValueError(f"most is {most}: give a positive number of bytes")
    every = 1
    while True:
        text = page_text(list(frames[::every]), title, tables or {})
        if len(text) <= most or every >= len(frames):
            break
        every = max(every + 1, int(np.ceil(every * len(text) / most)))
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(text, encoding="utf-8")
    return target, len(frames[::every])


def read_table(path: Any) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times (k,) [s] and the other columns of a table that a run wrote, by the names in its first line."""
    with open(path, newline="", encoding="utf-8") as file:
        head, *rows = list(csv.reader(file))
    values = np.array([[float(value) for value in row] for row in rows]).reshape(-1, len(head))
    return values[:, 0], dict(zip(head[1:], values[:, 1:].T, strict=True))


def page_text(frames: list[Frame], title: str, tables: Mapping[str, Any]) -> str:
    """The page that plays frames, as text."""
    parts = shown_parts(frames)
    low, span = _box(parts)
    colourings = _colourings(parts)
    data = {
        "times": [float(frame.time) for frame in frames],
        "about": f"{len(frames)} frames to t = {frames[-1].time:.4g} s, {sum(len(p.cells) for p in parts)} cells",
        "low": low.tolist(),
        "span": span.tolist(),
        "focus": _focus(parts),
        "colourings": [
            {"name": name, "unit": _unit(name), "low": 0.0, "high": top} for name, top in colourings.items()
        ],
        "meshes": [_mesh(part, low, span, colourings) for part in parts],
        "graphs": [_graph(name, *table) for name, table in tables.items()],
    }
    texts = {
        name: "\n".join((HERE / file).read_text(encoding="utf-8") for file in files) for name, files in TEXTS.items()
    }
    template = string.Template((HERE / "page.html").read_text(encoding="utf-8"))
    encoded = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("</", "<\\/")
    return template.substitute(TITLE=html.escape(title), DATA=encoded, **texts)


def _mesh(part: Shown, low: np.ndarray, span: np.ndarray, tops: Mapping[str, float]) -> dict[str, Any]:
    """A part as the script takes it."""
    wide = np.uint32 if part.cells.size and part.cells.max() >= 2**16 else np.uint16
    found: dict[str, Any] = {
        "name": part.name,
        "kind": part.kind,
        "colour": part.colour,
        "places": _encoded(quantised(part.places, low, span)),
        "starts": part.starts.tolist(),
        "index": _encoded(part.cells.astype(wide).ravel()) if part.indexed else None,
        "rest": None if part.rest is None else _encoded(part.rest.astype(np.float32)),
        "fields": [],
    }
    for name, values in part.values.items():
        share = np.nan_to_num(values / (tops[name] or 1.0))
        found["fields"].append(
            {"name": name, "values": _encoded(np.clip(255 * share, 0, 255).round().astype(np.uint8))}
        )
    return found


def _encoded(array: np.ndarray) -> dict[str, str]:
    small = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
    return {"type": f"{array.dtype.kind}{array.dtype.itemsize}", "data": base64.b64encode(small.tobytes()).decode()}


def _box(parts: Sequence[Shown]) -> tuple[np.ndarray, np.ndarray]:
    """Lower corner (3,) and lengths (3,) of the box around all places of all frames."""
    filled = [part.places for part in parts if len(part.places)]
    low = np.min([places.min(0) for places in filled], axis=0)
    high = np.max([places.max(0) for places in filled], axis=0)
    return low, np.maximum(high - low, 1e-9)


def _focus(parts: Sequence[Shown]) -> dict[str, Any] | None:
    """What to look at: where bodies are in all frames, ground apart."""
    bodies = [part.places for part in parts if part.is_body and len(part.places)]
    if not bodies:
        return None
    low, high = np.min([b.min(0) for b in bodies], axis=0), np.max([b.max(0) for b in bodies], axis=0)
    return {"target": ((low + high) / 2).tolist(), "size": float(np.linalg.norm(high - low)) or 1.0}


def _colourings(parts: Sequence[Shown]) -> dict[str, float]:
    """Largest value of each quantity that a part may be coloured by, displacement first."""
    tops: dict[str, float] = {}
    for part in parts:
        if part.rest is not None and part.is_body:
            counts = np.diff(part.starts)
            moved = [np.linalg.norm(each - part.rest, axis=1).max() for each in np.split(part.places, len(counts))]
            tops["displacement"] = max(tops.get("displacement", 0.0), float(max(moved)))
        for name, values in part.values.items():
            tops[name] = max(tops.get(name, 0.0), float(np.nanmax(values, initial=0.0)))
    return dict(sorted(tops.items(), key=lambda item: item[0] != "displacement"))


def _unit(name: str) -> str:
    return FIELDS[name].unit if name in FIELDS else UNITS.get(name, "")


def _graph(title: str, times: np.ndarray, lines: Mapping[str, np.ndarray]) -> dict[str, Any]:
    unit = title[title.rfind("(") + 1 : -1] if title.endswith(")") else ""
    some = slice(None, None, 1 + (len(times) - 1) // MOST_ROWS)
    shown = [{"name": name, "values": [_finite(value) for value in values[some]]} for name, values in lines.items()]
    return {"title": title, "unit": unit, "times": [float(time) for time in times[some]], "lines": shown}


def _finite(value: Any) -> float | None:
    return float(f"{value:.6g}") if np.isfinite(value) else None


def graphs_of(folder: Path, present: Callable[[Path], bool] = Path.is_file) -> dict[str, Any]:
    """The tables beside the frames of a run, as graphs: energies, and how far tracked points moved."""
    graphs: dict[str, Any] = {}
    if present(energies := folder / "energies.csv"):
        times, lines = read_table(energies)
        named = {name.removesuffix("_J"): values for name, values in lines.items()}
        graphs["energy (J)"] = times, {**named, "sum": np.sum(list(named.values()), axis=0)}
    if present(points := folder / "points.csv"):
        times, lines = read_table(points)
        names = dict.fromkeys(name[: -len("_x_m")] for name in lines)
        ways = {name: np.stack([lines[f"{name}_{axis}_m"] for axis in "xyz"], 1) for name in names}
        graphs["displacement of points (m)"] = (
            times,
            {name: np.linalg.norm(way - way[:1], axis=1) for name, way in ways.items()},
        )
    return graphs
