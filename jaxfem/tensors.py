"""Small tensors: the constant eigenbasis of isotropic elasticity, and 3x3 algebra written out in components.

XLA turns batched 3x3 matrix products into calls or loops of gathers; the same algebra on nine arrays of length E fuses
into one pass. So kernels hold a matrix as `Matrix3`: three rows of three arrays, each of shape (E,).
"""

import math
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.indexing import gather

Array = jax.Array
Vector3 = Sequence[Array] | Array
Matrix3 = Sequence[Sequence[Array]]

_AXES = range(3)


def _eigenbasis() -> np.ndarray:
    """Orthonormal symmetric matrices: one volumetric, five deviatoric (Kelvin 1856; Mehrabadi & Cowin 1990)."""
    basis = np.zeros((6, 3, 3))
    basis[0] = np.eye(3) / np.sqrt(3)
    basis[1] = np.diag([1, -1, 0]) / np.sqrt(2)
    basis[2] = np.diag([1, 1, -2]) / np.sqrt(6)
    for row, (i, j) in zip((3, 4, 5), ((1, 2), (0, 2), (0, 1)), strict=True):
        basis[row, i, j] = basis[row, j, i] = 1 / np.sqrt(2)
    return basis


EIGENBASIS = _eigenbasis()
"""(6, 3, 3): row 0 volumetric (stiffness 3K), rows 1 to 5 deviatoric (stiffness 2 mu)."""


def skew(vector: Array) -> Array:
    """Matrix of the cross product, (..., 3) -> (..., 3, 3)."""
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    zero = jnp.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return jnp.stack([jnp.stack(row, -1) for row in rows], -2)


EXACT = jax.lax.Precision.HIGHEST


def contract(subscripts: str, *operands: Array) -> Array:
    """`jnp.einsum` in all digits: accelerators otherwise take ten bits of single precision, and joints open by that.

    Axes of one name are of one size: none of size 1 is repeated.
    """
    if len(operands) == 2 and (pair := _pair(subscripts)) is not None:
        left, right = operands if pair.in_order else operands[::-1]
        found = jax.lax.dot_general(left, right, pair.dimensions, precision=EXACT)
        return found if pair.order is None else jax.lax.transpose(found, pair.order)
    return jnp.einsum(subscripts, *operands, precision=EXACT)


class _Pair(NamedTuple):
    """A product of two tensors as one `dot_general`: of them in the order given or the other, its axes then sorted."""

    in_order: bool
    dimensions: tuple[tuple[tuple[int, ...], tuple[int, ...]], tuple[tuple[int, ...], tuple[int, ...]]]
    order: tuple[int, ...] | None


@cache
def _pair(subscripts: str) -> _Pair | None:
    """What `jnp.einsum` would come to, which looks for it at each use, in ten times as long; None where that is more
    than a product: sums of one tensor's axes, its diagonals, ellipses."""
    inputs, result = subscripts.split("->")
    first, second = inputs.split(",")
    both = set(first) & set(second)
    over = sorted(both - set(result))
    repeated = any(len(set(names)) < len(names) for names in (first, second))
    if "." in subscripts or repeated or {*first, *second} != {*result, *over}:
        return None
    shared = "".join(name for name in result if name in both)
    own = ["".join(name for name in names if name not in both) for names in (first, second)]

    def of(names: str) -> tuple[tuple[int, ...], tuple[int, ...]]:
        return tuple(map(names.index, over)), tuple(map(names.index, shared))

    (left, at_left), (right, at_right) = of(first), of(second)
    if shared + own[0] + own[1] == result:
        return _Pair(True, ((left, right), (at_left, at_right)), None)
    found = shared + own[1] + own[0]
    order = None if found == result else tuple(map(found.index, result))
    return _Pair(False, ((right, left), (at_right, at_left)), order)


def matmul(a: Array, b: Array) -> Array:
    """`a @ b` in all digits, as `contract`."""
    return jnp.matmul(a, b, precision=EXACT)


def inner(a: Array, b: Array) -> Array:
    """`jnp.vdot` in all digits, as `contract`."""
    return jnp.vdot(a, b, precision=EXACT)


def taken(field: Array, index: Array) -> Array:
    """field[index] with what is taken side by side: (n, 3) and (..., k) -> (..., 3 k).

    Number by number: XLA takes rows of three one after another, at twice the time on a CPU.
    """
    flat = 3 * index[..., None] + jnp.arange(3, dtype=index.dtype)
    return gather(field.reshape(-1), flat.reshape(*index.shape[:-1], 3 * index.shape[-1]))


def matrix_of(array: Array) -> Matrix3:
    """Components of an array of shape (3, 3, ...)."""
    return [[array[i, j] for j in _AXES] for i in _AXES]


def array_of(matrix: Matrix3) -> Array:
    """Array of shape (3, 3, ...) from components."""
    return jnp.stack([jnp.stack(list(row)) for row in matrix])


def transposed(a: Matrix3) -> Matrix3:
    """A'."""
    return [[a[j][i] for j in _AXES] for i in _AXES]


def product(a: Matrix3, b: Matrix3) -> Matrix3:
    """A B."""
    return [[a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j] for j in _AXES] for i in _AXES]


def times(a: Matrix3, v: Vector3) -> list[Array]:
    """A v."""
    return [a[i][0] * v[0] + a[i][1] * v[1] + a[i][2] * v[2] for i in _AXES]


def symmetric(a: Matrix3) -> Matrix3:
    """(A + A') / 2."""
    return [[a[i][i] if i == j else 0.5 * (a[i][j] + a[j][i]) for j in _AXES] for i in _AXES]


def determinant(a: Matrix3) -> Array:
    """det A."""
    return (
        a[0][0] * (a[1][1] * a[2][2] - a[1][2] * a[2][1])
        - a[0][1] * (a[1][0] * a[2][2] - a[1][2] * a[2][0])
        + a[0][2] * (a[1][0] * a[2][1] - a[1][1] * a[2][0])
    )


def cross_matrix(v: Vector3 | Array) -> Matrix3:
    """skew(v) as components: cross_matrix(v) u = v x u."""
    zero = jnp.zeros_like(v[0])
    return [[zero, -v[2], v[1]], [v[2], zero, -v[0]], [-v[1], v[0], zero]]


def guarded_inverse(a: Matrix3) -> Matrix3:
    """Inverse of a symmetric matrix; where it is singular to rounding the determinant is kept away from zero."""
    cofactors = [
        [
            a[(i + 1) % 3][(j + 1) % 3] * a[(i + 2) % 3][(j + 2) % 3]
            - a[(i + 1) % 3][(j + 2) % 3] * a[(i + 2) % 3][(j + 1) % 3]
            for j in _AXES
        ]
        for i in _AXES
    ]
    det = a[0][0] * cofactors[0][0] + a[0][1] * cofactors[0][1] + a[0][2] * cofactors[0][2]
    size = jnp.abs(a[0][0]) + jnp.abs(a[1][1]) + jnp.abs(a[2][2])
    least = jnp.finfo(det.dtype).eps * size**3 + jnp.finfo(det.dtype).tiny
    safe = jnp.where(jnp.abs(det) > least, det, jnp.where(det < 0, -least, least))
    return [[cofactors[j][i] / safe for j in _AXES] for i in _AXES]


def inverse_blocks(blocks: Array) -> Array:
    """Inverses of 3x3 blocks (n, 3, 3), by cofactors."""
    rows = [blocks[:, i] for i in range(3)]
    cofactors = [jnp.cross(rows[(i + 1) % 3], rows[(i + 2) % 3]) for i in range(3)]
    determinant = jnp.sum(rows[0] * cofactors[0], -1)
    return jnp.stack(cofactors, -1) / determinant[:, None, None]


def to_eigenbasis(s: Matrix3) -> list[Array]:
    """Six coefficients of a symmetric matrix in `EIGENBASIS`: its scalar product with each basis matrix."""
    root2, root3, root6 = math.sqrt(2.0), math.sqrt(3.0), math.sqrt(6.0)  # Python floats: they promote nothing
    return [
        (s[0][0] + s[1][1] + s[2][2]) * (1 / root3),
        (s[0][0] - s[1][1]) * (1 / root2),
        (s[0][0] + s[1][1] - 2 * s[2][2]) * (1 / root6),
        s[1][2] * root2,
        s[0][2] * root2,
        s[0][1] * root2,
    ]


def from_eigenbasis(c: Sequence[Array]) -> Matrix3:
    """Symmetric matrix with the six coefficients `c` in `EIGENBASIS`; the transpose of `to_eigenbasis`."""
    root2, root3, root6 = math.sqrt(2.0), math.sqrt(3.0), math.sqrt(6.0)  # Python floats: they promote nothing
    mean = c[0] * (1 / root3)
    first, second = c[1] * (1 / root2), c[2] * (1 / root6)
    yz, xz, xy = c[3] * (1 / root2), c[4] * (1 / root2), c[5] * (1 / root2)
    return [
        [mean + second + first, xy, xz],
        [xy, mean + second - first, yz],
        [xz, yz, mean - 2 * second],
    ]


def jacobi(A: Array) -> tuple[Array, Array]:
    """Cyclic Jacobi on symmetric A (4, 4, ...): (nearly diagonal, with its eigenvectors as rows)."""

    def visit(_: Any, state: Any) -> Any:
        # Always the pairs (0, 1) and (2, 3), renumbered after: a third of the code of a whole sweep to compile.
        # t = tan of the smaller angle that makes the entry beside the diagonal zero
        A, V = state
        off, d = jnp.stack((A[0, 1], A[2, 3])), jnp.stack((A[1, 1] - A[0, 0], A[3, 3] - A[2, 2]))
        r = jnp.sqrt(d * d + 4 * off * off)
        den = d + jnp.where(d >= 0, r, -r)
        t = 2 * off / jnp.where(den == 0, 1, den)
        c = 1 / jnp.sqrt(t * t + 1)
        c, s = c[:, None], (t * c)[:, None]

        def turned(M: Array) -> Array:
            first, second = c * M[0::2] - s * M[1::2], s * M[0::2] + c * M[1::2]
            return jnp.stack((first[0], first[1], second[1], second[0]))

        return turned(jnp.swapaxes(turned(A), 0, 1)), turned(V)

    V = jnp.broadcast_to(jnp.eye(4, dtype=A.dtype).reshape(4, 4, *(1,) * (A.ndim - 2)), A.shape)
    found: tuple[Array, Array] = jax.lax.fori_loop(0, 3 * (6 if A.dtype.itemsize > 4 else 5), visit, (A, V))
    return found


def bordered(S: Array) -> Array:
    """(3, 3, ...) -> (4, 4, ...) for `jacobi`: a fourth direction by itself, with a number between the eigenvalues."""
    return jnp.pad(S, ((0, 1), (0, 1), *((0, 0),) * (S.ndim - 2))).at[3, 3].set(S[0, 0])


def symmetric_eigenpairs(S: Array) -> tuple[Array, Array]:
    """Eigenvalues (3, ...), in no order, and eigenvectors as rows (3, 3, ...) of symmetric S (3, 3, ...).

    The rows are a proper rotation.
    """
    A, V = jacobi(bordered(S))
    # The fourth direction stays exact: in whatever place it ended, it is left out.
    fourth = jnp.argmax(jnp.abs(V[:, 3]), axis=0)
    kept = [jnp.where(fourth <= k, k + 1, k) for k in _AXES]

    def taken_out(values: Array) -> Array:
        return jnp.stack([jnp.take_along_axis(values, k[None], axis=0)[0] for k in kept])

    rows = jnp.stack([taken_out(V[:, k]) for k in _AXES], axis=1)
    sign = jnp.sign(determinant(matrix_of(rows)))
    return taken_out(jnp.stack([A[k, k] for k in range(4)])), rows * sign
