"""What is asked of a fit afterwards, for its page: profile likelihoods, what held values and places add (Type B)."""

import html
from collections.abc import Sequence

import numpy as np

from jaxfem.fitting.after import EDGE, Contribution, Profile
from jaxfem.fitting.result import FitResult
from jaxfem.io.fit_svg import chart


def after_parts(
    result: FitResult, profiles: Sequence[Profile] = (), contributions: Sequence[Contribution] = ()
) -> list[str]:
    """HTML of both, nothing of what is empty."""
    units = {each.name: each.unit for each in result.constants}
    parts = []
    if profiles:
        parts += ["<h2>Profile likelihoods</h2>", '<div id="profiles">']
        parts += [_profile(each, units[each.name]) for each in profiles]
        parts.append("</div>")
    if contributions:
        parts += ["<h2>What held values and marker places add (Type B)</h2>", _table(result, contributions, units)]
    return parts


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
