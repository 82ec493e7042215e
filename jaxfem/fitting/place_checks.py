"""Do the markers stand where they are said to stand? Unit, names and axes, from their places before the release.

Nothing is simulated: distances between markers do not depend on the frame, and what is left after the best rigid fit
says whether a unit, two names exchanged or a mirrored axis explains it.
"""

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from jaxfem.fitting.formats.units import LENGTHS
from jaxfem.fitting.frames import rigid_fit

Faults = Iterator[str]
CLOSE = 0.25  # by which a ratio of lengths may differ from a unit's
LOOSE = 0.1  # of the cloud's size: places are known to a few hundredths of it
BETTER = 0.3  # share of the misfit that an explanation may leave
AXES = "xyz"
LEAST_TURN = 0.01  # rad by which axes may be turned whatever markers say
_SCALED = "their given places, as inches taken for cm do: correct their unit, or see that both are of the same body"


def place_faults(
    measured: np.ndarray, nominal: np.ndarray, names: Sequence[str], frame: str, compare: str, moved: float = 0.0
) -> tuple[list[str], list[str]]:
    """(faults, notes) of measured places (M, 3) [m] before the release, NaN where unknown, against the given ones.

    A fault makes the fit wrong; a note is worth knowing. `frame`, `compare` as in `fit`; `moved` [m]: how far markers
    move behind the release.
    """
    known = np.isfinite(measured).all(axis=1)
    p, q = measured[known], nominal[known]
    named = [name for name, there in zip(names, known, strict=True) if there]
    if not len(p):
        return [], []
    size = _spread(q) if len(q) > 1 else 0.0
    if frame == "none" and compare == "displacement" and np.abs(p).max() < 0.02 * max(size, np.abs(q).max(), moved):
        return [], ["the recording holds displacements, not places: taken as they are"]
    unit = unit_faults(measured, nominal, names, frame)
    if unit or len(p) == 1:
        return unit or list(_far(p, q, 0.5 * np.abs(q).max(), named, frame, compare)), []
    faults = list(_arrangement(p, q, named, size, frame))
    if not faults:
        faults = list(_far(p, q, LOOSE * size, named, frame, compare))
    misfit = _rigid_misfit(p, q)
    notes = []
    if not faults and misfit > 0.3 * LOOSE * size:
        notes.append(f"marker places and given places differ by {1e3 * misfit:.3g} mm rms after the best rigid fit")
    if not faults and frame == "none" and compare == "displacement":
        shift = np.linalg.norm((p - q).mean(axis=0))
        if shift > LOOSE * size:
            notes.append(
                f"all markers are shifted by {1e3 * shift:.3g} mm: only displacements are compared, so it is free"
            )
    return faults, notes


def unit_faults(measured: np.ndarray, nominal: np.ndarray, names: Sequence[str], frame: str) -> list[str]:
    """Faults of places (M, 3) [m] that are far too large or small: another unit, of all columns or of some."""
    known = np.isfinite(measured).all(axis=1)
    p, q = measured[known], nominal[known]
    if not len(p):
        return []
    size = _spread(q) if len(q) > 1 else 0.0
    faults = list(_unit(p, q, size, frame))
    if not faults or len(p) == 1 or _rigid_misfit(p * size / _spread(p), q) < 0.5 * LOOSE * size:
        return faults
    named = [name for name, there in zip(names, known, strict=True) if there]
    left, words = min(_columns(p, q, named, frame), key=lambda each: each[0])
    return [words] if left < 0.5 * LOOSE * size else faults


def most_turned(measured: np.ndarray, nominal: Any, frame: str) -> float:
    """The largest angle [rad] by which the recording's axes may be turned, where markers stood at `measured` (M, 3) [m]
    before the release, NaN where unknown; infinite where that tells nothing of axes, as displacements do."""
    known, places = np.isfinite(measured).all(axis=-1), np.asarray(nominal, np.float64)
    if known.sum() < 3:
        return float("inf")
    p, q = measured[known], places[known]
    size = _spread(q)
    if _spread(p) < 0.5 * size:
        return float("inf")
    rotation = np.asarray(rigid_fit(p, q, np.ones(len(p)))[0])
    turned = float(np.arccos(np.clip(0.5 * (np.trace(rotation) - 1), -1.0, 1.0)))
    return (turned if frame == "none" else 0.0) + 3 * _rigid_misfit(p, q) / size + LEAST_TURN


def pixel_faults(measured: np.ndarray, nominal: np.ndarray, names: Sequence[str]) -> list[str]:
    """Faults of pixels (M, 3) before the release, NaN where unknown, against those of the given places."""
    known = np.isfinite(measured).all(axis=1)
    if known.sum() < 2:
        return []
    p, q = measured[known], nominal[known]
    off = np.linalg.norm(p - q, axis=1)
    if np.sqrt((off**2).mean()) < LOOSE * _spread(q):
        return []
    named = [name for name, there in zip(names, known, strict=True) if there]
    return [
        f'the pixels: "{named[int(np.argmax(off))]}" stands {off.max():.3g} px from where the camera sees its place: '
        "see the camera's matrix and its axes (v points down in most images), the markers' names and their places"
    ]


def _unit(p: np.ndarray, q: np.ndarray, size: float, frame: str) -> Faults:
    """Markers that are farther apart than their places by the ratio of two units."""
    if len(p) > 1 and size > 0:
        ratio, what = _spread(p) / size, f"stand {_spread(p):.3g} m apart, their given places {size:.3g} m"
    elif frame == "none" and np.linalg.norm(q[0]) > 0:
        far, near = float(np.linalg.norm(p[0])), float(np.linalg.norm(q[0]))
        ratio, what = far / near, f"lies {far:.3g} m from the origin, its given place {near:.3g} m"
    else:
        return
    if 1 / 3 < ratio < 3:
        return
    for sign, metres in LENGTHS.items():
        if sign != "m" and abs(ratio * metres - 1) < CLOSE:
            yield (
                f"the unit: markers of the recording {what}: it looks to be in {sign} instead of m. Call its columns "
                f'NAME_x_{sign}, read it with unit="{sign}", or multiply positions by {metres:g}'
            )
            return
        if sign != "m" and abs(ratio / metres - 1) < CLOSE:
            yield f"the unit: markers of the recording {what}: these places look to be in {sign} instead of m"
            return
    yield f"the scale: markers of the recording {what}: no unit explains that. See that both are of the same body, in m"


def _arrangement(p: np.ndarray, q: np.ndarray, names: Sequence[str], size: float, frame: str) -> Faults:
    """Names exchanged, an axis mirrored, axes renamed: whichever explains the misfit."""
    misfit = _rigid_misfit(p, q)
    asked = _shift_misfit(p, q) if frame == "none" else misfit
    if asked < 0.5 * LOOSE * size:
        return
    measure = _shift_misfit if frame == "none" else _rigid_misfit
    limit = max(BETTER * asked, 1e-12)
    options: list[tuple[float, str]] = []
    for i, j in itertools.combinations(range(len(p)), 2):
        order = np.arange(len(p))
        order[[i, j]] = j, i
        options.append(
            (
                measure(p[order], q),
                f'the names: "{names[i]}" and "{names[j]}" look exchanged. Exchange them in the recording',
            )
        )
    for new in itertools.permutations(range(len(p))) if 3 <= len(p) <= 6 else ():
        if sum(o != k for k, o in enumerate(new)) > 2:
            listed = ", ".join(f'"{names[o]}" is "{names[k]}"' for k, o in enumerate(new) if o != k)
            options.append((measure(p[list(new)], q), f"the names: they look exchanged; the recording's {listed}"))
    if len(p) > 3 and frame != "none":
        mirrored = _rigid_misfit(p * [1, 1, -1], q)
        options.append(
            (mirrored, "the axes: the recording is mirrored, one of its axes points the other way. Turn its sign")
        )
    if frame == "none":
        for turned, words in axis_changes():
            options.append((_shift_misfit(p @ turned.T, q), words))
        options.append(
            (
                misfit,
                "the axes: the markers are turned against their given places. They are not in the body's frame: use "
                'frame = "rest" (or "all")',
            )
        )
    options += _columns(p, q, names, frame)
    ratio = _spread(p) / size
    options.append((measure(p / ratio, q), f"the scale: markers stand {ratio:.3g} times as far apart as {_SCALED}"))
    good = min(limit, max(2 * min(left for left, _ in options), 0.1 * LOOSE * size))
    for left, words in options:  # the first, simplest one of those that explain it about equally well
        if left <= good:
            yield f"{words} (misfit {1e3 * asked:.3g} mm rms as they are, {1e3 * left:.3g} mm then)"
            return
    if asked > LOOSE * size and misfit > LOOSE * size:
        worst = int(np.argmax(np.linalg.norm(_aligned(p, q) - q, axis=1)))
        yield (
            f"the places: markers and given places differ by {1e3 * misfit:.3g} mm rms after the best rigid fit, "
            f'"{names[worst]}" most. See its name and place, or whether the body was deformed before the release'
        )


def _columns(p: np.ndarray, q: np.ndarray, names: Sequence[str], frame: str) -> list[tuple[float, str]]:
    """(misfit that it leaves, words) for each unit that columns of an axis, of two, or of a marker may be in."""
    measure = _shift_misfit if frame == "none" else _rigid_misfit
    found = []
    pairs = [(sign, "m", metres) for sign, metres in LENGTHS.items() if metres < 1]
    pairs += [("m", sign, 1 / metres) for sign, metres in LENGTHS.items() if metres < 1]
    for one, other, factor in pairs:
        words = f"look to be in {one} and the others in {other}: give each column its own unit (NAME_x_{one})"
        for axes in ((0,), (1,), (2,), (0, 1), (0, 2), (1, 2)):
            scaled = p.copy()
            scaled[:, axes] *= factor
            found.append((measure(scaled, q), f"the unit: columns {' and '.join(AXES[k] for k in axes)} {words}"))
        for k, name in enumerate(names) if len(names) > 2 else ():
            scaled = p.copy()
            scaled[k] *= factor
            found.append((measure(scaled, q), f'the unit: columns of "{name}" {words}'))
    return found


def _far(p: np.ndarray, q: np.ndarray, limit: float, names: Sequence[str], frame: str, compare: str) -> Faults:
    """Places are compared, and they are elsewhere."""
    if frame != "none" or compare != "position":
        return
    off = np.linalg.norm(p - q, axis=1)
    if np.sqrt((off**2).mean()) > limit:
        yield (
            f'the places: "{names[int(np.argmax(off))]}" stands {1e3 * off.max():.3g} mm from its given place before '
            'the release. Use compare = "displacement", frame = "rest", or correct the places'
        )


def axis_changes() -> list[tuple[np.ndarray, str]]:
    """Signed permutations of the axes but the identity, those with fewest changes first, and words for each."""
    changes = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            turned = np.zeros((3, 3))
            turned[np.arange(3), order] = signs
            count = sum(o != k for k, o in enumerate(order)) + sum(s < 0 for s in signs)
            listed = " ".join(f"{'-' if s < 0 else ''}{AXES[o]}" for s, o in zip(signs, order, strict=True))
            words = f"the axes: the scene's x y z look to be {listed} of the recording. Rename or turn its columns"
            if count:
                changes.append((count, turned, words))
    return [(turned, words) for _, turned, words in sorted(changes, key=lambda each: each[0])]


def _spread(points: np.ndarray) -> float:
    """Root mean square distance of points (k, 3) from their centre, times root two."""
    return float(np.sqrt(2 * ((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))


def _shift_misfit(p: np.ndarray, q: np.ndarray) -> float:
    return float(np.sqrt((((p - p.mean(axis=0)) - (q - q.mean(axis=0))) ** 2).sum(axis=1).mean()))


def _aligned(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """p turned and shifted onto q as well as a rigid motion can (Kabsch 1976)."""
    a, b = p - p.mean(axis=0), q - q.mean(axis=0)
    u, _, v = np.linalg.svd(a.T @ b)
    turn = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ v)) or 1]) @ v
    return np.asarray(a @ turn + q.mean(axis=0))


def _rigid_misfit(p: np.ndarray, q: np.ndarray) -> float:
    return float(np.sqrt(((_aligned(p, q) - q) ** 2).sum(axis=1).mean()))
