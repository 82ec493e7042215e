"""What is in a recording, in words: format, markers, clock, gaps, still parts, extent."""

import numpy as np

from jaxfem.fitting.clock_checks import jump_faults, pauses_in_words
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.recording import Recording
from jaxfem.fitting.release import find_release, motion_along_shape, scatter, settled_row
from jaxfem.fitting.repairs import repaired


def recording_text(recording: Recording) -> str:
    """Lines for people. Where samples are wrong, the text is of the repaired recording and says so."""
    rough = recording
    try:
        recording = repaired(recording)
        wrong = [f"  note: {text}" for text in recording.notes]
    except FitError as problem:
        wrong = [f"  note: {text}" for text in (*rough.notes, f"wrong: {problem}")]
    rows, count = recording.seen.shape
    times = recording.times
    pixels = recording.unit == "px"
    lines = [f"{recording.source or 'recording'}: {count} markers, {rows} rows from {times[0]:g} to {times[-1]:g} s"]
    lines.append(f"  unit: {recording.unit}" + ("" if pixels or recording.unit == "m" else ", taken to m"))
    lines += _clock(recording)
    lines += [_marker(recording, m) for m in range(count)]
    lines += _still(recording)
    return "\n".join([*lines, *wrong, *(f"  wrong: {text}" for text in jump_faults(recording))])


def _clock(recording: Recording) -> list[str]:
    steps = np.diff(recording.times)
    even = np.abs(steps - recording.spacing) < 0.05 * recording.spacing
    text = f"  rate: {1 / recording.spacing:.6g} rows a second"
    if not even.all():
        text += f"; {int((~even).sum())} of the {len(steps)} steps differ by more than 5 % (to {steps.max():.3g} s)"
    lines = [text, *(f"  pause: {text}" for text in pauses_in_words(recording))]
    if recording.spacing >= 1 and np.allclose(recording.times, np.round(recording.times), atol=1e-9):
        lines.append("  times are whole numbers: frame numbers or milliseconds, perhaps, not seconds")
    return lines


def _marker(recording: Recording, m: int) -> str:
    """Name, first place, reach and gaps."""
    seen, places = recording.seen[:, m], recording.positions[:, m]
    scale, unit = (1.0, "px") if recording.unit == "px" else (1e3, "mm")
    if not seen.any():
        return f"  {recording.names[m]}: never seen"
    first = places[np.argmax(seen)]
    reach = np.nanmax(np.linalg.norm(places[seen] - first, axis=1))
    where = ", ".join(f"{scale * value:.4g}" for value in (first[:2] if unit == "px" else first))
    edges = np.flatnonzero(np.diff(np.concatenate([[1], seen.astype(int), [1]])))
    lengths = edges[1::2] - edges[::2]
    gaps = "no gaps"
    if lengths.size:
        gaps = f"{int((~seen).sum())} samples missing in {len(lengths)} gaps, the longest {lengths.max()} rows"
    return f"  {recording.names[m]}: first at ({where}) {unit}, moves by {scale * reach:.4g} {unit}; {gaps}"


def _still(recording: Recording) -> list[str]:
    """Still until the release, settled from where; noise along the motion."""
    times = recording.times
    try:
        found = find_release(recording)
    except FitError as problem:
        return [f"  still: {problem}"]
    score = motion_along_shape(recording)
    settled = settled_row(recording)
    scale, unit = (1.0, "px") if recording.unit == "px" else (1e3, "mm")
    start = f"  still until {times[found.row]:g} s"
    if found.high > found.low:
        start += f" (95 %: {times[found.low]:g} to {times[found.high]:g} s)"
    if found.vague:
        start += ": too vague to fit by, give release = TIME"
    noise = scale * scatter(score[np.isfinite(score)])
    return [f"{start}; settled from {times[settled]:g} s on; noise about {noise:.2g} {unit} a coordinate"]
