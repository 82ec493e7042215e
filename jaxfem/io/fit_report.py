"""A fit as one page of HTML: verdict, table, misfit, plots, and the recording played against the simulation.

The page stands by itself, without server or network; the player is the page of `jaxfem view`, inside.
"""

import hashlib
import html
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxfem.fitting.advice import at_bound
from jaxfem.fitting.result import FitResult, TakeFit, length
from jaxfem.io.fit_search_page import beside_part, posterior_part, waterfall_part
from jaxfem.io.fit_svg import chart, heat
from jaxfem.io.pages import page_text
from jaxfem.io.parts import Part
from jaxfem.io.reading import Frame
from jaxfem.model import Model, State
from jaxfem.stepping import rollout

STYLE = """
:root { color-scheme: light dark; } body { font: 15px/1.5 system-ui, sans-serif; margin: 2em auto; max-width: 1100px;
padding: 0 1em; } table { border-collapse: collapse; } th, td { padding: .25em .7em; text-align: right;
border-bottom: 1px solid #8884; } th:first-child, td:first-child { text-align: left; } .bad { color: #c22; }
figure { display: inline-block; margin: .4em; } figcaption { font-size: 12px; } svg text { fill: currentColor; }
iframe { width: 100%; height: 520px; border: 1px solid #8884; } code { font-size: 12px; }
"""
MOST_MARKERS = 8
MOST_FRAMES = 400


def write_report(
    path: Any,
    result: FitResult,
    scene: tuple[Model, State] | None = None,
    files: Mapping[str, Path] | None = None,
    settings: Mapping[str, Any] | None = None,
    after: Sequence[str] = (),
) -> Path:
    """Write the page; returns its path. `scene`: (model, state) of the first take, to play it; `files`: those that the
    fit was made of, by what they are; `settings`: how it was asked for; `after`: further parts
    of HTML, behind the plots."""
    parts = [
        *_verdict(result),
        "<h2>Parameters</h2>",
        _table(result),
        *_refinements(result),
        *_agreement(result),
        "<h2>Misfit, fitted and held out</h2>",
        _takes(result.takes),
        *beside_part(result.takes),
    ]
    if len(result.values) > 1:
        parts += ["<h2>Correlations</h2>", heat(list(result.values), result.correlation)]
    if scene is not None and scene[0].nodes and result.unit == "m":
        frames = played_frames(scene[0], result.takes[0].state, result.takes[0])
        played = html.escape(page_text(frames, "recording and simulation", {}))
        parts += [
            "<h2>Recording (grey) and simulation</h2>",
            f'<iframe id="animation" title="recording and simulation" srcdoc="{played}"></iframe>',
        ]
    for take in result.takes:
        parts += _plots(take)
    parts += [*waterfall_part(result), *posterior_part(result), *after]
    parts += [
        "<h2>Search</h2>",
        _search(result),
        "<h2>Provenance</h2>",
        _provenance(result, files or {}, settings or {}),
    ]
    text = "\n".join(parts)
    title = "Fit of " + ", ".join(result.values)
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>'
        f"<style>{STYLE}</style></head><body><h1>{html.escape(title)}</h1>\n{text}\n</body></html>\n",
        encoding="utf-8",
    )
    return target


def played_frames(model: Model, state: State, take: TakeFit) -> list[Frame]:
    """The simulation at the found values each sample or few, with markers as simulated and as recorded."""
    spacing = float(np.median(np.diff(take.times)))
    every = max(1, round(spacing / take.dt))
    count = len(take.times)
    states, _ = rollout(model, take.params, state, take.dt, (count - 1) * every, every=every)
    rest, cells = np.asarray(model.rest, np.float64), np.asarray(model.elements.cells)
    places = np.concatenate([np.asarray(state.positions)[None], np.asarray(states.positions)]).astype(np.float64)
    frames = []
    for k in range(0, count, -(-count // MOST_FRAMES)):
        frame = Frame(float(take.times[k]), places[k], cells, {"displacement": places[k] - rest})
        seen = take.measured[k][np.isfinite(take.measured[k]).all(axis=1)]
        for name, points in (("points", take.simulated[k]), ("recorded", seen)):
            frame.parts[name] = Part(points, "vertex", np.arange(len(points))[:, None])
        frames.append(frame)
    return frames


def _verdict(result: FitResult) -> list[str]:
    good = result.status == "converged" and not result.warnings
    head = "converged" if good else f"{result.status}, with {len(result.warnings)} warnings"
    lines = [f'<p id="verdict" class="{"" if good else "bad"}"><b>{html.escape(head)}</b></p>', "<ul>"]
    lines += [f"<li>{html.escape(take.line())}</li>" for take in result.takes]
    lines += [f"<li>{html.escape(result.weakest)}</li>"] if result.weakest else []
    lines += [f'<li class="bad">warning: {html.escape(text)}</li>' for text in result.warnings]
    lines += [f"<li>recording: {html.escape(text)}</li>" for text in result.repairs]
    return [*lines, "</ul>"]


def _table(result: FitResult) -> str:
    rows = []
    for each in result.constants:
        name = each.name
        low, high = result.bounds[name]
        value, bar = result.values[name], result.standard_errors[name]
        near = at_bound(*(each.transform.unknown(at) for at in (value, low, high)))
        loose = np.isfinite(each.low) and bar > 0.5 * abs(value)  # of what may be zero that would say nothing
        flags = [text for text, on in (("at a bound", near), ("open", loose)) if on]
        cells = [result.starts[name], low, high, value, bar, *result.intervals[name]]
        numbers = "".join(f"<td>{cell:.5g}</td>" if np.isfinite(cell) else "<td>open</td>" for cell in cells)
        rows.append(
            f"<tr><td>{html.escape(name)}</td><td>{each.unit}</td>{numbers}<td class=bad>{', '.join(flags)}</td></tr>"
        )
    words = ("", "unit", "start", "lowest", "highest", "estimate", "standard uncertainty", "95 % from", "to", "")
    head = "".join(f"<th>{word}</th>" for word in words)
    return f'<table id="parameters"><tr>{head}</tr>{"".join(rows)}</table>'


def _refinements(result: FitResult) -> list[str]:
    """Refits with a finer step and mesh, beside the statistical uncertainty; nothing where none was made."""
    if not result.refinements:
        return []
    names = list(result.values)
    head = "".join(f"<th>{html.escape(name)}</th>" for name in names)
    bars = "".join(f"<td>{result.standard_errors[name]:.3g}</td>" for name in names)
    rows = [f"<tr><td>statistical</td><td>standard uncertainty</td>{bars}</tr>"]
    for each in result.refinements:
        for by, shifts in ((each.by, each.shift), ("estimate of the whole", each.estimate)):
            cells = "".join(f"<td>{shifts[name]:+.3g}</td>" for name in names)
            rows.append(f"<tr><td>{each.what}</td><td>{html.escape(by)}</td>{cells}</tr>")
    table = f'<table id="discretisation"><tr><th></th><th></th>{head}</tr>{"".join(rows)}</table>'
    return ["<h2>What the discretisation moves</h2>", table]


def _agreement(result: FitResult) -> list[str]:
    """What each take says alone; nothing where none was fitted so."""
    if not result.agreement:
        return []
    takes = dict.fromkeys(take for each in result.agreement for take in each.values)
    rows = []
    for each in result.agreement:
        own = [
            f"{each.values[take]:.5g} &plusmn; {each.errors[take]:.2g}" if take in each.values else "" for take in takes
        ]
        low, high = each.interval
        cells = [*own, f"{each.chance:.2g}", f"{each.between:.3g}", f"{each.mean:.5g}", f"{low:.5g} to {high:.5g}"]
        flag = "<td></td>" if each.agree else "<td class=bad>do not agree</td>"
        rows.append(f"<tr><td>{html.escape(each.name)}</td>{''.join(f'<td>{cell}</td>' for cell in cells)}{flag}</tr>")
    words = ["", *map(html.escape, takes), "chance", "scatter between takes", "mean", "95 %", ""]
    head = "".join(f"<th>{word}</th>" for word in words)
    return ["<h2>Each take alone</h2>", f'<table id="alone"><tr>{head}</tr>{"".join(rows)}</table>']


def _takes(takes: Sequence[TakeFit]) -> str:
    rows = []
    for take in takes:
        marker, axis, rms = take.worst
        cells = [
            "held out" if take.held_out else "fitted",
            length(take.noise, take.unit),
            length(take.scatter, take.unit),
            f"{100 * take.covered:.0f} %",
            f"{marker} {axis}, {length(rms, take.unit)}",
        ]
        rows.append(f"<tr><td>{html.escape(take.name)}</td>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    words = ("", "", "residual rms", "markers scatter", "inside 95 % band", "worst")
    return f'<table id="takes"><tr>{"".join(f"<th>{word}</th>" for word in words)}</tr>{"".join(rows)}</table>'


def _plots(take: TakeFit) -> list[str]:
    """Overlays of the markers that move most, residuals, autocorrelation."""
    scale, unit = (1e3, "mm") if take.unit == "m" else (1.0, take.unit)
    first = take.simulated[0]
    moved = np.nanmax(np.abs(take.simulated - first), axis=(0, 2))
    shown = sorted(np.argsort(-moved)[:MOST_MARKERS].tolist())
    parts = [f"<h2>{html.escape(take.name)}: measured (points) and simulated (lines)</h2>"]
    for m in shown:
        dots = {axis: scale * (take.measured - first)[:, m, k] for k, axis in enumerate("xyz")}
        lines = {axis: scale * (take.simulated - first)[:, m, k] for k, axis in enumerate("xyz")}
        parts.append(chart(take.times, lines, f"{take.markers[m]}, displacement", "s", unit, dots))
    parts.append(f"<h2>{html.escape(take.name)}: residuals and their autocorrelation</h2>")
    for m in shown:
        left = {axis: scale * take.residuals[:, m, k] for k, axis in enumerate("xyz")}
        parts.append(chart(take.times, left, f"{take.markers[m]}, residual", "s", unit))
    lags = np.arange(len(take.autocorrelation))
    parts.append(chart(lags, {"all markers": take.autocorrelation}, "autocorrelation of residuals", "samples", ""))
    return parts


def _search(result: FitResult) -> str:
    losses = np.array([visit.loss for visit in result.history])
    logs = np.log10(np.where(np.isfinite(losses) & (losses > 0), losses, np.nan))
    lines = {"each": logs, "best so far": np.fmin.accumulate(logs)}
    return chart(np.arange(1, len(losses) + 1), lines, "log10 of the loss", "simulation", "")


def _provenance(result: FitResult, files: Mapping[str, Path], settings: Mapping[str, Any]) -> str:
    import jaxfem

    rows = {
        "versions": f"jaxfem {jaxfem.__version__}, JAX {jax.__version__}, NumPy {np.__version__}, "
        f"Python {platform.python_version()}",
        **{
            what: f"{path.name}, sha256 {hashlib.sha256(path.read_bytes()).hexdigest()}" for what, path in files.items()
        },
        "time step": ", ".join(f"{take.name} {take.dt:.6g} s" for take in result.takes),
    }
    params = result.takes[0].params
    held = [name for name, value in params.constants.items() if name not in result.values and np.size(value)]
    rows["held"] = ", ".join(f"{name} {float(np.mean(np.asarray(params.constants[name]))):.6g}" for name in held)
    rows |= {f"setting {name}": repr(value) for name, value in settings.items()}
    cells = "".join(
        f"<tr><td>{html.escape(name)}</td><td><code>{html.escape(text)}</code></td></tr>" for name, text in rows.items()
    )
    return f'<table id="provenance">{cells}</table>'
