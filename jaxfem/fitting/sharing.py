"""Unknowns of several takes: those that they share, and those that each has for itself."""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxfem.fitting.errors import FitError
from jaxfem.fitting.paths import AXES, group_constants, marker_shifts, placed_constants, shift_name, value_of
from jaxfem.fitting.takes import Prepared
from jaxfem.fitting.unknowns import (
    DELAY,
    Unknowns,
    chosen,
    known_constants,
    start_value,
    unknowns,
    usual_names,
)
from jaxfem.materials.constants import Constant


@dataclasses.dataclass(frozen=True)
class Shared:
    """`unknowns` of the fit, points z to start from, and for each take its `own` constants by the unknowns' names;
    `bounded`: those whose bounds the user gave."""

    unknowns: Unknowns
    starts: list[np.ndarray]
    own: tuple[dict[str, Constant], ...]
    first: dict[str, float]
    bounded: frozenset[str] = frozenset()


def shared_unknowns(
    made: Sequence[Prepared],
    names: Sequence[str] | None,
    own: Sequence[str],
    starts: Sequence[Mapping[str, float]] | None,
    bounds: Mapping[str, Any] | None,
    more: Sequence[str] = (),
) -> Shared:
    """All unknowns with their starts and bounds; `more` names beside those asked for. FitError for strange names,
    starts or bounds."""
    asked = (names,) if isinstance(names, str) else names
    known = [_known(each) for each in made]
    everywhere = {name: constant for each in reversed(known) for name, constant in each.items()}
    scene = [each for each in everywhere.values() if any(each.name in one.take.model.constants for one in made)]
    wanted = tuple(usual_names(scene)) if asked is None else tuple(asked)
    plain = chosen((*wanted, *(each for each in more if each not in wanted)), everywhere)
    constants, mine, values = _spread(made, plain, known, own)
    given = [{**values, **dict(each)} for each in (starts or [{}])]
    _check_starts(given, constants)
    spacing = made[0].measured.spacing
    wide = _for_each_take(bounds, constants, mine)
    ranges = [unknowns(constants, each, wide, spacing) for each in given]
    for each in starts or ():
        for name, (low, high) in wide.items():
            if name in each and not low <= each[name] <= high:
                raise FitError(f"the start of {name}, {each[name]:g}, is outside its bounds, {low:g} to {high:g}")
    both = Unknowns(constants, np.min([r.lower for r in ranges], axis=0), np.max([r.upper for r in ranges], axis=0))
    return Shared(both, [both.unknown(each) for each in given], mine, given[0], frozenset(wide))


def check_own(own: Sequence[str], shared: Shared) -> None:
    """FitError for names in `own` that are not fitted; the delay, which is there by itself, need not be."""
    fitted = dict.fromkeys(each.name for one in shared.own for each in one.values())
    for name in own:
        if name not in fitted and name != DELAY.name:
            raise FitError(f"own names {name!r}, which is not fitted; fitted: {', '.join(fitted)}")


def _known(made: Prepared) -> dict[str, Constant]:
    """All that can be fitted of a take, by name: constants of materials, the delay, then what has a path."""
    model = made.take.model
    placed = {**placed_constants(model, made.params, made.state), **marker_shifts(made.markers.names, model)}
    placed |= group_constants(made.take.groups or {}, model)
    return {**known_constants(model.constants.values()), **placed}


def all_shifts(made: Sequence[Prepared]) -> tuple[str, ...]:
    """Paths of the places of all markers of these takes."""
    names = dict.fromkeys(name for each in made for name in each.markers.names)
    return tuple(shift_name(name, axis) for name in names for axis in AXES)


def _spread(
    made: Sequence[Prepared], plain: Sequence[Constant], known: Sequence[Mapping[str, Constant]], own: Sequence[str]
) -> tuple[tuple[Constant, ...], tuple[dict[str, Constant], ...], dict[str, float]]:
    """(unknowns, each take's constants by their names, their own values to start from)."""
    found: list[Constant] = []
    mine: list[dict[str, Constant]] = [{} for _ in made]
    values: dict[str, float] = {}
    for constant in plain:
        there = [k for k, each in enumerate(known) if constant.name in each]
        apart = constant.name in own and len(made) > 1
        for k in there:
            name = own_name(constant.name, made[k].take.name) if apart else constant.name
            if name not in values:
                own_value = 0.0 if constant is DELAY else value_of(constant, made[k].params, made[k].state)
                values[name] = start_value(constant, own_value, made[k].measured.spacing)
                found.append(dataclasses.replace(constant, name=name))
            mine[k][name] = constant
    return tuple(found), tuple(mine), values


def own_name(name: str, take: str) -> str:
    """The name of a parameter that a take has for itself."""
    return f"{name}_{re.sub(r'[^0-9A-Za-z]+', '_', take)}"


def _for_each_take(
    bounds: Mapping[str, Any] | None, constants: Sequence[Constant], mine: Sequence[Mapping[str, Constant]]
) -> dict[str, Any]:
    """Bounds by the unknowns' names: those of a parameter that takes have for themselves hold in each."""
    found = dict(bounds or {})
    for each in mine:
        for name, constant in each.items():
            if constant.name != name and constant.name in (bounds or {}):
                found.setdefault(name, found[constant.name])
    names = [each.name for each in constants]
    base = {constant.name for each in mine for name, constant in each.items() if constant.name != name}
    return {name: pair for name, pair in found.items() if name in names or name not in base}


def _check_starts(given: Sequence[Mapping[str, float]], constants: Sequence[Constant]) -> None:
    names = [each.name for each in constants]
    for each in given:
        strange = [name for name in each if name not in names]
        if strange:
            raise FitError(f'a start is given for "{strange[0]}", which is not fitted; fitted: {", ".join(names)}')
        for constant in constants:
            if constant.transform.proportional and not each[constant.name] > 0:
                raise FitError(
                    f"the start of {constant.name} is {each[constant.name]:g}; it must be positive: give it one in the "
                    "scene or in starts"
                )
