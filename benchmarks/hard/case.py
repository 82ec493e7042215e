"""What a hard case is: a function that runs something nasty and says what would be right; and how it is judged.

A case ends as "right" (all that is wanted holds), as "flagged: WORDS" (it does not, and a status, a warning, an error
or `info` says so), as "not served: WORDS" (the method refuses the scene by name), or as "SILENT".
"""

import dataclasses
import math
import time
import traceback
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import jaxfem as jf
from hard.running import Run
from hard.wanted import Wanted, brief, ended

REFUSALS = (jf.SceneError, jf.StepError, jf.MaterialError, jf.mesh.MeshError)


class NotServed(Exception):
    """A method cannot serve a scene, and `build` says so."""


@dataclasses.dataclass(frozen=True)
class Setting:
    """How a case is run: by which `route` (a method, perhaps with a scheme) and in which `dtype`."""

    route: str
    dtype: str

    @property
    def single(self) -> bool:
        """Whether in single precision."""
        return self.dtype == "float32"

    def rounding(self, double: float, single: float) -> float:
        """A limit that rounding decides: in double, in single precision."""
        return single if self.single else double


@dataclasses.dataclass(frozen=True)
class Told:
    """What a case returns: what is wanted, the runs that it is of, and `flags` that no run carries."""

    wanted: Sequence[Wanted]
    runs: Sequence[Run] = ()
    flags: Sequence[str] = ()
    recovery: float = math.nan
    note: str = ""


@dataclasses.dataclass(frozen=True)
class Case:
    """A case: its name, the group of its world, the routes that may serve, and whether it is of the quick half.

    `long`: only by the first route, for many steps.
    """

    name: str
    group: str
    routes: tuple[str, ...]
    quick: bool
    long: bool
    function: Callable[[Setting], Told]


CASES: dict[str, Case] = {}


def case(
    name: str, group: str, routes: Sequence[str], *, quick: bool = False, long: bool = False
) -> Callable[[Callable[[Setting], Told]], Callable[[Setting], Told]]:
    """Register a function as a case."""

    def register(function: Callable[[Setting], Told]) -> Callable[[Setting], Told]:
        if name in CASES:
            raise ValueError(f"two cases are called {name!r}")
        CASES[name] = Case(name, group, tuple(routes), quick, long, function)
        return function

    return register


def judged(each: Case, at: Setting) -> dict[str, Any]:
    """Run a case and say how it ended: one line of the table."""
    begun = time.perf_counter()
    told: Told | None = None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            told = each.function(at)
            outcome = _outcome(told, [str(one.message) for one in caught if _ours(one)])
        except NotServed as refusal:
            outcome = f"not served: {brief(refusal)}"
        except REFUSALS as refusal:
            outcome = f"flagged: refused: {brief(refusal)}"
        except Exception as crash:  # a crash is loud, but nothing that names its cause
            outcome = f"crashed: {type(crash).__name__}: {brief(crash)}"
            traceback.print_exc()
    line = {"case": each.name, "group": each.group, "route": at.route, "dtype": at.dtype, "outcome": outcome}
    line |= _figures(told) if told else {}
    return line | {"seconds": round(time.perf_counter() - begun, 2)}


def _ours(one: warnings.WarningMessage) -> bool:
    return issubclass(one.category, jf.AccuracyWarning)


def _outcome(told: Told, warned: list[str]) -> str:
    flags = [*told.flags, *(flag for run in told.runs for flag in run.flags()), *(f"warned: {each}" for each in warned)]
    return ended(told.wanted, flags)


def _figures(told: Told) -> dict[str, Any]:
    """The numbers of a line: those of the worst run."""

    def worst(values: Sequence[float]) -> float | None:
        known = [value for value in values if not math.isnan(value)]
        if len(known) < len(values) and any(not math.isfinite(run.last_energy) for run in told.runs):
            return None
        return float(f"{max(known):.3g}") if known and np.isfinite(max(known)) else None

    return {
        "wanted": "; ".join(str(one) for one in told.wanted),
        "energy_growth": worst([run.energy_growth for run in told.runs]),
        "linear_momentum": worst([run.linear_drift for run in told.runs]),
        "angular_momentum": worst([run.angular_drift for run in told.runs]),
        "recovery": None if math.isnan(told.recovery) else float(f"{told.recovery:.3g}"),
        "iterations": max((run.iterations for run in told.runs), default=None),
        "status": max((run.status for run in told.runs), default=None),
        "note": told.note,
    }
