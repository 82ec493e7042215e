"""Rotations: the nearest rotation of a 3x3 matrix with its derivative, a cheaper frame, unit quaternions.

The 3x3 algebra is written out on component arrays (a nested tuple `M[i][j]` of equal-shaped arrays): XLA turns that
into a few vectorised loops over elements, where a batched library SVD works through the matrices one call at a time.
What loops carry is stacked, one array (3, 3, ...): each array carried is a program of its own to compile and to call.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jaxfem.batching import cond_any, one_program
from jaxfem.tensors import array_of, bordered, jacobi

Components = tuple[tuple[Array, ...], ...]
Vector = tuple[Array, ...]

AXES = (0, 1, 2)
# Newton steps are not trusted below this det F / |F|^3: 0.19 for a rotation, a condition number of at most 38 above it.
ORDINARY = 0.01
TURNS = np.cross(np.eye(3)[:, None], np.eye(3)).swapaxes(1, 2)
"""(3, 3, 3): matrices of the cross products with the axes."""


@one_program
def nearest_rotation(F: Any) -> Array:
    """Nearest proper rotation of each matrix: argmax tr(R' F) over R with R' R = I, det R = +1.

    F (..., 3, 3), any scale -> R (..., 3, 3) of the same dtype. Flat and inverted F are fine. Where two signed singular
    values cancel, s2 + s3 = 0 (collapsed to a line, zero, inverted with a tie), the maximiser is not unique: one of
    them comes out, the identity for F = 0. A NaN or infinite entry makes that one matrix NaN and leaves the others.

    The derivative is the closed form dR = R skew(w), (tr(S) I - S) w = vex(R' dF - dF' R), S = R' F, in both modes
    and any order; it grows like 1 / (s2 + s3). Below about s2 + s3 = 32 eps max|F| the undefined spin is left out: w is
    then the (minimum norm) pseudo-inverse solution to about sqrt(eps), finite, and zero for F = 0.

    Newton steps for well-conditioned F (Higham 1986); if any matrix of the batch is near-singular or inverted, those
    matrices take the top eigenvector of Davenport's quaternion matrix (Davenport 1968, Horn 1987) by Jacobi
    rotations, with an error of about eps |F| / (s2 + s3). Derivative as in Papadopoulo & Lourakis 2000.
    """
    return _stack(polar_components(_components(F)))


@one_program
def polar_components(F: Sequence[Sequence[Array]]) -> Components:
    """The same as `nearest_rotation` on component arrays `F[i][j]` of one shape (a (3, 3, ...) array will do), as
    `R[i][j]`, for kernels that keep to them.
    """
    return _polar(_matrix(lambda i, j: F[i][j]))


@jax.custom_jvp
def _polar(F: Components) -> Components:
    F = _scaled(F, _scale(F))
    det, norm2 = _dot(F[0], _cross(F[1], F[2])), _square_sum(F)
    # NaN compares false: such a matrix stays in the fast branch, and stays NaN.
    bad = det <= ORDINARY * norm2 * jnp.sqrt(norm2)
    R = _newton(array_of(_matrix(lambda i, j: jnp.where(bad, float(i == j), F[i][j]))))
    R = cond_any(jnp.any(bad), lambda R: jnp.where(bad, _davenport(F), R), lambda R: R, R)
    return _matrix(lambda i, j: R[i, j])


@_polar.defjvp
def _polar_jvp(primals: tuple[Components], tangents: tuple[Components]) -> tuple[Components, Components]:
    (F,), (dF,) = primals, tangents
    R = _polar(F)
    return R, _turning(F, R, dF)


@jax.custom_jvp
def known_rotation(F: Components, R: Components) -> Components:
    """`R`, the nearest rotation of `F` as `polar_components` found it, with its derivatives in F, of any order.

    For kernels that are differentiated more than once: it is not looked for again.
    """
    return R


@known_rotation.defjvp
def _known_rotation_jvp(primals: tuple[Any, Any], tangents: tuple[Any, Any]) -> tuple[Components, Components]:
    (F, R), (dF, _) = primals, tangents
    R = known_rotation(F, R)
    return R, _turning(F, R, dF)


def _turning(F: Components, R: Components, dF: Components) -> Components:
    """dR of the nearest rotation R of F."""
    S, T = (_transpose_product(R, _scaled(m, _scale(F))) for m in (F, dF))
    # S = R'F is symmetric, R'dR = skew(w):  (tr(S) I - S) w = vex(R'dF - dF'R)
    b = (T[2][1] - T[1][2], T[0][2] - T[2][0], T[1][0] - T[0][1])
    w = _guarded_solve(_spin_matrix(S), b)  # dR = R skew(w), row by row:
    return _cross(R[0], w), _cross(R[1], w), _cross(R[2], w)


def _spin_matrix(S: Components) -> Components:
    # B = tr(S) I - sym(S); its eigenvalues are the sums of two singular values.
    xy, xz, yz = (-0.5 * (S[i][j] + S[j][i]) for i, j in ((0, 1), (0, 2), (1, 2)))
    return ((S[1][1] + S[2][2], xy, xz), (xy, S[0][0] + S[2][2], yz), (xz, yz, S[0][0] + S[1][1]))


def _guarded_solve(B: Components, b: Vector) -> Vector:
    # For positive definite B no pivot is below its smallest eigenvalue: away from the singular set nothing is damped.
    # (B + d)^-1 B (B + d)^-1 takes an eigenvalue 0 to 0 and a large one s to 1/s - 2 d / s^2.
    eps = jnp.finfo(B[0][0].dtype).eps
    (d0, d1, d2), _ = _factor(B)
    singular = jnp.minimum(jnp.minimum(d0, d1), d2) <= 32 * eps
    d = jnp.where(singular, eps**0.5, 0).astype(d0.dtype)
    damped = _matrix(lambda i, j: B[i][j] + d if i == j else B[i][j])
    first = _solve(damped, b)
    again = _solve(damped, tuple(_dot(row, first) for row in B))
    return _where(singular, again, first)


def _factor(B: Components) -> tuple[Vector, Vector]:
    # B = L D L' keeps full accuracy for a stiff B, where the adjugate would lose half the digits.
    floor = 32 * jnp.finfo(B[0][0].dtype).eps
    d0 = jnp.maximum(B[0][0], floor)
    l10, l20 = B[0][1] / d0, B[0][2] / d0
    d1 = jnp.maximum(B[1][1] - l10 * B[0][1], floor)
    c21 = B[1][2] - l20 * B[0][1]
    l21 = c21 / d1
    return (d0, d1, jnp.maximum(B[2][2] - l20 * B[0][2] - l21 * c21, floor)), (l10, l20, l21)


def _solve(B: Components, b: Vector) -> Vector:
    (d0, d1, d2), (l10, l20, l21) = _factor(B)
    y = b[1] - l10 * b[0]
    w2 = (b[2] - l20 * b[0] - l21 * y) / d2
    w1 = y / d1 - l21 * w2
    return b[0] / d0 - l10 * w1 - l20 * w2, w1, w2


def _newton(X: Array) -> Array:
    def step(_: Any, X: Array) -> Array:
        # X <- (g X + X^-T / g) / 2, X^-T = C / det X, g^2 = |X^-1| / |X|
        C = lax.optimization_barrier(array_of((_cross(X[1], X[2]), _cross(X[2], X[0]), _cross(X[0], X[1]))))
        det = _dot(X[0], C[0])
        g = jnp.sqrt(jnp.sqrt(_square_sum(C) / _square_sum(X)) / det)
        # The barriers keep XLA from working out C and the factors anew for each of nine entries.
        a, c = lax.optimization_barrier((0.5 * g, 0.5 / (g * det)))
        return jnp.add(a * X, c * C)

    # A loop, not six copies of the step: compiled in a fifth of the time and run twice as fast.
    R: Array = lax.fori_loop(0, 6 if X.dtype.itemsize > 4 else 5, step, X)
    return R


def _davenport(F: Components) -> Array:
    # tr(R(q)' F) = q' K q for unit q
    (a, b, c), (d, e, f), (g, h, i) = F
    wx, wy, wz, xy, xz, yz = h - f, c - g, d - b, b + d, c + g, f + h
    K = ((a + e + i, wx, wy, wz), (wx, a - e - i, xy, xz), (wy, xy, e - a - i, yz), (wz, xz, yz, i - a - e))
    A, V = jacobi(array_of(K))
    best = jnp.argmax(jnp.stack([A[j, j] for j in range(4)]), axis=0)
    q = functools.reduce(lambda q, j: jnp.where(best == j, V[j], q), range(1, 4), V[0])
    return jnp.moveaxis(quaternion_to_matrix(jnp.moveaxis(q, 0, -1)), (-2, -1), (0, 1))


@one_program
def rotation_gap(F: Any, R: Any) -> Array:
    """How well the rotation is determined: s2 + s3 >= 0, the smallest eigenvalue of tr(S) I - S, S = R' F.

    F, R (..., 3, 3) -> (...), in the units of F, to about eps |F|. Zero where the nearest rotation is not unique; the
    rotation's derivative is of size 1 / gap. Not differentiated (a flag, not a quantity). Higham 1986, theorem 4.2.
    """
    M, Q = jax.tree.map(lax.stop_gradient, (_components(F), _components(R)))
    scale = _scale(M)
    B = array_of(_spin_matrix(_transpose_product(Q, _scaled(M, scale))))
    A, _ = jacobi(bordered(B))
    return jnp.maximum(functools.reduce(jnp.minimum, [A[j, j] for j in range(4)]), 0) * scale


def gram_schmidt_rotation(F: Any) -> Array:
    """Rotation from the columns of F orthonormalised in order: cheaper than `nearest_rotation`, and biased to x.

    F (..., 3, 3), any scale -> R (..., 3, 3), always proper: the third axis is the cross product of the first two.
    A zero first column is replaced by x; a second one (numerically) along the first by an axis across it, the
    identity for F = 0; the derivative is zero in what is replaced. Mueller & Gross 2004; projected twice for accuracy.
    """
    return _stack(gram_schmidt_components(_components(F)))


def gram_schmidt_components(M: Sequence[Sequence[Array]]) -> Components:
    """The same as `gram_schmidt_rotation` on component arrays `M[i][j]` -> `R[i][j]`."""
    first = _unit(tuple(row[0] for row in M), (1.0, 0.0, 0.0))
    spare = _where(jnp.abs(first[1]) < 0.9, (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    across = _reject(_unit(tuple(row[1] for row in M), spare), first)
    along = _dot(across, across) < (64 * jnp.finfo(M[0][0].dtype).eps) ** 2
    second = _unit(_reject(_unit(_where(along, _reject(spare, first), across), spare), first), spare)
    return tuple(zip(first, second, _cross(first, second), strict=True))


def _reject(v: Vector, axis: Vector) -> Vector:
    along = _dot(v, axis)
    return tuple(a - along * b for a, b in zip(v, axis, strict=True))


def _unit(v: Vector, fallback: Any) -> Vector:
    # The scale is a constant to derivatives: a direction does not depend on it. It keeps squares from overflowing.
    size = lax.stop_gradient(jnp.maximum(jnp.maximum(jnp.abs(v[0]), jnp.abs(v[1])), jnp.abs(v[2])))
    zero = size < jnp.finfo(size.dtype).tiny
    v = _where(zero, fallback, tuple(u / jnp.where(zero, 1, size) for u in v))
    norm = jnp.sqrt(_dot(v, v))
    return tuple(u / norm for u in v)


@one_program
def quaternion_to_matrix(q: Any) -> Array:
    """Rotation matrix of a quaternion, scalar first: (..., 4) -> (..., 3, 3).

    The length is divided out, so a slightly drifted q gives a proper rotation; the zero quaternion gives the identity.
    """
    q = jnp.asarray(q)
    w, v, n = q[..., 0, None, None], q[..., 1:, None], jnp.sum(q * q, -1)[..., None, None]
    s = 2 / jnp.where(n == 0, 1, n)
    unit, turns = jnp.eye(3, dtype=q.dtype), jnp.asarray(TURNS, q.dtype)
    across = sum((turns[k] * v[..., k : k + 1, :] for k in (1, 2)), start=turns[0] * v[..., :1, :])
    R: Array = (1 - s * jnp.sum(v * v, -2, keepdims=True)) * unit + s * (v * jnp.swapaxes(v, -1, -2) + w * across)
    return R


@one_program
def quaternion_multiply(p: Any, q: Any) -> Array:
    """Hamilton product, scalar first: (..., 4), (..., 4) -> (..., 4). As matrices: first q, then p."""
    p, q = jnp.asarray(p), jnp.asarray(q)
    (a, *u), (w, *v) = ([m[..., i] for i in range(4)] for m in (p, q))
    across = _cross(u, v)
    return jnp.stack((a * w - _dot(u, v), *(a * v[i] + w * u[i] + across[i] for i in AXES)), axis=-1)


@one_program
def quaternion_from_rotation_vector(v: Any) -> Array:
    """Unit quaternion, scalar first, of a rotation by |v| rad about v: (..., 3) -> (..., 4); smooth at v = 0."""
    v = jnp.asarray(v)
    v = v.astype(jnp.result_type(v, float))
    t2 = jnp.sum(v * v, axis=-1)
    small = t2 < 0.01
    t = jnp.sqrt(jnp.where(small, 1, t2))
    # cos(t/2) and sin(t/2)/t, by their series in t^2 where a root of t^2 would have no derivative
    t2 = jnp.where(small, t2, 0)
    cos = 1 - t2 / 8 * (1 - t2 / 48 * (1 - t2 / 120 * (1 - t2 / 224)))
    sinc = 0.5 * (1 - t2 / 24 * (1 - t2 / 80 * (1 - t2 / 168 * (1 - t2 / 288))))
    cos, sinc = jnp.where(small, cos, jnp.cos(t / 2)), jnp.where(small, sinc, jnp.sin(t / 2) / t)
    return jnp.concatenate((cos[..., None], sinc[..., None] * v), axis=-1)


def rotation_vector_to_matrix(v: Any) -> Array:
    """Rotation matrix of a rotation by |v| rad about v: (..., 3) -> (..., 3, 3); smooth at v = 0."""
    return quaternion_to_matrix(quaternion_from_rotation_vector(v))


def _components(F: Any) -> Components:
    F = jnp.asarray(F)
    F = F.astype(jnp.result_type(F, float))
    # A split, not nine slices: its transpose is one concatenation where that of slices is nine padded arrays to add.
    m = [m[..., 0] for m in lax.split(F.reshape(*F.shape[:-2], 9), (1,) * 9, F.ndim - 2)]
    return tuple(m[:3]), tuple(m[3:6]), tuple(m[6:])


def _stack(M: Components) -> Array:
    return jnp.stack([m for row in M for m in row], axis=-1).reshape(*M[0][0].shape, 3, 3)


def _scale(F: Components) -> Array:
    # A constant to derivatives (the rotation does not depend on it); 1 for a zero or subnormal matrix.
    largest = functools.reduce(jnp.maximum, [jnp.abs(m) for row in F for m in row])
    return lax.stop_gradient(jnp.where(largest < jnp.finfo(largest.dtype).tiny, 1, largest))


def _scaled(F: Components, scale: Array) -> Components:
    return _matrix(lambda i, j: F[i][j] / scale)


def _matrix(entry: Callable[[int, int], Array]) -> Components:
    return tuple(tuple(entry(i, j) for j in AXES) for i in AXES)


def _where(flag: Any, yes: Any, no: Any) -> Vector:
    return tuple(jnp.where(flag, u, v) for u, v in zip(yes, no, strict=True))


def _transpose_product(A: Components, B: Components) -> Components:
    return _matrix(lambda i, j: A[0][i] * B[0][j] + A[1][i] * B[1][j] + A[2][i] * B[2][j])


def _square_sum(X: Any) -> Array:
    return _dot(X[0], X[0]) + _dot(X[1], X[1]) + _dot(X[2], X[2])


def _dot(u: Sequence[Array] | Array, v: Sequence[Array] | Array) -> Array:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def _cross(u: Sequence[Array] | Array, v: Sequence[Array] | Array) -> Vector:
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
