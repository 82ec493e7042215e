"""What is asked of a fit afterwards, for its page: profile likelihoods, what held values and places add (Type B)."""

import html
from collections.abc import Sequence

import numpy as np

from jaxfem.fitting.after import EDGE
from jaxfem.fitting.asked import Contribution, Profile
from jaxfem.fitting.fields import FieldFit, as_columns
from jaxfem.fitting.result import FitResult
from jaxfem.io.fit_svg import chart
from jaxfem.model import Model


def after_parts(result: FitResult) -> list[str]:
    """HTML of both, nothing of what was not asked for."""
    units = {each.name: each.unit for each in result.constants}
    parts = []
    if result.profiles:
        parts += ["<h2>Profile likelihoods</h2>", '<div id="profiles">']
        parts += [_profile(each, units[each.name]) for each in result.profiles]
        parts.append("</div>")
    if result.contributions:
        parts += [
            "<h2>What held values and marker places add (Type B)</h2>",
            _table(result, result.contributions, units),
        ]
    return parts


def field_part(found: FieldFit, model: Model) -> str:
    """HTML of a constant that was found element by element: along the body's longest axis."""
    table = as_columns(found, model)
    axis = max(("x_m", "y_m", "z_m"), key=lambda each: float(np.ptp(table[each])))
    order = np.argsort(table[axis], kind="stable")
    values = table[found.name][order]
    none, one = np.full(len(values), np.nan), np.full(len(values), found.mean)
    title = f"{found.name} of each element"
    words = (
        f"{len(found.values)} values, {found.status} after {found.iterations} iterations; against the one value that "
        f"fits best the field takes {100 * found.gain:.0f} % of the squared misfit away; standard deviations of the "
        f"logarithm under samples and prior {found.deviations.min():.2g} to {found.deviations.max():.2g}"
    )
    lines = {"elements": none, "one value": one}
    picture = chart(table[axis][order], lines, title, axis.replace("_", " "), found.unit, {"elements": values})
    return f'<h2>{html.escape(title)}</h2><div id="field"><p>{html.escape(words)}</p>{picture}</div>'


def _profile(each: Profile, unit: str) -> str:
    low, high = each.interval
    words = [f"{end:.4g}" if np.isfinite(end) else "no end before the bound" for end in (low, high)]
    lines = {"-2 log likelihood ratio": each.drop, "95 %": np.full(len(each.drop), EDGE)}
    return chart(each.values, lines, f"{each.name}, 95 % from {words[0]} to {words[1]}", unit or each.name, "")


def _table(result: FitResult, contributions: Sequence[Contribution], units: dict[str, str]) -> str:
    head = "".join(f"<th>{html.escape(f'{name} {units[name]}'.strip())}</th>" for name in result.values)
    rows = []
    for each in contributions:
        cells = "".join(f"<td>{each.shift[name]:.3g}</td>" for name in result.values)
        rows.append(f"<tr><td>{html.escape(each.what)}</td><td>{html.escape(each.by)}</td>{cells}</tr>")
    return f'<table id="type_b"><tr><th></th><th>off by</th>{head}</tr>{"".join(rows)}</table>'
