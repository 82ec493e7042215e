"""Elastic rows: each domain's stress as regularised constraint rows, in the constant eigenbasis of isotropy."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.elements.domains import (
    DomainMaterial,
    Domains,
    domain_force,
    domain_gradient,
    domain_strains,
    row_means,
    turned_ahead,
)
from jaxfem.elements.finite import of_energy
from jaxfem.elements.tetra import RotationKind
from jaxfem.indexing import gather, scatter_add
from jaxfem.pytrees import Pytree, static
from jaxfem.rows.lawful import LawRows, law_rows
from jaxfem.schemes import Stage
from jaxfem.tensors import (
    EIGENBASIS,
    Matrix3,
    array_of,
    contract,
    matrix_of,
    product,
    symmetric,
    to_eigenbasis,
    transposed,
)

Array = jax.Array


class ElasticRows(Pytree):
    """The r rows a domain of the part of the strain that is taken there, arrays of shape (r, D); never at a bound.

    Full: row 0 volumetric, rows 1 to 5 deviatoric. Deviatoric: the last five. Volumetric: the first, on clusters of
    domains, (1, C), where they are taken together.
    """

    domains: Domains
    rotation: Array  # (3, 3, D)
    compliance: Array  # (r, D) [1/(J s^2)]: a row's impulse is stress times volume times time, J s
    bias: Array  # (r, D) [1/s]
    nodes: int = static()

    bounds = None

    def apply(self, velocities: Array) -> Array:
        """Rate of the rotated strain, sym(R' grad v), with R held: (n, 3) [m/s] -> (r, D) [1/s]."""
        rotation = matrix_of(self.rotation)
        rate = symmetric(product(transposed(rotation), domain_gradient(self.domains, velocities)))
        return jnp.stack(row_means(self.domains, to_eigenbasis(rate)[self.domains.rows]))

    def apply_transpose(self, impulses: Array) -> Array:
        """Nodal impulses R S grad N_a of row impulses (r, D), S their symmetric matrix: -> (n, 3)."""
        return domain_force(self.domains, matrix_of(self.rotation), list(impulses), self.nodes)

    def impulse(self, velocities: Array) -> Array:
        """Nodal impulses (n, 3) that velocities imply, J' (c - J v) / C [N s]."""
        return self.apply_transpose((self.bias - self.apply(velocities)) / self.compliance)

    def tangent(self, velocities: Array, definite: Any) -> "ElasticRows":
        """How the impulses change with v: as they do everywhere."""
        return self

    def objective_and_impulse(self, velocities: Array) -> tuple[Array, Array]:
        """Half the sum of (c - J v)^2 / C, () [J], and minus its slope, `impulse`."""
        short = self.bias - self.apply(velocities)
        found = short / self.compliance
        return 0.5 * jnp.sum(found * short), self.apply_transpose(found)

    def diagonal(self, inverse_mass: Array) -> Array:
        """Diagonal of J M^-1 J': sum_a |s_r grad N_a|^2 / m_a; rotation drops out, but not within a cluster."""
        clusters = self.domains.clusters
        if clusters is not None:
            arms = cluster_arms(self.domains, turned_gradients(self.domains, self.rotation)) / jnp.sqrt(3.0)
            parts = jnp.sum(arms[:-1] ** 2, axis=1) * gather(inverse_mass, clusters.slot_node)
            return scatter_add(parts, clusters.slot_cluster, clusters.count)[None]
        corner = gather(inverse_mass, self.domains.cells).T
        basis = jnp.asarray(EIGENBASIS[self.domains.rows], corner.dtype)
        spread = contract("rij,aje->raie", basis, self.domains.gradients)
        return contract("raie,raie,ae->re", spread, spread, corner)


StepRows = ElasticRows | LawRows
"""What takes the place of a kind of domains in a step: linear rows, or an energy."""


def turned_gradients(domains: Domains, rotation: Array) -> Array:
    """r_a = R grad N_a, (m, 3, D)."""
    g = domains.gradients
    return sum((rotation[None, :, j] * g[:, None, j] for j in (1, 2)), start=rotation[None, :, 0] * g[:, None, 0])


def cluster_arms(domains: Domains, turned: Array) -> Array:
    """Mean of r_a over each cluster, for each pair of a cluster and a node: (Q + 1, 3), the last of padding."""
    clusters = domains.clusters
    assert clusters is not None
    parts = (clusters.shares * turned).transpose(2, 0, 1)
    return scatter_add(parts, clusters.slots, clusters.slot_node.shape[0] + 1)


def elastic_rows(
    kinds: Sequence[Domains],
    stage: Stage,
    materials: Sequence[DomainMaterial],
    kind: RotationKind = "polar",
    turns: Array | None = None,
    dropped: Array | None = None,
) -> tuple["StepRows", ...]:
    """Rows of one step, made at its `stage`; `materials`: one for each kind; `turns` (bodies, 3, 3): by how much the
    rotations of linear laws are those of later on. Of linear laws, the others' see `lawful`:

    With e the rotated strain plus the material's known offset, D its stiffness, and strain and rate at
    x_a = base + ahead + reach v and v_a = before + follow v (see `schemes`), the stress impulse is
        lam = -weight V D (e + J ahead + beta J before + (reach + follow beta) J v)
        =>   C = 1 / (D V weight (reach + follow beta)),   c = -(e + J ahead + beta J before) / (reach + follow beta).
    For backward Euler C = 1 / (D V dt (dt + beta)), c = -e / (dt + beta) (Benevolensky & Voroshilov 2009, section 2).
    """
    strains = domain_strains(kinds, stage.base, kind, dropped)
    ahead = strains if turns is None else turned_ahead(kinds, strains, turns)
    return tuple(
        law_rows(each, stage, material, start[1])
        if of_energy(material)
        else _rows(each, strain, rotation, stage, material)
        for each, start, (strain, rotation, _), material in zip(kinds, strains, ahead, materials, strict=True)
    )


def _rows(
    domains: Domains, strain: list[Array], rotation: Matrix3, stage: Stage, material: DomainMaterial
) -> ElasticRows:
    reach, follow, weight = stage.numbers(domains.row_nodes)
    damping = material.damping
    span = reach + follow * damping
    scale = 1 / (domains.row_volumes * weight * span)
    if scale.ndim == 2:
        parts = [s / w for s, w in zip(scale, material.weights(domains), strict=True)]
    else:
        parts = [scale / material.volumetric, *[scale / material.deviatoric] * 5][domains.rows]
    compliance = jnp.stack(parts)
    rows = ElasticRows(domains, array_of(rotation), compliance, jnp.stack(strain), stage.base.shape[0])
    known = rows.bias if material.offset is None else rows.bias + material.offset
    if stage.ahead is not None and stage.before is not None:
        known = known + rows.apply(stage.ahead) + damping * rows.apply(stage.before)
    return rows.replace(bias=-known / span)
