"""The tangent of an isotropic energy in principal axes, where its eigenpairs are known: negative ones are left out.

With F = U diag(s) V' the tangent at diag(s) couples the three diagonal entries among each other, and each entry beside
the diagonal with its mirror image alone: eigenvalues a + b (twist or flip) and a - b of [[a, b], [b, a]] (Smith, de
Goes & Kim 2019, for energies of invariants; Stomakhin, Howes, Schroeder & Teran 2012, for those of stretches). The
entries are read off the tangent, turned into those axes, so equal stretches are no exception.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.rotation import polar_components
from jaxfem.tensors import Matrix3, array_of, contract, matrix_of, product, symmetric_eigenpairs, transposed

Array = jax.Array
Energy = Callable[[Array], Array]

_PAIRS = ((1, 2), (0, 2), (0, 1))
_EQUAL = np.eye(3, dtype=bool)
_DIAGONAL, _SAME, _MIRRORED = (
    np.einsum(f"{axes}->ijkl", _EQUAL, _EQUAL)[..., None] for axes in ("ij,kl", "ik,jl", "il,jk")
)


def slope_of(energy: Energy, gradient: Array) -> Array:
    """d energy / dF (3, 3, D), of energies (D,) of each matrix of `gradient` (3, 3, D) alone."""
    found: Array = jax.grad(lambda h: jnp.sum(energy(h)))(gradient)
    return found


def tangent_of(energy: Energy, gradient: Array) -> Array:
    """d2 energy / dF2 (9, 9, D), rows and columns in the order of F's entries."""

    def along(direction: Array) -> Array:
        step = jnp.broadcast_to(direction[:, :, None], gradient.shape)
        change: Array = jax.jvp(lambda h: slope_of(energy, h), (gradient,), (step,))[1]
        return change

    found: Array = jax.vmap(along)(jnp.eye(9, dtype=gradient.dtype).reshape(9, 3, 3))
    return found.reshape(9, 9, -1)


def definite_part(tangent: Array, gradient: Array) -> Array:
    """The `tangent` (9, 9, D) of an isotropic energy at H = F - I, less its negative eigenvalues where it has some."""
    left, right = _axes(gradient)
    turn = (left[:, None, :, None] * right[None, :, None, :]).reshape(9, 9, -1)
    entries = _product(_product(turn.swapaxes(0, 1), tangent), turn).reshape(3, 3, 3, 3, -1)
    axial = jnp.stack([jnp.stack([entries[i, i, k, k] for k in range(3)]) for i in range(3)])
    values, rows = symmetric_eigenpairs(axial)
    worst = jnp.min(values, axis=0)
    # What is taken away, so that digits of what stays are not lost.
    excess = contract("kid,kd,kjd->ijd", rows, jnp.minimum(values, 0), rows)
    zero = jnp.zeros_like(worst)
    straight, across = [[zero] * 3 for _ in range(3)], [[zero] * 3 for _ in range(3)]
    for i, j in _PAIRS:
        same, crossed = entries[i, j, i, j], entries[i, j, j, i]
        twist, flip = jnp.minimum(same + crossed, 0), jnp.minimum(same - crossed, 0)
        worst = jnp.minimum(worst, jnp.minimum(twist, flip))
        straight[i][j] = straight[j][i] = 0.5 * (twist + flip)
        across[i][j] = across[j][i] = 0.5 * (twist - flip)
    # Entry (ij, kl): that of i and k where i = j and k = l, else that of i and j where ij = kl or ij = lk.
    beside = jnp.where(_MIRRORED, array_of(across)[:, :, None, None], 0)
    beside = jnp.where(_SAME, array_of(straight)[:, :, None, None], beside)
    taken = jnp.where(_DIAGONAL, excess[:, None, :, None], beside)
    less = _product(_product(turn, taken.reshape(9, 9, -1)), turn.swapaxes(0, 1))
    return jnp.where(worst < 0, tangent - less, tangent)


def _product(a: Array, b: Array) -> Array:
    """Products of matrices (9, 9, D)."""
    return contract("abd,bcd->acd", a, b)


def _axes(gradient: Array) -> tuple[Array, Array]:
    """U and V (3, 3, D) of F = I + `gradient` = U diag(s) V', both proper rotations."""
    one = jnp.eye(3, dtype=gradient.dtype)[:, :, None]
    deformation = matrix_of(gradient + one)
    rotation: Matrix3 = polar_components(deformation)
    _, rows = symmetric_eigenpairs(array_of(product(transposed(rotation), deformation)))
    right = rows.swapaxes(0, 1)
    return array_of(product(rotation, matrix_of(right))), right
