"""Matrices assembled on the nodes from element blocks: 3x3 blocks, each node's in one padded row."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.bodies.elements import Elements, deformation_gradient
from jaxfem.bodies.material import lame
from jaxfem.model import Pattern
from jaxfem.pytrees import pytree
from jaxfem.rows.elastic import ElasticRows
from jaxfem.tensors import array_of, guarded_inverse, matrix_of, product, symmetric, transposed

Array = jax.Array

UPPER = tuple((a, b) for a in range(4) for b in range(4) if a < b)
PAIRS = UPPER + tuple((b, a) for a, b in UPPER)


@pytree
class BlockMatrix:
    """Symmetric matrix of 3x3 blocks: `blocks` (n, 3, 3 width) beside `neighbours` (n, width), itself in slot 0."""

    blocks: Array
    neighbours: Array

    def apply(self, vector: Array) -> Array:
        """Matrix times (n, 3). One small dense product a node: the form that XLA runs fastest on a CPU."""
        gathered = vector[self.neighbours].reshape(self.blocks.shape[0], self.blocks.shape[2])
        return jnp.einsum("nik,nk->ni", self.blocks, gathered)

    @property
    def diagonal_blocks(self) -> Array:
        """(n, 3, 3)."""
        return self.blocks[:, :, :3]


def sparsity(points: np.ndarray, cells: np.ndarray, groups: list[np.ndarray], dtype: Any) -> Pattern:
    """Solver order, padded neighbour lists and the slot of each element block; host side.

    `groups` partition the nodes. Padding rows and padding neighbours point to the node itself.
    """
    size = max(len(g) for g in groups)
    padded = len(groups) * size
    order, real = np.zeros(padded, np.int64), np.zeros(padded)
    for number, group in enumerate(groups):
        order[number * size : number * size + len(group)] = group
        real[number * size : number * size + len(group)] = 1
    place = np.zeros(len(points), np.int64)
    place[order[real > 0]] = np.flatnonzero(real)
    neighbours, slots = _padded_rows(place[cells], padded)
    return Pattern(
        jnp.asarray(neighbours, jnp.int32),
        jnp.asarray(slots, jnp.int32),
        jnp.asarray(order, jnp.int32),
        jnp.asarray(place, jnp.int32),
        jnp.asarray(real, dtype),
        jnp.asarray(_frame_elements(points, cells, groups), jnp.int32),
    )


def _padded_rows(cells: np.ndarray, nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Neighbours (nodes, width), the node itself first, and the slots (12, E) of element blocks."""
    pairs = np.array(PAIRS)
    rows, columns = cells[:, pairs[:, 0]].T.ravel(), cells[:, pairs[:, 1]].T.ravel()
    keys, where = np.unique(rows.astype(np.int64) * nodes + columns, return_inverse=True)
    key_rows, key_columns = keys // nodes, keys % nodes
    position = np.arange(len(keys)) - np.searchsorted(key_rows, key_rows) + 1  # slot 0 is the diagonal
    width = int(position.max(initial=0)) + 1
    neighbours = np.tile(np.arange(nodes)[:, None], (1, width))
    neighbours[key_rows, position] = key_columns
    return neighbours, (key_rows * width + position)[where].reshape(len(PAIRS), len(cells))


def _frame_elements(points: np.ndarray, cells: np.ndarray, groups: list[np.ndarray]) -> np.ndarray:
    """The element nearest each group's centre among those that touch it, (groups,)."""
    group_of = np.zeros(len(points), np.int64)
    for number, group in enumerate(groups):
        group_of[group] = number
    middles = np.stack([points[group].mean(0) for group in groups])
    owners = group_of[cells].ravel()
    distances = np.sum((np.repeat(points[cells].mean(1), 4, axis=0) - middles[owners]) ** 2, axis=1)
    nearest = np.lexsort((distances, owners))
    _, first = np.unique(owners[nearest], return_index=True)
    return nearest[first] // 4


def assemble(blocks: Array, diagonal: Array, free: Array, pattern: Pattern) -> BlockMatrix:
    """Element blocks (12, E, 9) in `PAIRS` order and a `diagonal` (n,) summed into one matrix; `free` (n,) 1 or 0.

    `diagonal` and `free` in the user's order; the matrix is in solver order, identity on padding. Rows and columns of
    fixed nodes keep only their diagonal. Rigid translations cost nothing, so an element's diagonal
    blocks are minus the sum of their row.
    """
    nodes, width = pattern.neighbours.shape
    diagonal = pattern.gathered(diagonal) + (1 - pattern.real)
    free = pattern.gathered(free)
    flat = jnp.zeros((nodes * width, 9), blocks.dtype).at[pattern.slots.reshape(-1)].add(blocks.reshape(-1, 9))
    stiffness = flat.reshape(nodes, width, 3, 3)
    identity = jnp.eye(3, dtype=blocks.dtype)
    own = -stiffness.sum(1) * free[:, None, None] + diagonal[:, None, None] * identity
    coupled = free[:, None] * free[pattern.neighbours]
    matrix = (stiffness * coupled[:, :, None, None]).at[:, 0].set(own)
    return BlockMatrix(matrix.transpose(0, 2, 1, 3).reshape(nodes, 3, 3 * width), pattern.neighbours)


def row_blocks(rows: ElasticRows) -> Array:
    """J' C^-1 J of elastic rows, as element blocks (12, E, 9).

    A row's stiffness w = 1/C splits into w_v (volumetric) and w_d (deviatoric); with r_a = R grad N_a the block is
        K_ab = (w_v - w_d)/3 r_a r_b' + w_d/2 (r_b r_a' + (r_a . r_b) I).
    """
    volumetric, deviatoric = 1 / rows.compliance[0], 1 / rows.compliance[1]
    a, b = _rotated_pairs(rows.elements, rows.rotation)
    return _both_halves(_warped_blocks((volumetric - deviatoric) / 3, deviatoric / 2, a, b))


def tangent_blocks(
    elements: Elements, positions: Array, rotation: Array, young: Array, poisson: Array, exact: bool = True
) -> Array:
    """Hessian of the corotated energy at `positions` (n, 3), its nearest rotations `rotation` (3, 3, E): (12, E, 9).

    The exact one may be indefinite; otherwise rotations are held (stiffness warping), which is positive semi-definite.

    From P = R (2 mu (S - I) + lambda tr(S - I) I), S = R'F, and R'dR = skew(B^-1 2 vex(R'dF)), B = tr(S) I - S:
        K_ab = V ( 2 mu (r_a . r_b) I + lambda r_a r_b' + (2 mu - lambda tr(S - I)) skew(r_a) R B^-1 R' skew(r_b) ).
    """
    first, second = (v * elements.volumes for v in lame(young, poisson))
    a, b = _rotated_pairs(elements, rotation)
    if not exact:
        return _both_halves(_warped_blocks(first, second, a, b))
    turns = matrix_of(rotation)
    stretch = symmetric(product(transposed(turns), deformation_gradient(elements, positions)))
    trace = stretch[0][0] + stretch[1][1] + stretch[2][2]
    spin = 2 * second - first * (trace - 3)
    turn = [[(trace if i == j else 0.0) - stretch[i][j] for j in range(3)] for i in range(3)]
    inverse = array_of(product(product(turns, guarded_inverse(turn)), transposed(turns)))
    # skew(a) W skew(b): rows of W crossed with b, then a crossed with the columns.
    right = jnp.cross((spin * inverse)[None], b[:, None], axis=2)
    geometric = jnp.cross(a[:, :, None], right, axis=1)
    return _both_halves(first * _outer(a, b) + geometric + _dot_identity(2 * second, a, b))


def _rotated_pairs(elements: Elements, rotation: Array) -> tuple[Array, Array]:
    """R grad N of the first and of the second corner of each pair in `UPPER`: (6, 3, E) each."""
    g = elements.gradients
    rotated = sum((rotation[None, :, k] * g[:, None, k] for k in (1, 2)), start=rotation[None, :, 0] * g[:, None, 0])
    first, second = np.array(UPPER).T
    return rotated[first], rotated[second]


def _outer(a: Array, b: Array) -> Array:
    return a[:, :, None] * b[:, None]


def _dot_identity(weight: Array, a: Array, b: Array) -> Array:
    identity = jnp.eye(3, dtype=a.dtype)[:, :, None]
    return (weight * jnp.sum(a * b, axis=1))[:, None, None] * identity


def _warped_blocks(first: Array, second: Array, a: Array, b: Array) -> Array:
    """first a b' + second (b a' + (a . b) I), (6, 3, 3, E)."""
    return first * _outer(a, b) + second * _outer(b, a) + _dot_identity(second, a, b)


def _both_halves(upper: Array) -> Array:
    """Blocks (12, E, 9) in `PAIRS` order from those of `UPPER`, (6, 3, 3, E): K_ba = K_ab'."""
    both = jnp.concatenate([upper, upper.swapaxes(1, 2)])
    return both.transpose(0, 3, 1, 2).reshape(len(PAIRS), -1, 9)
