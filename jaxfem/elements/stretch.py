"""Strain of the rotated frame without its rotation: U - I with U = sqrt(F'F), the stretch of F = R U.

With C = F'F, X = (I + 10 C + 5 C^2)(5 I + 10 C + C^2)^-1 and two steps X <- (X + C X^-1) / 2, a stretch s is off by the
share 2 q^20, q = (s - 1)/(s + 1), which is rounding for strains up to a third; at less than half of what the nearest
rotation takes. Where a domain is stretched by more, or inside out, that is taken (Higham 2008, chapter 6).
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
    change = sum((c[i][j] - float(i == j)) ** 2 for i in range(3) for j in range(3))
    near = (change <= WIDE**2) & (determinant(deformation) > 0)

    def exact(f: Array) -> Array:
        own = matrix_of(f)
        return jnp.stack(rotated_strain(own, rotation_of(own, "polar")))

    found: Array = cond_any(jnp.any(~near), exact, _by_root, f)
    return found


def _by_root(f: Array) -> Array:
    c = _packed(product(transposed(matrix_of(f)), matrix_of(f)))
    one = _packed([[jnp.full_like(f[0, 0], i == j) for j in range(3)] for i in range(3)])
    square = _times(c, c)
    root = _times(one + 10 * c + 5 * square, _inverse(5 * one + 10 * c + square))
    for _ in range(2):
        root = 0.5 * (root + _times(c, _inverse(root)))
    return jnp.stack(to_eigenbasis(_unpacked(root - one)))


def _packed(m: Matrix3) -> Array:
    """A symmetric matrix as its six entries (6, D): xx, yy, zz, yz, xz, xy."""
    # The barrier keeps XLA from working out the same anew for each entry of what follows.
    entries = (m[0][0], m[1][1], m[2][2], m[1][2], m[0][2], m[0][1])
    packed: Array = jax.lax.optimization_barrier(jnp.stack(entries))
    return packed


def _unpacked(a: Array) -> Matrix3:
    return [[a[0], a[5], a[4]], [a[5], a[1], a[3]], [a[4], a[3], a[2]]]


def _times(a: Array, b: Array) -> Array:
    """The product of two that share their axes."""
    return _packed(product(_unpacked(a), _unpacked(b)))


def _inverse(a: Array) -> Array:
    xx, yy, zz, yz, xz, xy = a
    first = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    whole = xx * first[0] + xy * first[1] + xz * first[2]
    cofactors = first[0], xx * zz - xz * xz, xx * yy - xy * xy, xy * xz - xx * yz, first[2], first[1]
    inverse: Array = jax.lax.optimization_barrier(jnp.stack(cofactors) / whole)
    return inverse
