"""Elimination of sparse block matrices: against dense solves, on nets with chains, alone and in a batch."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxfem.solvers.elimination import factorise, solve_factored
from jaxfem.solvers.elimination_order import core_size, elimination_order

SIZE = 2


def net(side, chain):
    """Pairs of a net of `side` by `side` nodes with a chain hanging from each; nodes numbered at random."""
    number = np.random.default_rng(0).permutation(side * side * (chain + 1)).reshape(side, side, chain + 1)
    sides = [np.stack([number[1:, :, 0], number[:-1, :, 0]], -1), np.stack([number[:, 1:, 0], number[:, :-1, 0]], -1)]
    chains = np.stack([number[:, :, 1:], number[:, :, :-1]], -1)
    pairs = np.concatenate([each.reshape(-1, 2) for each in (*sides, chains)])
    return number.size, pairs


def random_matrix(count, pairs, seed, dtype):
    """A dense positive definite matrix, and its blocks."""
    rng = np.random.default_rng(seed)
    beside = rng.normal(size=(len(pairs), SIZE, SIZE))
    matrix = np.zeros((count, SIZE, count, SIZE))
    for (i, j), block in zip(pairs, beside, strict=True):
        matrix[i, :, j], matrix[j, :, i] = block, block.T
    flat = matrix.reshape(count * SIZE, -1)
    flat += (0.1 - np.linalg.eigvalsh(flat).min()) * np.eye(len(flat))
    diagonal = np.stack([matrix[i, :, i] for i in range(count)])
    return flat, jnp.asarray(diagonal, dtype), jnp.asarray(beside, dtype)


@pytest.mark.parametrize(("side", "chain"), [(6, 4), (3, 2), (1, 40)])
def test_solves_are_those_of_the_dense_matrix_in_a_batch_too(side, chain):
    count, pairs = net(side, chain)
    order = elimination_order(count, pairs)
    if side == 6:
        assert [each.nodes.shape for each in order.leaves] == [(4, 36)] and core_size(order)[0] > 1
    order = jax.tree.map(jnp.asarray, order)
    cases = [random_matrix(count, np.asarray(order.pairs), seed, jnp.float64) for seed in range(2)]
    right = np.random.default_rng(3).normal(size=(count, SIZE))

    def solve(diagonal, beside):
        return solve_factored(order, factorise(order, diagonal, beside), jnp.asarray(right))

    alone = [jax.jit(solve)(*case[1:]) for case in cases]
    for case, found in zip(cases, alone, strict=True):
        np.testing.assert_allclose(found.ravel(), np.linalg.solve(case[0], right.ravel()), rtol=1e-9, atol=1e-9)
    together = jax.vmap(solve)(*(jnp.stack(parts) for parts in zip(*(case[1:] for case in cases), strict=True)))
    np.testing.assert_allclose(together, jnp.stack(alone), rtol=1e-9, atol=1e-9)


def test_single_precision_and_matrices_that_are_not_definite():
    count, pairs = net(3, 2)
    order = jax.tree.map(jnp.asarray, elimination_order(count, pairs))
    matrix, diagonal, beside = random_matrix(count, np.asarray(order.pairs), 0, jnp.float32)
    right = np.random.default_rng(3).normal(size=(count, SIZE)).astype(np.float32)
    found = solve_factored(order, factorise(order, diagonal, beside), jnp.asarray(right))
    assert found.dtype == jnp.float32
    np.testing.assert_allclose(matrix @ np.asarray(found, float).ravel(), right.ravel(), atol=1e-3)
    assert not jnp.isfinite(factorise(order, -diagonal, beside).lower).all()
