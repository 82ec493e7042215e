"""How far a body sinks against how fast it rings: the clock, the lengths and gravity checked without the material.

Let go from rest under its own weight a body sinks, in each mode, by a share of g / omega^2 that its shape and supports
alone set: what makes it softer or heavier makes it sink farther and ring slower by the same factor. So settled
displacement times the square of the frequency is the same for the recording and for any simulation of the scene, to
first order in the motion; times that are c times too long make it 1 / c^2 of that, lengths k times too large k.
"""

import itertools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jaxfem.fitting.course_checks import filled
from jaxfem.fitting.measurement import Measurement

if TYPE_CHECKING:  # it knows of checks before the search
    from jaxfem.fitting.result import TakeFit

OFF = 1.15
"""By which factor a clock is to be off: rubber that rings may be stiffer, by a third, than where it hangs."""
FEWEST = 10
"""Rows that say something."""
CYCLES = 1.5
"""That a recording is to hold."""
FINE = 3.0
"""Rows of a cycle at least."""
WRONG, NEAR = 1.4, 4.0
"""By which factor a clock is refused, and how far a start may sink beside what was measured."""
TOLD = 0.85
"""Share of the motion that one mode is to tell."""
APART = 0.2
"""Cycles in all by which rates to begin from differ: of more, a search would end in a minimum beside."""
MOST_ROWS = 300
RATIOS = np.array([0.003, 0.01, 0.03, 0.1, 0.2, 0.35, 0.5, 0.7, 0.9])
"""Damping ratios to begin from."""
MOST = 0.4
"""Damping ratio: what is damped more, or was smoothed, hardly tells at which rate it rings."""
STARTS, LONGEST = (0.0, 2.0), 5.0
"""Rows behind the release at which the swing seems to begin: of places that were smoothed, say."""


class Swing(NamedTuple):
    """`sunk` [m] where it settles, `rate` [rad/s] of its undamped ringing about that, and its damping `ratio`."""

    sunk: float
    rate: float
    ratio: float


def swing(times: np.ndarray, motion: np.ndarray) -> Swing | None:
    """The mode that tells a motion (T,) [m] from rest best, let go at about the first of `times`: with damping ratio z,
    rate w and v = w sqrt(1 - z^2) it is a (1 - exp(-z w t) (cos v t + z w / v sin v t)). None where one mode tells too
    little, or rings too little or too fast to say."""
    from scipy.optimize import least_squares

    times, motion = times[:MOST_ROWS], motion[:MOST_ROWS]
    spacing = float(np.median(np.diff(times)))

    def shape(x: np.ndarray) -> np.ndarray:
        """(..., 3) -> (..., T)."""
        ratio, rate = 1 / (1 + np.exp(-x[..., :1])), np.exp(x[..., 1:2])
        t, v = np.maximum(times - times[0] - x[..., 2:] * spacing, 0.0), rate * np.sqrt(1 - ratio**2)
        return np.asarray(1 - np.exp(-ratio * rate * t) * (np.cos(v * t) + ratio * rate / v * np.sin(v * t)))

    def left(x: np.ndarray) -> np.ndarray:
        told = shape(x)
        size = (told @ motion) / np.maximum(np.sum(told**2, axis=-1), 1e-300)
        return np.asarray(motion - size[..., None] * told)

    slowest, fastest = 2 * np.pi * CYCLES / np.ptp(times), 2 * np.pi / (FINE * spacing)
    if slowest >= fastest or not motion.any():
        return None
    apart = 2 * np.pi * APART / np.ptp(times)
    rates = np.log(np.arange(0.5 * slowest, fastest + apart, apart))
    beside = itertools.product(np.log(RATIOS / (1 - RATIOS)), STARTS)
    tried = [np.stack(np.broadcast_arrays(ratio, rates, start), axis=-1) for ratio, start in beside]
    costs = [np.sum(left(each) ** 2, axis=-1) for each in tried]
    least, at = min(zip(costs, tried, strict=True), key=lambda each: float(each[0].min()))
    begin = at[np.argmin(least)]
    found = least_squares(left, begin, bounds=([-12.0, -np.inf, -LONGEST], [6.0, np.inf, LONGEST]))
    share = 1 - 2 * found.cost / max(float(np.sum((motion - motion.mean()) ** 2)), 1e-300)
    if share < TOLD or not slowest <= np.exp(found.x[1]) <= fastest:
        return None
    told = shape(found.x)
    ratio = float(1 / (1 + np.exp(-found.x[0])))
    return Swing(float(told @ motion / (told @ told)), float(np.exp(found.x[1])), ratio)


class Off(NamedTuple):
    """By which factor times are too long, if it is they; how the recording swings, and the simulation; how `far` [m] a
    marker sinks at most."""

    clock: float
    found: Swing
    made: Swing
    far: float

    def words(self) -> str:
        """What it may be."""
        clock, hertz = self.clock, self.found.rate / (2 * np.pi)
        return (
            f"markers sink by up to {1e3 * self.far:.3g} mm and ring at {hertz:.3g} Hz, where this scene, sinking as "
            f"far, rings at {hertz * clock:.3g} Hz, whatever its stiffness and density: times are "
            f"{max(clock, 1 / clock):.3g} times too {'long' if clock > 1 else 'short'} (the rate of the frames?), or "
            f"lengths are {clock**-2:.2g} times what they are, or gravity, shape and supports are not the scene's; or "
            f"the material, when it rings, is {clock**-2:.2g} times as stiff as when it hangs"
        )


def clock_off(simulated: np.ndarray, measured: np.ndarray, times: np.ndarray, dt: float, order: int) -> Off | None:
    """How a body swings beside how a simulation of it in steps of `dt` [s] does, both (T, M, 3) [m] from where they
    were let go; None where that cannot be told, or what is off is less than its material may be, or the step."""
    moved, seen = simulated.reshape(len(times), -1), measured.reshape(len(times), -1)
    along = moved.mean(axis=0) / max(float(np.linalg.norm(moved.mean(axis=0))), 1e-300)
    found, made = swing(times, seen @ along), swing(times, moved @ along)
    if found is None or made is None or found.sunk * made.sunk <= 0 or max(found.ratio, made.ratio) > MOST:
        return None
    step = made.rate * dt
    slowed = step / (np.arctan(step) if order == 1 else 2 * np.arctan(step / 2))  # by backward Euler, or the trapezium
    clock = float(np.sqrt(made.sunk / found.sunk) * made.rate / found.rate)
    far = abs(found.sunk) * float(np.linalg.norm(along.reshape(-1, 3), axis=1).max())
    return None if 1 / (OFF * slowed) < clock < OFF * slowed else Off(clock, found, made, far)


def swing_warnings(take: "TakeFit", order: int) -> list[str]:
    """A warning of a take, of a body that is held and let go from rest under its own weight alone, that sinks too far
    or too little for how it rings; `order` of the scheme."""
    measured = filled(take.measured) if take.unit == "m" else None
    if measured is None or len(take.times) < FEWEST:
        return []
    begin = take.simulated[0]
    off = clock_off(take.simulated - begin, measured - begin, take.times, take.dt, order)
    return [] if off is None else [f"{take.name}: {off.words()}"]


def swing_faults(simulated: np.ndarray, measured: Measurement, dt: float, order: int) -> list[str]:
    """The same of a simulation (T, M, 3) at the start of a search, where it sinks about as far as was measured; less
    than `WRONG` a material may do that is stiffer when it rings."""
    places = filled(np.where(measured.seen[..., None], measured.positions, np.nan))
    if places is None or measured.free_origin or len(places) < FEWEST:
        return []
    off = clock_off(simulated - simulated[0], places - measured.origin, measured.times, dt, order)
    if off is None or not 1 / NEAR < off.made.sunk / off.found.sunk < NEAR or 1 / WRONG < off.clock < WRONG:
        return []
    return [f"the clock: {off.words()}"]
