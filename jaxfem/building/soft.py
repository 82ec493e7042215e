"""Soft bodies' materials in `build`: strain domains by law, constants of all bodies side by side, what is refused."""

import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxfem.building.own_constants import taken_names
from jaxfem.declared.errors import AccuracyWarning as AccuracyWarning
from jaxfem.declared.errors import told
from jaxfem.declared.scene import SceneError, SoftBody
from jaxfem.elements.domains import Domains
from jaxfem.elements.smoothing import build_domains
from jaxfem.elements.strains import PLAIN, STRAINS, rows_of
from jaxfem.materials.answers import law_flaw
from jaxfem.materials.constants import DENSITY, MASS_DAMPING, Constant
from jaxfem.materials.moduli import ratio_and_modulus
from jaxfem.mesh import MeshWarning
from jaxfem.mesh.troubles import troubles


def check_answers(bodies: Sequence[SoftBody], names: Sequence[str], dtype: Any) -> None:
    """Refuse laws that answer what no step can use; nothing is computed for it."""
    given = [(name, value) for body in bodies for name, value in body.made_of.values.items()]
    spread = {name for name, value in given if np.ndim(value) or len(bodies) > 1}
    for body, name in zip(bodies, names, strict=True):
        law = body.made_of.law
        own = frozenset(each.name for each in law.constants if each.name in spread)
        for rows in (rows_of(part) for _, part in STRAINS[body.strain]):
            if flaw := law_flaw(law, own, rows.start, rows.stop, dtype):
                raise SceneError(f'{type(law).__name__}, the material of "{name}": {flaw}')


def check_body(body: SoftBody, name: str) -> None:
    """Refuse lengths that are no metres; warn of what its mesh notes, of seams and flat elements, and of locking."""
    size = np.ptp(body.mesh.points, axis=0).max()
    if not 1e-6 < size < 1e5:
        raise SceneError(
            f'"{name}" is {size:.3g} m long: lengths are in m. Rescale with mesh.scaled(factor) or read(..., scale=)'
        )
    for trouble in (*body.mesh.notes, *troubles(body.mesh)):
        warnings.warn(f'mesh of "{name}": {trouble}', MeshWarning, stacklevel=4)
    for doubt in told(body.made_of, "doubts", f'the material of "{name}"'):
        warnings.warn(f'"{name}", of {type(body.made_of).__name__}, {doubt}', AccuracyWarning, stacklevel=4)
    values: Any = {key: np.asarray(value, float) for key, value in body.made_of.values.items()}
    poisson = float(np.max(ratio_and_modulus(*body.made_of.stiffness(values))[0]))
    if body.strain == PLAIN and poisson > 0.45 + 1e-12:
        warnings.warn(
            f'"{name}" has Poisson\'s ratio {poisson:g} with plain linear tetrahedra, which lock above 0.45: it is '
            "several times too stiff near 0.5, and a fitted Young's modulus too low by the same factor",
            AccuracyWarning,
            stacklevel=4,
        )


def check_laws(bodies: Sequence[SoftBody], names: Sequence[str]) -> None:
    """Refuse constants of one name and two meanings, and names that `Params` has for others."""
    taken = taken_names()
    known: dict[str, Constant] = {}
    for body, name in zip(bodies, names, strict=True):
        law = body.made_of
        for each in law.constants:
            if each.name in taken or known.setdefault(each.name, each) != each:
                other = "params" if each.name in taken else "another law of the scene"
                raise SceneError(
                    f'{type(law).__name__}, the material of "{name}", calls a constant {each.name!r}, which is '
                    f"something else in {other}: give it another name"
                )


def body_domains(
    bodies: Sequence[SoftBody],
    cells: np.ndarray,
    gradients: np.ndarray,
    volumes: np.ndarray,
    body: np.ndarray,
    place: np.ndarray,
    points: np.ndarray,
    dtype: Any,
) -> tuple[Domains, ...]:
    """Where strain is taken: for each kind of domains and law that a body asks for, those of all bodies that do.

    Arrays as in `build_domains`.
    """
    asked = [[(kind, part, each.made_of.law) for kind, part in STRAINS[each.strain]] for each in bodies]
    made = []
    for kind, part, law in dict.fromkeys(each for own in asked for each in own):
        users = [number for number, own in enumerate(asked) if (kind, part, law) in own]
        chosen = np.flatnonzero(np.isin(body, users))
        made.append(build_domains(kind, part, law, chosen, cells, gradients, volumes, body, place, points, dtype))
    return tuple(made)


def body_constants(bodies: Sequence[SoftBody], dtype: Any) -> dict[str, Any]:
    """`Params.constants` of the bodies."""
    if not bodies:
        return {DENSITY.name: jnp.zeros(0, dtype)}
    declared = [{**body.made_of.values, DENSITY.name: body.density} for body in bodies]
    if more_constants(bodies):
        for values, body in zip(declared, bodies, strict=True):
            values[MASS_DAMPING.name] = 0.0 if body.mass_damping is None else body.mass_damping
    counts = [len(body.mesh.cells) for body in bodies]
    return {name: jnp.asarray(_spread(list(_filled(declared, name)), counts), dtype) for name in _names(declared)}


def more_constants(bodies: Sequence[SoftBody]) -> tuple[Constant, ...]:
    """The constants that bodies have beside those of their laws and density."""
    return (MASS_DAMPING,) if any(body.mass_damping is not None for body in bodies) else ()


def _names(declared: Sequence[dict[str, Any]]) -> dict[str, None]:
    return dict.fromkeys(name for values in declared for name in values)


def _filled(declared: Sequence[dict[str, Any]], name: str) -> Iterator[np.ndarray]:
    """The bodies' values; the others' mean where a law has no such constant, so that it does not shift means."""
    known = [np.asarray(values[name], float) for values in declared if name in values]
    mean = np.mean([np.mean(value) for value in known])
    for values in declared:
        yield np.asarray(values.get(name, mean), float)


def _spread(values: list[np.ndarray], counts: list[int]) -> np.ndarray:
    """A scalar for one body, one number a body, or one an element where any body asks for that."""
    if any(value.ndim for value in values):
        return np.concatenate([np.broadcast_to(v, count) for v, count in zip(values, counts, strict=True)])
    return values[0] if len(values) == 1 else np.stack(values)
