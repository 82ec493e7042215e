"""Constants beyond those of materials, by path.

`contact.NAME.friction`, `joint.NAME.compliance` (what the values of their rows declare, see `materials/quantities.py`),
`load.NUMBER.x`, `load.NUMBER.factor`, `gravity.x`, `gravity.turn.x`, `velocity.BODY.x`, `spin.BODY.x`, `mass.BODY`,
`place.BODY.x` and `turn.BODY.x` (of what starts free), `young.BODY` (any constant of a material, of one body),
`motion.NUMBER.amplitude.x` (of driven nodes) and `motion.BODY.velocity.x` (of a driven rigid body) and whatever else
`Motion` declares, `shear_modulus` and `bulk_modulus`; `marker.NAME.x`, how far a marker's place is off the given one;
`young.GROUP`, of the elements of a group that the take names.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxfem.fitting.errors import FitError
from jaxfem.fitting.moduli import BULK, SHEAR, Modulus, made_of_moduli
from jaxfem.fitting.spots import Entries, Factor, Keys, OfBody, Region, Shift, Spot, Start, StartTurn, Turn
from jaxfem.fitting.unknowns import with_values
from jaxfem.materials.constants import DENSITY, Constant
from jaxfem.materials.quantities import quantities_of, signed_constant
from jaxfem.model import Model, Params, State

AXES = "xyz"
REACH = 0.2  # of the body's extent: what a marker's place may be off


@dataclasses.dataclass(frozen=True)
class Placed(Constant):
    """A constant that stands at a `spot` of its own; its name is the path."""

    spot: Spot | None = None

    def _check_name(self) -> None:
        """Paths are no Python names."""


def with_all(
    params: Params, state: State, values: Mapping[str, Any], constants: tuple[Constant, ...]
) -> tuple[Params, State]:
    """Params and state with values of `constants` put where they stand, by name; those of materials first."""
    spots = {each.name: each.spot for each in constants if isinstance(each, Placed) and each.spot is not None}
    plain = {name: value for name, value in values.items() if name not in spots}
    params = with_values(params, plain, constants)
    for name, spot in spots.items():
        if name in values:
            params, state = spot.put(params, state, values[name])
    return params, state


def value_of(constant: Constant, params: Params, state: State) -> float:
    """The value that a scene gives a constant."""
    if isinstance(constant, Placed) and constant.spot is not None:
        return constant.spot.read(params, state)
    return float(jnp.mean(params.constants[constant.name]))


def placed_constants(model: Model, params: Params, state: State) -> dict[str, Constant]:
    """All that can be fitted by path in a scene."""
    makers = (_rows, _loads, _motions, _gravity, _starts, _masses, _bodies, _moduli)
    return {each.name: each for make in makers for each in make(model, params, state)}


def group_constants(groups: Mapping[str, Any], model: Model) -> dict[str, Constant]:
    """Each constant of a material, and the density, on the elements of each of the `groups`, name -> indices: paths
    `young.GROUP`. FitError for elements that are none."""
    owner, found = np.asarray(model.elements.body), dict[str, Constant]()
    for group, given in groups.items():
        rows = np.asarray(given)
        if rows.ndim != 1 or not rows.size or not np.issubdtype(rows.dtype, np.integer) or not _are(rows, len(owner)):
            raise FitError(f'group "{group}" is {given!r}; give numbers of elements, 0 to {len(owner) - 1}')
        laws = dict.fromkeys(model.laws[number] for number in np.unique(owner[rows]).tolist())
        for each in dict.fromkeys([*(one for law in laws for one in law.constants), DENSITY]):
            spot = Region(each.name, tuple(rows.tolist()), tuple(owner.tolist()))
            name = f"{each.name}.{group}"
            found[name] = _placed(name, each, spot, label=f"{each.title} of {group}")
    return found


def _are(rows: np.ndarray, count: int) -> bool:
    return bool(rows.min() >= 0 and rows.max() < count and len(np.unique(rows)) == len(rows))


def marker_shifts(names: Sequence[str], model: Model) -> dict[str, Constant]:
    """How far each marker's place is off the given one, along each axis of the scene."""
    rest = np.asarray(model.rest)
    reach = REACH * float(np.ptp(rest, axis=0).max() if model.size is None else model.size)
    shift = signed_constant("shift", "m", "")
    found = [
        _placed(shift_name(name, axis), shift, Shift(number, k), bounds=(-reach, reach), absolute=True)
        for number, name in enumerate(names)
        for k, axis in enumerate(AXES)
    ]
    return {each.name: each for each in found}


def shift_name(marker: str, axis: str) -> str:
    """The path of a marker's place."""
    return f"marker.{marker}.{axis}"


def _placed(name: str, constant: Constant, spot: Spot, **changes: Any) -> Placed:
    fields = {each.name: getattr(constant, each.name) for each in dataclasses.fields(Constant)}
    return Placed(**{**fields, "label": name, **changes, "name": name, "spot": spot})


def _rows(model: Model, params: Params, state: State) -> Iterator[Placed]:
    """What the values of joints' and contacts' rows declare: one constant for all rows of a joint or contact."""
    for kind, groups, values in (("contact", model.contacts, params.contacts), ("joint", model.joints, params.joints)):
        found: dict[str, tuple[list[Constant], list[tuple[Keys, tuple[int, ...]]]]] = {}
        for label in sorted(groups):
            names = groups[label].names
            length = getattr(groups[label], "length", True)
            for field, quantity in quantities_of(values[label]):
                if quantity.needs and not getattr(groups[label], quantity.needs, True):
                    continue
                constant = quantity.of(length)
                for owner in dict.fromkeys(names):
                    own = tuple(k for k, each in enumerate(names) if each == owner)
                    path = f"{kind}.{owner}.{constant.name}"
                    constants, places = found.setdefault(path, ([], []))
                    constants.append(constant)
                    places.append(((f"{kind}s", label, field), own))
        for path, (constants, places) in found.items():
            units = ", ".join(dict.fromkeys(each.unit for each in constants))
            yield _placed(path, constants[0], Entries(tuple(places)), unit=units)


def _loads(model: Model, params: Params, state: State) -> Iterator[Placed]:
    units = model.load_units or ("",) * len(params.loads)
    for number, (value, unit) in enumerate(zip(params.loads, units, strict=True)):
        shape = np.shape(value)
        if shape == ():
            whole = Entries(((("loads", number), None),))
            yield _placed(f"load.{number}", signed_constant("value", unit, ""), whole)
        elif shape == (3,):
            for k, axis in enumerate(AXES):
                spot = Entries(((("loads", number), (k,)),))
                yield _placed(f"load.{number}.{axis}", signed_constant("value", unit, ""), spot)
        factor = Constant("factor", "", "must be > 0", low=0.0)
        yield _placed(f"load.{number}.factor", factor, Factor(number))


def _motions(model: Model, params: Params, state: State) -> Iterator[Placed]:
    """What prescribed motions declare: of driven nodes by the motion's number, of rigid bodies by their name."""
    found: list[tuple[str, Keys, Any]] = [
        (str(number), ("motions", number), motion) for number, motion in enumerate(params.motions)
    ]
    if model.rigid is not None and params.rigid is not None:
        bodies = [model.rigid.names[int(k)] for k in np.asarray(model.rigid.driven)]
        pairs = zip(bodies, params.rigid.motions, strict=True)
        found += [(body, ("rigid", "motions", k), motion) for k, (body, motion) in enumerate(pairs)]
    for owner, keys, motion in found:
        for field, quantity in quantities_of(motion):
            constant, path = quantity.constant, f"motion.{owner}.{quantity.constant.name}"
            if np.shape(getattr(motion, field)) == (3,):
                for k, axis in enumerate(AXES):
                    yield _placed(f"{path}.{axis}", constant, Entries((((*keys, field), (k,)),)))
            else:
                yield _placed(path, constant, Entries((((*keys, field), None),)))


def _gravity(model: Model, params: Params, state: State) -> Iterator[Placed]:
    turn = signed_constant("turn", "rad", "")
    for k, axis in enumerate(AXES):
        spot = Entries(((("gravity",), (k,)),))
        yield _placed(f"gravity.{axis}", signed_constant("gravity", "m/s^2", ""), spot)
        yield _placed(f"gravity.turn.{axis}", turn, Turn(k), bounds=(-np.pi, np.pi), absolute=True)


def _starts(model: Model, params: Params, state: State) -> Iterator[Placed]:
    speed, spin = signed_constant("velocity", "m/s", ""), signed_constant("spin", "rad/s", "")
    place, turn = signed_constant("place", "m", ""), signed_constant("turn", "rad", "")
    free, body = np.asarray(model.free) > 0, np.asarray(model.node_body)
    for k, axis in enumerate(AXES):
        for number, name in enumerate(model.bodies):
            rows = tuple(np.flatnonzero(free & (body == number)).tolist())
            if rows:
                yield _placed(f"velocity.{name}.{axis}", speed, Start("velocities", False, rows, k))
            if len(rows) == np.count_nonzero(body == number):
                yield _placed(f"place.{name}.{axis}", place, Start("positions", False, rows, k))
        if model.rigid is None:
            continue
        for number, name in enumerate(model.rigid.names):
            if float(model.rigid.free[number]) > 0:
                yield _placed(f"velocity.{name}.{axis}", speed, Start("velocities", True, (number,), k))
                yield _placed(f"spin.{name}.{axis}", spin, Start("angular_velocities", True, (number,), k))
                yield _placed(f"place.{name}.{axis}", place, Start("positions", True, (number,), k))
                turned = StartTurn(number, k)
                yield _placed(f"turn.{name}.{axis}", turn, turned, bounds=(-np.pi, np.pi), absolute=True)


def _masses(model: Model, params: Params, state: State) -> Iterator[Placed]:
    if model.rigid is not None:
        for number, name in enumerate(model.rigid.names):
            mass = Constant("mass", "kg", "must be > 0 kg", low=0.0)
            yield _placed(f"mass.{name}", mass, Entries(((("rigid", "mass"), (number,)),)))


def _bodies(model: Model, params: Params, state: State) -> Iterator[Placed]:
    """Each constant of a material, and the density, of one soft body."""
    owner, count = np.asarray(model.elements.body), len(model.bodies)
    for number, name in enumerate(model.bodies):
        rows = np.flatnonzero(owner == number)
        for each in (*model.laws[number].constants, DENSITY):
            spot = OfBody(each.name, number, count, (int(rows[0]), int(rows[-1]) + 1))
            yield _placed(f"{each.name}.{name}", each, spot, label=f"{each.title} of {name}")


def _moduli(model: Model, params: Params, state: State) -> Iterator[Placed]:
    """Both moduli, where every law has its stiffness of them alone."""
    if made_of_moduli(model, params):
        modulus = Constant("modulus", "Pa", "must be > 0 Pa", low=0.0)
        yield _placed(SHEAR, modulus, Modulus(False), label="shear modulus", stiffness=True)
        yield _placed(BULK, modulus, Modulus(True), label="bulk modulus", limit=True, bounds=(1e-3, 1e6))
