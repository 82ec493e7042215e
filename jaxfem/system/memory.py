"""Materials with a memory: what they make of a step's rows, and what they remember after it. Nothing without them."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.elements.domains import DomainMaterial, Domains, domain_mean, domain_strains
from jaxfem.elements.finite import of_energy
from jaxfem.elements.stretch import domain_stretches
from jaxfem.model import Model, Params, State, domain_materials, element_constants
from jaxfem.schemes import Stage
from jaxfem.tensors import inner

Array = jax.Array


def soon(dtype: Any) -> Array:
    """A time [s] so short that nothing relaxes in it: a memory's stress just after a state is the state's."""
    return jnp.asarray(1e-3 * float(jnp.finfo(dtype).eps) ** 0.5, dtype)


def first_memory(kinds: Sequence[Domains], dtype: Any) -> tuple[Any, ...] | None:
    """What is remembered at rest, one entry for each kind of domains; None where no material has a memory."""
    shapes = [(each.rows.stop - each.rows.start, *each.row_volumes.shape) for each in kinds]
    found = tuple(each.law.internal0(jnp.zeros(shape, dtype)) for each, shape in zip(kinds, shapes, strict=True))
    return None if all(each is None for each in found) else found


def memory_at(model: Model, params: Params, positions: Array, at_once: bool) -> tuple[Any, ...]:
    """What is remembered of `positions` (n, 3) where they have been held for ever, or were taken to `at_once`."""
    values = element_constants(model, params)
    strains = domain_strains(model.domains, positions, model.rotation_kind)

    def own(domains: Domains, strain: Array) -> Any:
        law = domains.law
        return law.internal_at_once(domain_values(domains, values), strain) if at_once else law.internal0(strain)

    return tuple(own(each, jnp.stack(strain)) for each, (strain, _, _) in zip(model.domains, strains, strict=True))


def step_materials(
    model: Model, params: Params, state: State, dt: Array, stage: Stage | None = None
) -> list[DomainMaterial]:
    """Material of each kind of domains in the coming step, with what is remembered in its factor and offset.

    `stage`: where the scheme takes stresses; None: `dt` [s] after the state.
    Rows are D f (e + offset) + D beta de/dt, that is D' (e + offset + beta/f de/dt) with D' = D f.
    """
    materials = domain_materials(model, params)
    if state.internal is None:
        return materials
    values = element_constants(model, params)
    made = []
    for each, plain, internal in zip(model.domains, materials, state.internal, strict=True):
        # Strain and rate are taken the share `follow` of the step after its start.
        later = dt if stage is None else stage.numbers(each.row_nodes)[1] * dt
        if of_energy(plain):
            plain = plain.replace(internal=internal, dt=later)
        elif internal is not None:
            (volumetric, deviatoric), offset = each.law.response(
                domain_values(each, values), internal, later, each.rows
            )
            # A number a row: the two parts may answer differently.
            factors = [volumetric, *[deviatoric] * 5][each.rows]
            times = [jnp.broadcast_to(plain.damping / f, each.row_volumes.shape) for f in factors]
            plain = DomainMaterial(
                plain.volumetric * volumetric, plain.deviatoric * deviatoric, jnp.stack(times), offset
            )
        made.append(plain)
    return made


def committed(
    model: Model, params: Params, state: State, positions: Array, dt: Array
) -> tuple[Any, dict[str, Array] | None]:
    """What is remembered after a step of `dt` from `state` to `positions` (n, 3), and what the laws count of it."""
    if state.internal is None:
        return None, None
    values = element_constants(model, params)
    strains = domain_stretches(model.domains, positions, model.rotation_kind)
    made: list[Any] = []
    counts: dict[str, Array] = {}
    for each, internal, end in zip(model.domains, state.internal, strains, strict=True):
        if internal is None:
            made.append(None)
            continue
        own = domain_values(each, values)
        made.append(each.law.commit(own, internal, end, dt, each.rows))
        found = each.law.counts(own, internal, made[-1], end, dt, each.rows)
        for word, count in jax.lax.stop_gradient(dict(found)).items():
            counts[word] = counts.get(word, 0) + jnp.asarray(count, jnp.int32)
    return tuple(made), counts or None


def resting_materials(model: Model, params: Params, internal: Any) -> list[DomainMaterial]:
    """Material of each kind of domains as its energy sees it: zero at the strain that it has come to rest at."""
    materials = domain_materials(model, params)
    if internal is None:
        return materials
    values = element_constants(model, params)
    made: list[DomainMaterial] = []
    for each, plain, own in zip(model.domains, materials, internal, strict=True):
        if of_energy(plain):
            made.append(plain.replace(internal=own))
            continue
        rest = None if own is None else each.law.rest_strain(domain_values(each, values), own, each.rows)
        made.append(plain if rest is None else plain.replace(offset=-rest))
    return made


def beside_strain(model: Model, params: Params, internal: Any) -> Array:
    """Energy () [J] that the laws' memories store beside that of the strain from rest."""
    values, energy = element_constants(model, params), jnp.zeros((), model.rest.dtype)
    for each, plain, own in zip(model.domains, domain_materials(model, params), internal, strict=True):
        if own is not None:
            weights = jnp.stack([jnp.broadcast_to(w, each.row_volumes.shape) for w in plain.weights(each)])
            density = each.law.stored(domain_values(each, values), own, weights, each.rows)
            energy = energy if density is None else energy + inner(each.row_volumes, density)
    return energy


def domain_values(domains: Domains, values: dict[str, Array]) -> dict[str, Array]:
    """Constants of each set of rows, () or (D,) or (C,): means of the elements' (E,)."""
    return {each.name: domain_mean(domains, values[each.name]) for each in domains.law.constants}
