"""Matrices assembled on the nodes from the domains' blocks: 3x3 blocks, each node's in one padded row."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.elements.domains import DomainMaterial, Domains, domain_gradient
from jaxfem.elements.finite import Curvature, curvature, displacement_gradient, of_energy
from jaxfem.elements.mass import SharedMass
from jaxfem.elements.pattern import Pattern
from jaxfem.indexing import gather, scatter_add
from jaxfem.methods.nodes.factors import Factor, clustered, domain_factor
from jaxfem.methods.nodes.law_terms import arms_of, law_factor, law_sums
from jaxfem.methods.nodes.pairs import firsts, seconds
from jaxfem.pytrees import Pytree
from jaxfem.rows.elastic import ElasticRows, StepRows, turned_gradients
from jaxfem.rows.lawful import LawRows, TangentRows
from jaxfem.tensors import (
    array_of,
    contract,
    cross_matrix,
    guarded_inverse,
    matrix_of,
    product,
    symmetric,
    taken,
    transposed,
)

Array = jax.Array

_AXES = range(3)


class BlockMatrix(Pytree):
    """Symmetric matrix of 3x3 blocks: `blocks` (n, 3, 3 width) beside `neighbours` (n, width), itself in slot 0; plus
    a term for each of `factors`."""

    blocks: Array
    neighbours: Array
    factors: tuple[Factor, ...] = ()

    def apply(self, vector: Array) -> Array:
        """Matrix times (n, 3). One small dense product a node: the form that XLA runs fastest on a CPU."""
        multiplied = contract("nik,nk->ni", self.blocks, taken(vector, self.neighbours))
        return sum((factor.apply(vector) for factor in self.factors), start=multiplied)

    @property
    def diagonal_blocks(self) -> Array:
        """(n, 3, 3)."""
        return sum((factor.diagonal_blocks for factor in self.factors), start=self.blocks[:, :, :3])


def assemble(
    sums: Array, diagonal: Array, free: Array, pattern: Pattern, factors: Sequence[Factor] = ()
) -> BlockMatrix:
    """Blocks of all pairs of nodes (P, 3, 3) and a `diagonal` (n,) as one matrix; `free` (n,) 1 or 0.

    `diagonal` and `free` in the user's order; the matrix is in solver order, identity on padding. Rows and columns of
    fixed nodes keep only their diagonal. Rigid translations cost nothing, so a node's diagonal block is minus the sum
    of its row.
    """
    nodes, width = pattern.neighbours.shape
    diagonal = pattern.gathered(diagonal) + (1 - pattern.real)
    free = pattern.gathered(free)
    flat = sums.reshape(-1, 9)
    both = jnp.concatenate([flat, sums.swapaxes(1, 2).reshape(-1, 9), jnp.zeros((1, 9), sums.dtype)])
    stiffness = gather(both, pattern.blocks).reshape(nodes, width, 3, 3)
    identity = jnp.eye(3, dtype=sums.dtype)
    own = -stiffness.sum(1) * free[:, None, None] + diagonal[:, None, None] * identity
    coupled = free[:, None] * gather(free, pattern.neighbours)
    matrix = jnp.concatenate([own[:, None], stiffness[:, 1:] * coupled[:, 1:, None, None]], 1)
    return BlockMatrix(matrix.transpose(0, 2, 1, 3).reshape(nodes, 3, 3 * width), pattern.neighbours, tuple(factors))


def assemble_rows(
    rows: Sequence[StepRows | TangentRows],
    mass: Array,
    free: Array,
    pattern: Pattern,
    shared: SharedMass | None = None,
) -> BlockMatrix:
    """M + J' C^-1 J of elastic rows; `mass` (n,) lumped, `shared` what M has beside it."""
    sums = _zero_sums(pattern, mass.dtype) if shared is None else shared.blocks(pattern.pair_count)
    factors: list[Factor] = []
    for number, each in enumerate(rows):
        assert not isinstance(each, LawRows), "laws are linearised before their matrix is made"
        if isinstance(each, TangentRows):
            sums, factors = _with_law(sums, factors, each.domains, each.curvature, each.reach, free, pattern, number)
            continue
        turned = turned_gradients(each.domains, each.rotation)
        if each.domains.clusters is not None:
            weight = 1 / (3 * each.compliance[0])
            before = sum(factor.shared is not None for factor in factors)
            factors.append(clustered(factors.pop(), each.domains, turned, weight, free, pattern, before))
        elif each.domains.volumetric:
            factors.append(domain_factor(turned, 1 / (3 * each.compliance[0]), free, pattern, number))
        else:
            sums = sums + _row_sums(each, turned, pattern, number)
    return assemble(sums, mass, free, pattern, factors)


def _with_law(
    sums: Array,
    factors: list[Factor],
    domains: Domains,
    found: Curvature,
    reach: Any,
    free: Array,
    pattern: Pattern,
    number: int,
) -> tuple[Array, list[Factor]]:
    """The sums and factors with those of a kind of domains whose law is not linear."""
    if domains.clusters is not None:
        before = sum(factor.shared is not None for factor in factors)
        arms, weight = arms_of(domains, found), reach**2 * found.weight
        own = clustered(factors[-1], domains, arms, weight, free, pattern, before)
        if found.bend is not None and own.bend is not None:
            bend = own.bend.replace(matrix=own.bend.matrix + jnp.moveaxis(reach**2 * found.bend, -1, 0))
            own = own.replace(bend=bend)
        return sums, [*factors[:-1], own]
    if domains.volumetric:
        return sums, [*factors, law_factor(domains, found, reach, free, pattern, number)]
    return sums + law_sums(domains, found, reach, pattern, number), factors


def _row_sums(rows: ElasticRows, turned: Array, pattern: Pattern, number: int) -> Array:
    """J' C^-1 J of rows that are not volumetric, as blocks of all pairs (P, 3, 3).

    A row's stiffness w = 1/C splits into w_v (volumetric) and w_d (deviatoric); with r_a = R grad N_a the block is
        K_ab = sum over domains of (w_v - w_d)/3 r_a r_b' + w_d/2 (r_b r_a' + (r_a . r_b) I),
    that is lambda r_a r_b' + mu (...) with mu = w_d/2. Deviatoric rows alone have w_v = 0.
    """
    weight = 1 / rows.compliance[-1]
    bulk = 1 / rows.compliance[0] if rows.domains.whole else 0.0
    return _tangent_sums(turned, (bulk - weight) / 3, weight / 2, None, pattern, number)


def assemble_tangent(
    domains: Sequence[Domains],
    positions: Array,
    rotations: Sequence[Array],
    materials: Sequence[DomainMaterial],
    diagonal: Array,
    free: Array,
    pattern: Pattern,
    exact: bool = True,
) -> BlockMatrix:
    """Hessian of the corotated energy at `positions` (n, 3), with each kind's nearest rotations (3, 3, D).

    The exact one may be indefinite; otherwise rotations are held (stiffness warping), which is positive semi-definite.
    `diagonal` (n,) is added; `materials`: one for each kind.

    From P = R (2 mu (S - I) + lambda tr(S - I) I), S = R'F, and R'dR = skew(B^-1 2 vex(R'dF)), B = tr(S) I - S:
        K_ab = V ( 2 mu (r_a . r_b) I + lambda r_a r_b' + (2 mu - lambda tr(S - I)) skew(r_a) R B^-1 R' skew(r_b) ).
    Deviatoric domains have lambda = -2 mu / 3, volumetric ones mu = 0. Laws that are not linear have their own tangent.
    """
    sums = _zero_sums(pattern, positions.dtype)
    factors: list[Factor] = []
    for number, (each, rotation, material) in enumerate(zip(domains, rotations, materials, strict=True)):
        if of_energy(material):
            found = curvature(each, material, None, displacement_gradient(each, positions), definite=int(not exact))
            sums, factors = _with_law(sums, factors, each, found, 1.0, free, pattern, number)
            continue
        lam, mu = _lame(each, material)
        turned = turned_gradients(each, rotation)
        spin = _spin(each, positions, rotation, lam, mu) if exact else None
        if each.clusters is not None:
            before = sum(factor.shared is not None for factor in factors)
            factors.append(clustered(factors.pop(), each, turned, lam, free, pattern, before, spin))
        elif each.volumetric:
            factors.append(domain_factor(turned, lam, free, pattern, number, spin))
        else:
            sums = sums + _tangent_sums(turned, lam, mu, spin, pattern, number)
    return assemble(sums, diagonal, free, pattern, factors)


def _lame(domains: Domains, material: DomainMaterial) -> tuple[Array, Array]:
    """lambda and mu of the domains' part of the strain, times their volumes, (D,) [J]."""
    volumetric, deviatoric = (v * domains.row_volumes for v in (material.volumetric, material.deviatoric))
    mu = deviatoric / 2
    if domains.volumetric:
        return volumetric / 3, jnp.zeros_like(mu)
    return (volumetric if domains.whole else 0.0) / 3 - 2 * mu / 3, mu


def _spin(domains: Domains, positions: Array, rotation: Array, lam: Array, mu: Array) -> Array:
    """(2 mu - lambda tr(S - I)) R B^-1 R', (3, 3, D)."""
    turns = matrix_of(rotation)
    stretch = symmetric(product(transposed(turns), domain_gradient(domains, positions)))
    trace = stretch[0][0] + stretch[1][1] + stretch[2][2]
    turn = [[(trace if i == j else 0.0) - stretch[i][j] for j in range(3)] for i in range(3)]
    clusters = domains.clusters
    stress = 2 * mu - lam * (trace - 3) if clusters is None else clusters.spread(-lam * clusters.mean(trace - 3))
    return stress * array_of(product(product(turns, guarded_inverse(turn)), transposed(turns)))


def _tangent_sums(turned: Array, lam: Array, mu: Array, spin: Array | None, pattern: Pattern, number: int) -> Array:
    """Sums of lam r_a r_b' + mu (r_b r_a' + (r_a . r_b) I) over the domains, for all pairs (P, 3, 3).

    With `spin` W (3, 3, D): lam r_a r_b' + 2 mu (r_a . r_b) I + skew(r_a) W skew(r_b).
    """

    slots = pattern.pairs[number]
    a, b = firsts(turned, slots), seconds(turned, slots)
    pull, shear = seconds(lam * turned, slots), seconds(mu * turned, slots)
    dot = a[0] * shear[0] + a[1] * shear[1] + a[2] * shear[2]
    if spin is None:
        block = [[a[i] * pull[j] + shear[i] * a[j] + (dot if i == j else 0) for j in _AXES] for i in _AXES]
    else:
        each = seconds(jnp.broadcast_to(spin.reshape(9, -1), (len(turned), 9, spin.shape[-1])), slots)
        turn = product(cross_matrix(a), product(matrix_of(each.reshape(3, 3, -1)), cross_matrix(b)))
        block = [[a[i] * pull[j] + turn[i][j] + (2 * dot if i == j else 0) for j in _AXES] for i in _AXES]
    # Entry by entry along the pairs: whole arrays of blocks are transposed an entry at a time, eight times as slowly.
    entries = jnp.stack([entry for row in block for entry in row], -1)
    where = jnp.concatenate([each.reshape(-1) for each in slots])
    return scatter_add(entries, where, pattern.pair_count).reshape(-1, 3, 3)


def _zero_sums(pattern: Pattern, dtype: Any) -> Array:
    return jnp.zeros((pattern.pair_count, 3, 3), dtype)
