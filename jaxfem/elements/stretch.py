"""Strain of the rotated frame without its rotation: U - I with U = sqrt(F'F), the stretch of F = R U.

With E = F'F - I = 2 H + H^2 and h1, h2, h3 the invariants of H = U - I (Ting 1985, written for H so that no digit of
small strains cancels; e1, e2, e3 those of E),
    H = ((4 + h1) h3 I + (4 + 4 h1 + h1^2 - h2) E - E^2) / (8 + 8 h1 + 2 h2 + 2 h1^2 + h1 h2 - h3).
h1 is the root near e1 / 2 of a quartic, found by Newton's method from the third order in E: to rounding for strains up
to a third, at a fraction of what the nearest rotation takes. Where a domain is stretched by more, or inside out, that
is taken.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from jaxfem.batching import cond_any
from jaxfem.elements.domains import Domains, domain_gradient, domain_strains, row_means
from jaxfem.elements.tetra import RotationKind, rotated_strain, rotation_of
from jaxfem.tensors import Matrix3, array_of, determinant, matrix_of, product, to_eigenbasis, transposed

Array = jax.Array

WIDE = 0.47
"""|C - I| from which on the nearest rotation is taken: stretches then are between .73 and 1.37."""
TRIPS = 3
"""Of Newton's method: its start is off by 2e-3 at most, each trip squares that."""


def domain_stretches(kinds: Sequence[Domains], positions: Array, kind: RotationKind = "polar") -> list[Array]:
    """The strains (r, D) or (r, C) of `domain_strains`; for callers that need no rotation."""
    if kind != "polar":
        return [jnp.stack(strain) for strain, _, _ in domain_strains(kinds, positions, kind)]
    found: list[Array] = []
    for each in kinds:
        if each.clusters is None:
            strain = list(stretch_strain(domain_gradient(each, positions))[each.rows])
        else:
            strain = list(found[-1])
        found.append(jnp.stack(row_means(each, strain)))
    return found


def stretch_strain(deformation: Matrix3) -> Array:
    """U - I as coefficients (6, D) in the eigenbasis; as `rotated_strain` with the nearest rotation."""
    f = jax.lax.optimization_barrier(array_of(deformation))
    deformation = matrix_of(f)
    c = product(transposed(deformation), deformation)
    e = _packed([[c[i][j] - (1.0 if i == j else 0.0) for j in range(3)] for i in range(3)])
    near = (_square_trace(e) <= WIDE**2) & (determinant(deformation) > 0)

    def exact(f: Array, _: Array) -> Array:
        own = matrix_of(f)
        return jnp.stack(rotated_strain(own, rotation_of(own, "polar")))

    found: Array = cond_any(jnp.any(~near), exact, _by_root, f, e)
    return found


def _by_root(_: Array, e: Array) -> Array:
    h1, h2, h3 = _invariants(e)
    unit, first = (4 + h1) * h3, 4 + 4 * h1 + h1 * h1 - h2
    whole = 8 + 8 * h1 + 2 * h2 + 2 * h1 * h1 + h1 * h2 - h3
    # The barrier keeps XLA from working out the same anew for each entry of what follows.
    unit, first, second = jax.lax.optimization_barrier(jnp.stack([unit / whole, first / whole, 1 / whole]))
    own = _unpacked(e)
    squared = product(own, own)
    rows = [[first * own[i][j] - second * squared[i][j] for j in range(3)] for i in range(3)]
    return jnp.stack(to_eigenbasis([[rows[i][j] + unit if i == j else rows[i][j] for j in range(3)] for i in range(3)]))


def _invariants(e: Array) -> tuple[Array, Array, Array]:
    """Those of H, (D,) each, from E = 2 H + H^2 (6, D) packed.

    Traces, minors and determinants of both sides: h2 = h1 + h1^2 / 2 - e1 / 2, h3 = J - 1 - h1 - h2 with
    J^2 = det(I + E), and the quartic 4 h2 + 2 h1 h2 + h2^2 - (6 + 2 h1) h3 = e2 in h1.
    """
    xx, yy, zz, yz, xz, xy = e
    e1, square = xx + yy + zz, _square_trace(e)
    e2 = 0.5 * (e1 * e1 - square)
    e3 = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    e1, e2, e3 = jax.lax.optimization_barrier(jnp.stack([e1, e2, e3]))
    swelling = e1 + e2 + e3
    swelling = swelling / (1 + jnp.sqrt(1 + swelling))
    h1 = e1 / 2 - (e1 * e1 - 2 * e2) / 8 + (e1**3 - 3 * e1 * e2 + 3 * e3) / 16

    def others(h1: Array) -> tuple[Array, Array]:
        h2 = h1 + 0.5 * (h1 * h1 - e1)
        return h2, swelling - h1 - h2

    for _ in range(TRIPS):
        h2, h3 = others(h1)
        off = 4 * h2 + 2 * h1 * h2 + h2 * h2 - (6 + 2 * h1) * h3 - e2
        slope = (4 + 2 * h1 + 2 * h2) * (1 + h1) + 2 * h2 - 2 * h3 + (6 + 2 * h1) * (2 + h1)
        h1 = h1 - off / slope
    return h1, *others(h1)


def _square_trace(a: Array) -> Array:
    """tr(A^2) of a packed symmetric matrix."""
    xx, yy, zz, yz, xz, xy = a
    square: Array = xx * xx + yy * yy + zz * zz + 2 * (yz * yz + xz * xz + xy * xy)
    return square


def _packed(m: Matrix3) -> Array:
    """A symmetric matrix as its six entries (6, D): xx, yy, zz, yz, xz, xy."""
    entries = (m[0][0], m[1][1], m[2][2], m[1][2], m[0][2], m[0][1])
    packed: Array = jax.lax.optimization_barrier(jnp.stack(entries))
    return packed


def _unpacked(a: Array) -> Matrix3:
    return [[a[0], a[5], a[4]], [a[5], a[1], a[3]], [a[4], a[3], a[2]]]
