"""Stress and strain inside bodies, as tensors on the elements, for display.

Domains take them in their own rotated frames; an element has the mean over the domains that it is part of, weighted by
its share of their volume, in its own frame and then turned into the world's.
"""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp

from jaxfem.batching import one_program
from jaxfem.elements.domains import DomainMaterial, Domains, domain_strains
from jaxfem.elements.finite import cauchy_stress, of_energy
from jaxfem.elements.tetra import deformation_gradient, rotation_of
from jaxfem.model import Model, Params, State, element_constants
from jaxfem.system.memory import domain_values, soon, step_materials
from jaxfem.tensors import Matrix3, from_eigenbasis, product, transposed

Array = jax.Array

PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))
"""Components of a symmetric tensor in files: xx, yy, zz, xy, yz, xz, as ParaView has them."""


@one_program
def tensors(model: Model, params: Params, state: State) -> dict[str, list[Array]]:
    """By name six coefficients (E,) each of the elements in the eigenbasis of their rotated frames.

    "stress" [Pa], of the strain and what is remembered, without `damping`; "strain"; and what the laws tell of
    themselves, such as "plastic_strain" or "viscous_strain", zero in bodies that have none.
    """
    domains = domain_strains(model.domains, state.positions, model.rotation_kind)
    strains, turns = [jnp.stack(own) for own, _, _ in domains], [turn for _, turn, _ in domains]
    materials = step_materials(model, params, state, soon(model.rest.dtype))
    known = zip(model.domains, materials, strains, turns, strict=True)
    stresses = [_stress(*each, state.positions) for each in known]
    # Volumetric stress may be shared between two kinds of domains; the strain is the same on both.
    told = [each.clusters is None for each in model.domains]
    found = {"stress": _on_elements(model, stresses, [True] * len(told)), "strain": _on_elements(model, strains, told)}
    if state.internal is None:
        return found
    values = element_constants(model, params)
    own = [
        {} if internal is None else dict(each.law.tensors(domain_values(each, values), internal, strain, each.rows))
        for each, internal, strain in zip(model.domains, state.internal, strains, strict=True)
    ]
    for name in dict.fromkeys(word for each in own for word in each):
        parts = [each.get(name, jnp.zeros_like(strain)) for each, strain in zip(own, strains, strict=True)]
        found[name] = _on_elements(model, parts, told)
    return found


def von_mises(coefficients: Sequence[Array], strain: bool = False) -> Array:
    """Von Mises value (E,): sqrt(3/2 s:s) of a stress, sqrt(2/3 s:s) of a strain, s the deviator."""
    # The eigenbasis is orthonormal and its first row volumetric: s:s is the sum of the other coefficients squared.
    value: Array = jnp.sqrt((2 / 3 if strain else 1.5) * sum(each**2 for each in coefficients[1:]))
    return value


def in_world(model: Model, state: State) -> Callable[[Sequence[Array]], Array]:
    """Coefficients in the elements' rotated frames -> components (E, 6) in the world's axes, ordered as `PAIRS`."""
    rotation = rotation_of(deformation_gradient(model.elements, state.positions), model.rotation_kind)

    def turned(coefficients: Sequence[Array]) -> Array:
        tensor = product(product(rotation, from_eigenbasis(list(coefficients))), transposed(rotation))
        return jnp.stack([tensor[i][j] for i, j in PAIRS], -1)

    return turned


def _stress(domains: Domains, material: DomainMaterial, strain: Array, rotation: Matrix3, positions: Array) -> Array:
    """Rows of the stress that a kind of domains takes, (r, D) or (r, C); all six where the law is not linear."""
    if of_energy(material):
        return cauchy_stress(domains, positions, material, rotation)
    known = material.from_rest(list(strain))
    return jnp.stack([w * row for w, row in zip(material.weights(domains), known, strict=True)])


def _on_elements(model: Model, parts: Sequence[Array], told: Sequence[bool]) -> list[Array]:
    """Six coefficients (E,) from those (r, D) of each kind of domains that is `told` of."""
    count = model.elements.count
    total = jnp.zeros((6, count), model.rest.dtype)
    for each, part, wanted in zip(model.domains, parts, told, strict=True):
        if wanted:
            rows = each.rows if len(part) < len(total) else slice(None)
            total = total.at[rows].add(_spread(each, part, count))
    return list(total)


def _spread(domains: Domains, part: Array, count: int) -> Array:
    """Values (r, D) or (r, C) of a kind's domains as means on its elements, (r, E); zero on all others."""
    if domains.clusters is not None and part.shape[1] != domains.volumes.shape[0]:
        part = part[:, domains.clusters.owner]
    if domains.members is None or domains.shares is None:
        return part
    weight = domains.shares * domains.volumes[:, None]
    whole = jnp.zeros(count, weight.dtype).at[domains.members].add(weight)
    total = jnp.zeros((len(part), count), weight.dtype).at[:, domains.members].add(part[:, :, None] * weight)
    return total / jnp.where(whole > 0, whole, 1)
