"""What `jaxfem fit` is asked for beyond the fit. Each may take longer than the fit itself, fail or be interrupted: what
was found before it stays."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from jaxfem.cli.exits import DONE, FAILED, INTERRUPTED
from jaxfem.cli.messages import error
from jaxfem.cli.progress import Ticker
from jaxfem.fitting import FitError, FitResult, Take, contributions, profile

DENSITY, OTHERS = 0.01, 0.05
"""Shares of themselves by which constants that are held may be off."""
Step = tuple[str, Callable[[FitResult, Ticker], FitResult]]
"""Its name in words, and what makes of a result one that knows more."""


def gone_on(result: FitResult, steps: Sequence[Step]) -> tuple[FitResult, int]:
    """The result after all steps, and the exit code. One that fails is told and left out; an interruption ends them."""
    code = DONE
    for number, (name, made) in enumerate(steps):
        try:
            with Ticker(name) as ticker:
                result = made(result, ticker)
        except FitError as problem:
            error(f"{name}: {problem}; the fit itself is written")
            result, code = _without(result, f"{name} failed: {problem}"), FAILED
        except KeyboardInterrupt:
            missing = ", ".join(name for name, _ in steps[number:])
            error(f"interrupted; the fit itself is written, without {missing}")
            return _without(result, f"{missing}: asked for, and interrupted"), INTERRUPTED
    if result.posterior is not None and result.posterior.stopped:
        code = INTERRUPTED
    return result, code


def _held_constants(takes: Sequence[Take]) -> list[str]:
    """Constants of materials, in all takes, that may be 5 % more: not those that are zero, nor a ratio near 1/2."""
    names = sorted(set.intersection(*({*take.model.constants} & {*take.params.constants} for take in takes)))
    values = {name: [np.asarray(take.params.constants[name], np.float64) for take in takes] for name in names}
    most = {"poisson": 0.5 / (1 + OTHERS)}
    return [name for name in names if all(each.all() and each.max() < most.get(name, np.inf) for each in values[name])]


def _without(result: FitResult, why: str) -> FitResult:
    return dataclasses.replace(result, warnings=(*result.warnings, why))


def with_profiles(result: FitResult, ticker: Ticker) -> FitResult:
    """Profile likelihoods of all that was fitted but marker places."""
    names = [name for name in result.values if not name.startswith("marker.")]
    return dataclasses.replace(result, profiles=tuple(profile(result, name, ticker.show) for name in names))


def with_contributions(result: FitResult, ticker: Ticker, takes: Sequence[Take]) -> FitResult:
    """Type B of 1 % in the density and the size of soft bodies, of 5 % in other constants of materials that were held,
    and of 1 mm in marker places that were not fitted."""
    models = [take.model for take in takes]
    names = [name for name in _held_constants(takes) if name not in result.fitted_constants]
    held = {name: DENSITY if name == "density" else OTHERS for name in names}
    follows = all(model.bodies and all(hasattr(load, "reshaped") for load in model.loads) for model in models)
    shifts = any(name.startswith("marker.") for name in result.values)
    added = contributions(result, held, None if shifts else 1e-3, 0.01 if follows else None, ticker.show)
    sound = tuple(each for each in added if np.isfinite([*each.shift.values()]).all())  # others have no motion to tell
    return dataclasses.replace(result, contributions=sound)
