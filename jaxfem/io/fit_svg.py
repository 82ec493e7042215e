"""Small charts as SVG, written by hand: a report must open where matplotlib is not."""

import html
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")
WIDTH, HEIGHT, LEFT, BOTTOM, TOP = 340, 190, 52, 34, 8


def chart(
    x: Any,
    lines: Mapping[str, Any],
    title: str,
    across: str,
    unit: str,
    dots: Mapping[str, Any] | None = None,
) -> str:
    """A figure of `lines` by name (k,) over x (k,), with `dots` in the same colours; NaN leaves gaps."""
    x = np.asarray(x, float)
    every = np.concatenate([np.asarray(each, float) for each in (*lines.values(), *(dots or {}).values())])
    every = every[np.isfinite(every)]
    low, high = (float(every.min()), float(every.max())) if every.size else (0.0, 1.0)
    if high <= low:
        low, high = low - 1e-9 - abs(low) / 2, high + 1e-9 + abs(high) / 2
    right = float(x[-1]) if x[-1] > x[0] else float(x[0]) + 1.0

    def place(at: Any, values: Any) -> tuple[np.ndarray, np.ndarray]:
        over = LEFT + (np.asarray(at) - x[0]) / (right - x[0]) * (WIDTH - LEFT - 8)
        return over, HEIGHT - BOTTOM - (np.asarray(values) - low) / (high - low) * (HEIGHT - BOTTOM - TOP)

    parts = [f'<svg width="{WIDTH}" height="{HEIGHT}" role="img" aria-label="{html.escape(title)}">']
    for value in np.linspace(low, high, 3):
        level = float(place(x[0], value)[1])
        parts.append(f'<path d="M{LEFT} {level:.1f}H{WIDTH - 8}" stroke="#8884"/>')
        parts.append(f'<text x="{LEFT - 4}" y="{level + 4:.1f}" font-size="10" text-anchor="end">{value:.3g}</text>')
    for value in np.linspace(float(x[0]), right, 3):
        at = float(place(value, low)[0])
        parts.append(f'<text x="{at:.1f}" y="{HEIGHT - 18}" font-size="10" text-anchor="middle">{value:.3g}</text>')
    parts.append(f'<text x="{WIDTH / 2}" y="{HEIGHT - 4}" font-size="10">{html.escape(across)}</text>')
    for (name, values), colour in zip(lines.items(), COLOURS, strict=False):
        parts.append(f'<path d="{_path(*place(x, values))}" fill="none" stroke="{colour}" stroke-width="1.3"/>')
        if dots and name in dots:
            pairs = zip(*place(x, dots[name]), strict=True)
            marks = "".join(f"M{a:.1f} {b:.1f}h.01" for a, b in pairs if np.isfinite(b))
            parts.append(f'<path d="{marks}" stroke="{colour}" stroke-width="3" stroke-linecap="round" opacity=".5"/>')
    keys = " ".join(
        f'<span style="color:{colour}">{html.escape(name)}</span>' for name, colour in zip(lines, COLOURS, strict=False)
    )
    caption = html.escape(title + (f" ({unit})" if unit else ""))
    return f"<figure>{''.join(parts)}</svg><figcaption>{caption} {keys}</figcaption></figure>"


def heat(names: Sequence[str], matrix: np.ndarray) -> str:
    """A table of numbers from -1 to 1, shaded."""
    head = "".join(f"<th>{html.escape(name)}</th>" for name in names)
    rows = []
    for name, row in zip(names, matrix, strict=True):
        cells = "".join(
            f'<td style="background:rgba({"0,114,178" if v > 0 else "213,94,0"},{0.6 * abs(v):.2f})">{v:.3f}</td>'
            for v in row.tolist()
        )
        rows.append(f"<tr><th>{html.escape(name)}</th>{cells}</tr>")
    return f'<table id="correlations"><tr><th></th>{head}</tr>{"".join(rows)}</table>'


def _path(across: np.ndarray, up: np.ndarray) -> str:
    words, pen = [], "M"
    for a, b in zip(across, up, strict=True):
        if not np.isfinite(b):
            pen = "M"
            continue
        words.append(f"{pen}{a:.1f} {b:.1f}")
        pen = "L"
    return "".join(words)
