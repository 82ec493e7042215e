"""Materials with a memory: what they make of a step's rows, and what they remember after it. Nothing without them."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.elements.domains import DomainMaterial, Domains, domain_mean, domain_strains
from jaxfem.elements.finite import LawMaterial
from jaxfem.model import Model, Params, State, domain_materials, element_constants

Array = jax.Array


def first_memory(kinds: Sequence[Domains], dtype: Any) -> tuple[Any, ...] | None:
    """What is remembered at rest, one entry for each kind of domains; None where no material has a memory."""
    shapes = [(each.rows.stop - each.rows.start, *each.row_volumes.shape) for each in kinds]
    found = tuple(each.law.internal0(jnp.zeros(shape, dtype)) for each, shape in zip(kinds, shapes, strict=True))
    return None if all(each is None for each in found) else found


def step_materials(model: Model, params: Params, state: State, dt: Array) -> list[DomainMaterial]:
    """Material of each kind of domains in the coming step, with what is remembered in its factor and offset.

    Rows are D f (e + offset) + D beta de/dt, that is D' (e + offset + beta/f de/dt) with D' = D f.
    """
    materials = domain_materials(model, params)
    if state.internal is None:
        return materials
    values = element_constants(model, params)
    made = []
    for each, plain, internal in zip(model.domains, materials, state.internal, strict=True):
        if isinstance(plain, LawMaterial):
            plain = plain.replace(internal=internal, dt=dt)
        elif internal is not None:
            (volumetric, deviatoric), offset = each.law.response(domain_values(each, values), internal, dt, each.rows)
            # A number a row: the two parts may answer differently.
            factors = [volumetric, *[deviatoric] * 5][each.rows]
            times = [jnp.broadcast_to(plain.damping / f, each.row_volumes.shape) for f in factors]
            plain = DomainMaterial(
                plain.volumetric * volumetric, plain.deviatoric * deviatoric, jnp.stack(times), offset
            )
        made.append(plain)
    return made


def committed(model: Model, params: Params, state: State, positions: Array, dt: Array) -> Any:
    """What is remembered after a step of `dt` from `state` to `positions` (n, 3)."""
    if state.internal is None:
        return None
    values = element_constants(model, params)
    strains = domain_strains(model.domains, positions, model.rotation)
    return tuple(
        None
        if internal is None
        else each.law.commit(domain_values(each, values), internal, jnp.stack(strain), dt, each.rows)
        for each, internal, (strain, _, _) in zip(model.domains, state.internal, strains, strict=True)
    )


def resting_materials(model: Model, params: Params, internal: Any) -> list[DomainMaterial]:
    """Material of each kind of domains as its energy sees it: zero at the strain that it has come to rest at."""
    materials = domain_materials(model, params)
    if internal is None:
        return materials
    values = element_constants(model, params)
    made: list[DomainMaterial] = []
    for each, plain, own in zip(model.domains, materials, internal, strict=True):
        if isinstance(plain, LawMaterial):
            made.append(plain.replace(internal=own))
            continue
        rest = None if own is None else each.law.rest_strain(domain_values(each, values), own, each.rows)
        made.append(plain if rest is None else plain.replace(offset=-rest))
    return made


def domain_values(domains: Domains, values: dict[str, Array]) -> dict[str, Array]:
    """Constants of each set of rows, () or (D,) or (C,): means of the elements' (E,)."""
    return {each.name: domain_mean(domains, values[each.name]) for each in domains.law.constants}
