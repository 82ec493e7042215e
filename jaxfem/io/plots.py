"""Plots of a run as PNG files, through matplotlib's figures without its global state."""

import importlib.util
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")  # told apart without red and green
PLAIN = (0.74, 0.74, 0.76, 1.0)
THROUGH = 0.3  # opacity of what has a cavity inside
MANY_TRIANGLES = 4000  # beyond this, edges would blacken the surface


class PlotError(RuntimeError):
    """Plots cannot be made; the message says what is missing."""


def plot_energies(path: Any, times: Any, energies: Mapping[str, Any]) -> Path:
    """Energies [J] over `times` [s], one line a kind and, where there are several, their sum; returns the path."""
    series = {name: np.asarray(values, float) for name, values in energies.items()}
    if len(series) > 1:
        series["sum"] = np.sum(list(series.values()), axis=0)
    return plot_series(path, times, series, "energy", "J", dashed=("sum",))


def plot_series(
    path: Any,
    times: Any,
    series: Mapping[str, Any],
    quantity: str,
    unit: str,
    dashed: Sequence[str] = (),
    title: str = "",
) -> Path:
    """Lines of `series` (name -> (frames,)) over `times` [s], in `unit` with a prefix that suits; returns the path."""
    figure = _figure(7.0, 4.2)
    axes = figure.add_subplot()
    largest = max((float(np.nanmax(np.abs(values), initial=0.0)) for values in series.values()), default=0.0)
    factor, prefix = _prefix(largest)
    for number, (name, values) in enumerate(series.items()):
        style = {"color": "0.25", "linestyle": "--"} if name in dashed else {"color": COLOURS[number % len(COLOURS)]}
        marker = "o" if len(times) < 2 else ""
        axes.plot(times, np.asarray(values) * factor, label=name, linewidth=1.6, marker=marker, **style)
    axes.set_xlabel("time (s)")
    axes.set_ylabel(f"{quantity} ({prefix}{unit})")
    axes.set_title(title)
    axes.grid(True, color="0.9")
    axes.set_axisbelow(True)
    axes.margins(x=0.02)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return _save(figure, path)


def plot_work(
    path: Any, lines: Mapping[str, tuple[Sequence[float], Sequence[float]]], time: str = "time a step (ms)"
) -> Path:
    """Error (relative) against `time` [ms] on logarithmic axes, a line a name; returns the path."""
    figure = _figure(7.6, 4.4)
    axes = figure.add_subplot()
    for number, (name, (times, errors)) in enumerate(lines.items()):
        colour, style = COLOURS[number // 2 % len(COLOURS)], "-" if number % 2 else "--"
        axes.loglog(times, errors, marker="o", markersize=4, color=colour, linestyle=style, label=name)
    axes.set_xlabel(time)
    axes.set_ylabel("error of places, relative to the motion")
    axes.grid(True, color="0.9")
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return _save(figure, path)


def plot_mesh(path: Any, points: Any, surface: Any, title: str) -> Path:
    """A surface, triangles (k, 3) of points (n, 3) [m], in one colour; returns the path."""
    corners = np.asarray(points)[np.asarray(surface)]
    figure = _figure(5.2, 4.4)
    axes: Any = figure.add_subplot(projection="3d")
    _draw_surface(axes, corners, np.tile(PLAIN, (len(corners), 1)))
    _dress(axes, title, _limits(corners.reshape(-1, 3)))
    return _save(figure, path)


def plot_shapes(
    path: Any,
    surface: Any,
    shapes: Mapping[str, Any],
    rest: Any = None,
    others: Mapping[str, Any] | None = None,
) -> Path:
    """Surface triangles (k, 3) in several `shapes` (title -> node positions (n, 3) [m]) beside each other.

    All in the same limits and at equal scale, coloured by the displacement from `rest` (n, 3), the first shape when
    None. `others`: title -> corners (t, 3, 3) [m] of what else there is, as of rigid bodies, in grey. A body with a
    cavity is drawn so that one sees through its outer surface. Returns the path.
    """
    surface, others = np.asarray(surface), dict(others or {})
    outer = _outer(surface, np.asarray(next(iter(shapes.values()))))
    rest = np.asarray(next(iter(shapes.values())) if rest is None else rest)
    places = {title: np.asarray(positions) for title, positions in shapes.items()}
    moved = {title: np.linalg.norm(positions - rest, axis=1) for title, positions in places.items()}
    top = max(float(values.max()) for values in moved.values())
    factor, prefix = _prefix(top)
    drawn = [positions[np.unique(surface)] for positions in places.values()]
    limits = _limits(np.concatenate([*drawn, *(np.reshape(each, (-1, 3)) for each in others.values())]))
    figure = _figure(4.2 * len(shapes) + 0.9, 3.6 if np.ptp(limits[2]) < np.ptp(limits[0]) else 4.4)
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    colours = ScalarMappable(Normalize(0.0, top * factor or 1.0), "viridis")
    all_axes = []
    for number, (title, positions) in enumerate(places.items(), 1):
        axes: Any = figure.add_subplot(1, len(shapes), number, projection="3d")
        shades = colours.to_rgba(moved[title][surface].mean(axis=1) * factor)
        shades[outer, 3] = THROUGH
        if title in others and len(others[title]):
            _draw_surface(axes, np.asarray(others[title]), np.tile(PLAIN, (len(others[title]), 1)))
        _draw_surface(axes, positions[surface], shades)
        _dress(axes, title, limits)
        all_axes.append(axes)
    bar = figure.colorbar(colours, ax=all_axes, shrink=0.65, pad=0.06, fraction=0.03)
    bar.set_label(f"displacement ({prefix}m)")
    return _save(figure, path)


def _outer(surface: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Which triangles (k,) are of outer surfaces with a cavity inside; none where there is no cavity.

    Triangles that share corners are one piece; pieces whose volume is negative are cavities' walls.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    ends = np.concatenate([surface[:, [0, 1]], surface[:, [1, 2]]])
    graph = coo_matrix((np.ones(len(ends)), ends.T), (len(points), len(points)))
    piece = connected_components(graph, directed=False)[1][surface[:, 0]]
    a, b, c = (points[surface[:, i]] for i in range(3))
    volumes = np.bincount(piece, np.einsum("ti,ti->t", a, np.cross(b, c)) / 6)
    hollow: np.ndarray = (volumes[piece] > 0) & bool((volumes < 0).any())
    return hollow


def _draw_surface(axes: Any, triangles: np.ndarray, colours: np.ndarray) -> None:
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    light = 0.72 + 0.28 * (normals @ np.array([0.3, -0.6, 0.74]))
    shaded = np.column_stack([np.clip(colours[:, :3] * light[:, None], 0.0, 1.0), colours[:, 3]])
    few = len(triangles) <= MANY_TRIANGLES
    axes.add_collection3d(
        Poly3DCollection(
            triangles, facecolors=shaded, edgecolors=(0, 0, 0, 0.35) if few else shaded, linewidths=0.3 if few else 0.1
        )
    )


def _limits(points: np.ndarray) -> np.ndarray:
    """Limits (3, 2) that hold all points, none of the axes too short to carry its numbers."""
    low, high = points.min(axis=0), points.max(axis=0)
    longest = float((high - low).max()) or 1.0
    half = 0.5 * np.maximum(1.08 * (high - low), 0.45 * longest)
    middle = 0.5 * (low + high)
    return np.column_stack([middle - half, middle + half])


def _dress(axes: Any, title: str, limits: np.ndarray) -> None:
    from matplotlib.ticker import MaxNLocator

    extent = limits[:, 1] - limits[:, 0]
    tall = extent[2] > 0.7 * extent[0]
    pads = {"x": 1 + 8 * extent[0] / extent.max(), "y": 1 + 8 * extent[1] / extent.max(), "z": 5 if tall else -9}
    for axis, (low, high), length in zip("xyz", limits, extent, strict=True):
        getattr(axes, f"set_{axis}lim")(low, high)
        count = max(2, round(5 * length / extent.max()))
        getattr(axes, f"{axis}axis").set_major_locator(MaxNLocator(count))
        getattr(axes, f"set_{axis}label")(f"{axis} (m)", labelpad=pads[axis], fontsize=9)
    axes.tick_params(labelsize=8, pad=1)
    axes.tick_params(axis="z", pad=3)
    axes.patch.set_alpha(0.0)  # or it hides the labels of its neighbour
    axes.set_box_aspect(extent, zoom=0.8 if tall else 1.0)  # the same length a metre on each axis
    axes.set_title(title, fontsize=11, y=1.0 if tall else 0.9)
    axes.view_init(elev=22, azim=-58)


def _prefix(largest: float) -> tuple[float, str]:
    """Factor and prefix that bring a number of that size to about 1 to 1000."""
    for size, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ")):
        if largest >= size:
            return 1.0 / size, prefix
    return (1.0, "") if largest == 0 else (1e9, "n")


MISSING = "plots need matplotlib: pip install 'jaxfem[cli]'"


def require_matplotlib() -> None:
    """PlotError with the remedy where matplotlib is not installed."""
    if importlib.util.find_spec("matplotlib") is None:  # looked for and not imported, which takes long
        raise PlotError(MISSING)


def _figure(width: float, height: float) -> Any:
    require_matplotlib()
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:  # there, and broken
        raise PlotError(MISSING) from None

    figure = Figure(figsize=(width, height), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _save(figure: Any, path: Any) -> Path:
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target)
    return target
