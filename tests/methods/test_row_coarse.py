"""The coarse space with rows in it: what a dense matrix gives, symmetric, and worth its while between bodies."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.methods.nodes.row_coarse import coarse_space
from jaxfem.methods.nodes.row_stiffness import RowStiffness
from jaxfem.rows.points import PointRows

RNG = np.random.default_rng(8)
GROUPS, SIZE, BODIES = 3, 4, 2
NODES = GROUPS * SIZE
ALL = NODES + 2 * BODIES


def parts():
    """A space of three groups and two rigid bodies, rows over three triples each, and both as dense matrices."""
    modes = RNG.normal(size=(GROUPS, 3 * SIZE, 6))
    square = RNG.normal(size=(6 * GROUPS, 6 * GROUPS))
    bare = square @ square.T + np.eye(6 * GROUPS)
    blocks = np.stack([np.diag(RNG.uniform(1, 2, 3)) for _ in range(2 * BODIES)])
    space = coarse_space(*map(jnp.asarray, (modes, bare, blocks)))

    basis = np.zeros((3 * ALL, 6 * (GROUPS + BODIES)))
    for group in range(GROUPS):
        rows = slice(3 * SIZE * group, 3 * SIZE * (group + 1))
        basis[rows, 6 * group : 6 * (group + 1)] = modes[group]
    for body in range(BODIES):
        for kind in range(2):  # linear triples first, then angular ones
            row, column = 3 * (NODES + kind * BODIES + body), 6 * (GROUPS + body) + 3 * kind
            basis[row : row + 3, column : column + 3] = np.eye(3)
    whole = np.zeros((6 * (GROUPS + BODIES),) * 2)
    whole[: 6 * GROUPS, : 6 * GROUPS] = bare
    for body in range(BODIES):
        for kind in range(2):
            at = slice(6 * (GROUPS + body) + 3 * kind, 6 * (GROUPS + body) + 3 * kind + 3)
            whole[at, at] = blocks[kind * BODIES + body]

    triples = np.stack([RNG.choice(ALL, 3, replace=False) for _ in range(7)])
    triples[:4, 2] = NODES + np.arange(4)
    jacobian, stiffness = RNG.normal(size=(7, 2, 9)), RNG.uniform(0, 5, (7, 2))
    empty = jnp.zeros((7, 2))
    rows = PointRows(jnp.asarray(triples), jnp.asarray(jacobian), empty, empty, unknowns=ALL)
    dense = np.zeros((7, 2, ALL, 3))
    for m in range(7):
        for k in range(3):
            dense[m, :, triples[m, k]] += jacobian[m, :, 3 * k : 3 * k + 3]
    dense = dense.reshape(14, 3 * ALL)
    added = basis.T @ dense.T @ np.diag(stiffness.ravel()) @ dense @ basis
    return space, RowStiffness(rows, jnp.asarray(stiffness)), basis, whole + added


def test_inverse_is_that_of_the_dense_matrix():
    space, kind, _, expected = parts()
    np.testing.assert_allclose(space.inverse((kind,)) @ expected, np.eye(len(expected)), atol=1e-9)


def test_correction_is_that_of_the_dense_basis_and_symmetric():
    space, kind, basis, matrix = parts()
    inverse = space.inverse((kind,))
    u, v = jnp.asarray(RNG.normal(size=(2, ALL, 3)))
    found = space.correction(inverse, u)
    np.testing.assert_allclose(found.ravel(), basis @ np.linalg.solve(matrix, basis.T @ u.ravel()), atol=1e-9)
    np.testing.assert_allclose(jnp.vdot(v, found), jnp.vdot(space.correction(inverse, v), u), rtol=1e-9)


@pytest.mark.slow
def test_a_pile_of_stiff_blocks_takes_few_iterations():
    """Rigid motions of stiff blocks that rest on each other: 1000 to 10,000 iterations without the rows in it."""
    blocks = [
        jf.SoftBody(jf.mesh.box((0.1, 0.1, 0.1), 2, origin=(0.01 * k, 0.007 * k, 0.1 * k)), 1e7, 0.3, 1000.0)
        for k in range(3)
    ]
    ground = jf.Contact(blocks[0], jf.Plane())
    scene = jf.Scene(blocks, contacts=[ground, *(jf.Contact(b, a) for a, b in itertools.pairwise(blocks))])
    model, params, state = jf.build(scene, tolerance=1e-6)
    assert model.method.name == "condensed"
    _, info = jf.rollout(model, params, state, 1 / 60, 10)
    assert not info.status.any()
    assert int(jnp.median(info.iterations)) < 300
