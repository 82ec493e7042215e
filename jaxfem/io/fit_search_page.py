"""Parts of a fit's page that tell how far it can be relied on: what was measured beside, the waterfall of starts, the
posterior."""

import html
from collections.abc import Sequence

import numpy as np

from jaxfem.fitting.multistart import in_words
from jaxfem.fitting.result import FitResult, TakeFit
from jaxfem.io.fit_svg import chart

BINS = 24
MOST_ROWS = 12


def waterfall_part(result: FitResult) -> list[str]:
    """The losses of all starts, sorted, and where the lowest ones led; nothing where no starts were drawn."""
    if not result.ends:
        return []
    losses = np.array([end.loss for end in result.ends])
    logs = np.log10(np.where(np.isfinite(losses) & (losses > 0), losses, np.nan))
    own = np.array([not end.drawn for end in result.ends])
    dots = {"drawn starts": np.where(own, np.nan, logs), "the usual search": np.where(own, logs, np.nan)}
    lines = {name: np.full(len(logs), np.nan) for name in dots}
    picture = chart(np.arange(1, len(logs) + 1), lines, "log10 of the loss at the end", "start, sorted", "", dots)
    names = list(result.values)
    head = "".join(f"<th>{html.escape(name)}</th>" for name in ("", *names, "loss", "", "began at"))
    rows = []
    for number, end in enumerate(result.ends[:MOST_ROWS]):
        cells = "".join(f"<td>{end.values[name]:.5g}</td>" for name in names)
        began = ", ".join(f"{name} {end.start[name]:.3g}" for name in names)
        said = "the best" if end.best else ""
        rows.append(f"<tr><td>{number + 1}</td>{cells}<td>{end.loss:.4g}</td><td>{said}</td><td>{began}</td></tr>")
    return [
        "<h2>Where all starts led</h2>",
        f'<div id="waterfall"><p>{html.escape(in_words(result.ends))}</p>{picture}<table><tr>{head}</tr>'
        f"{''.join(rows)}</table></div>",
    ]


def beside_part(takes: Sequence[TakeFit]) -> list[str]:
    """What was measured beside the markers, against what the fit tells; nothing where nothing was."""
    rows = []
    for take in takes:
        for each in take.beside:
            held = "held out" if take.held_out else "fitted"
            numbers = "".join(f"<td>{value:.5g}</td>" for value in (each.measured, each.sigma, each.predicted))
            named = "".join(f"<td>{html.escape(word)}</td>" for word in (take.name, held, each.what, each.unit))
            rows.append(f"<tr>{named}{numbers}<td>{each.off:+.2f}</td></tr>")
    if not rows:
        return []
    words = ("", "", "what", "unit", "measured", "standard uncertainty", "told", "off, in these")
    head = "".join(f"<th>{word}</th>" for word in words)
    return ["<h2>Measured beside the markers</h2>", f'<table id="beside"><tr>{head}</tr>{"".join(rows)}</table>']


def posterior_part(result: FitResult) -> list[str]:
    """Each parameter's draws beside the bell of its error bar; nothing where none were made."""
    found = result.posterior
    if found is None:
        return []
    units = {each.name: each.unit for each in result.constants}
    parts, rows = [], []
    for k, name in enumerate(found.names):
        draws = found.values[..., k].ravel()
        density, edges = np.histogram(draws, BINS, density=True)
        middle = (edges[1:] + edges[:-1]) / 2
        bar = result.standard_errors[name]
        bell = np.exp(-((middle - result.values[name]) ** 2) / (2 * bar**2)) / (bar * np.sqrt(2 * np.pi))
        parts.append(chart(middle, {"draws": density, "error bar": bell}, name, units[name], ""))
        low, high = found.intervals[name]
        cells = (found.means[name], found.deviations[name], low, high, *result.intervals[name], found.effective[name])
        numbers = "".join(f"<td>{cell:.5g}</td>" for cell in (*cells, found.scale_reduction[name]))
        rows.append(f"<tr><td>{html.escape(name)}</td><td>{html.escape(units[name])}</td>{numbers}</tr>")
    words = (
        "",
        "unit",
        "mean",
        "standard deviation",
        "95 % from",
        "to",
        "by error bar from",
        "to",
        "independent draws",
        "scale reduction",
    )
    head = "".join(f"<th>{word}</th>" for word in words)
    chains, count = found.values.shape[:2]
    told = (
        f"{chains} chains of {count} draws ({found.kind}), mean acceptance {found.accepted:.2g}, "
        f"{found.divergent} of them divergent"
    )
    return [
        "<h2>Posterior</h2>",
        f'<div id="posterior"><p>{html.escape(told)}</p><table><tr>{head}</tr>{"".join(rows)}</table>'
        f"{''.join(parts)}</div>",
    ]
