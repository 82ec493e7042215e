"""Each take of a fit by itself, beside the others."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from jaxfem.fitting.agreement import agreement
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.recovery import fit_takes
from jaxfem.fitting.result import FitResult
from jaxfem.fitting.sharing import own_name
from jaxfem.fitting.takes import Take

LEFT_OUT = ("own", "held_out", "starts", "multi_start", "seed")
"""Settings of `fit_takes` that mean nothing for a take alone."""


def alone(result: FitResult, takes: Sequence[Take], **settings: Any) -> FitResult:
    """The result with its `agreement`: each fitted take is fitted by itself too, from the solution, with the `settings`
    that `fit_takes` was given, and what they share is compared. A warning names what they do not agree on, and takes
    that cannot be fitted alone. Priors count in each.

    FitError for takes that do not match the result, and for a single one.
    """
    fitted = [each for each in result.takes if not each.held_out]
    if len(fitted) < 2:
        raise FitError("only one take was fitted: there is nothing to compare it with")
    given = {each.name: each for each in takes}
    if missing := [each.name for each in fitted if each.name not in given]:
        raise FitError(f'no take is named "{missing[0]}": give those that were fitted')
    found, failed = {}, []
    for each in fitted:
        try:
            own = fit_takes(
                [given[each.name]], starts=[each.values], **_settings_of(settings, each.name, [*each.values])
            )
        except FitError as problem:
            failed.append(f"{each.name} cannot be fitted alone, and is not compared: {problem}")
            continue
        if own.status == "converged":
            found[each.name] = own
        else:
            failed.append(f"{each.name}: the fit of it alone ended with {own.status}, and is not compared")
    shared = [name for name in result.values if sum(name in each.values for each in found.values()) > 1]
    told = tuple(
        agreement(
            name,
            {take: each.values[name] for take, each in found.items() if name in each.values},
            {take: each.standard_errors[name] for take, each in found.items() if name in each.values},
        )
        for name in shared
    )
    warnings = [*result.warnings, *failed, *(each.line() for each in told if not each.agree)]
    return dataclasses.replace(result, agreement=told, warnings=tuple(warnings))


def _settings_of(settings: Mapping[str, Any], take: str, names: Sequence[str]) -> dict[str, Any]:
    """Those of one take: bounds and priors of what it has for itself by the plain name, and none of others'."""
    kept = {name: value for name, value in settings.items() if name not in LEFT_OUT}
    plain = {own_name(name, take): name for name in names} | {name: name for name in names}
    for word in ("bounds", "priors"):
        if kept.get(word):
            kept[word] = {plain[name]: value for name, value in kept[word].items() if name in plain}
    return kept
