"""Constants of which samples tell no more than a limit: their intervals are those of the profile likelihood.

A bulk modulus near incompressibility, the compliance of a joint that hardly gives, the friction of what does not slide:
least squares leave their error bars as wide as themselves, while the likelihood still falls on one side.
"""

import dataclasses

import numpy as np

from jaxfem.fitting.advice import at_bound, interval_in_words
from jaxfem.fitting.after import profile
from jaxfem.fitting.result import FitResult


def with_limits(result: FitResult) -> FitResult:
    """The result, with profile intervals of those constants that declare a `limit` and that samples leave open."""
    evaluator, best = result.solution
    spread = np.sqrt(np.maximum(np.diag(best.uncertainty.covariance), 0.0))
    intervals, warnings = dict(result.intervals), list(result.warnings)
    for constant, z, bar, low, high in zip(result.constants, best.z, spread, *evaluator.unknowns.box, strict=True):
        if not constant.limit or (bar <= constant.transform.open_spread and not at_bound(z, low, high)):
            continue
        found = profile(result, constant.name).interval
        intervals[constant.name] = found
        if not np.isfinite(found).all():
            words = interval_in_words(*found, constant.unit)
            warnings.append(
                f"{constant.name} is {words} (95 %, by its profile likelihood): these samples bound it from "
                f"{'one side alone' if np.isfinite(found).any() else 'no side'}, and the estimate is any such value"
            )
    if intervals == result.intervals:
        return result
    return dataclasses.replace(result, intervals=intervals, warnings=tuple(warnings))
