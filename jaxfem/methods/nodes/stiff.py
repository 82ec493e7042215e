"""Stiff rows in the preconditioner: their few compliances are inverted exactly, so how stiff they are costs nothing."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from jaxfem.methods.nodes.factors import Factor
from jaxfem.solvers.dense import dense_inverse
from jaxfem.tensors import matmul

Array = jax.Array
Operator = Callable[[Array], Array]


def with_clusters(precondition: Operator, factor: Factor, blocks: Array, modes: Array, inverse: Array) -> Operator:
    """The preconditioner of S = A + C' W C from that of A, Q = D^-1 + Z G Z'; C v is the clusters' mean divergence.

    (Q^-1 + C' W C)^-1 = Q - Q C' (W^-1 + C Q C')^-1 C Q   (Woodbury 1950). The spectrum of its product with S lies
    within that of Q A and 1, so iterations do not grow with the stiffness W. `blocks` (N, 3, 3): D^-1; `modes` Z;
    `inverse` G. Two applications of Q each. Should the factorisation fail in rounding, the rows are left out.
    """
    shared = factor.shared
    if shared is None:
        return precondition
    clusters, dtype = shared.clusters, blocks.dtype
    on_modes = factor.on_modes(modes)
    means = jnp.zeros((clusters.count, on_modes.shape[1]), dtype)
    means = means.at[clusters.owner].add(clusters.shares[:, None] * on_modes)
    compliance = jnp.diag(1 / shared.weight) + shared.schur(blocks) + matmul(matmul(means, inverse), means.T)
    stiffness = dense_inverse(compliance)
    stiffness = jnp.where(jnp.isfinite(stiffness).all(), stiffness, 0.0)

    def apply(residual: Array) -> Array:
        pressures = matmul(stiffness, clusters.mean(factor.divergence(precondition(residual))))
        return precondition(residual - factor.gradient(clusters.spread(pressures)))

    return apply
