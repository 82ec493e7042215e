"""Conjugate gradients of all lanes in one loop, preconditioned by the modes at rest that they share."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.pytrees import Pytree
from jaxfem.sweeping.lanes.body import Body
from jaxfem.sweeping.lanes.kernels import AXES
from jaxfem.tensors import matmul

Array = jax.Array
Linear = Callable[[Array], Array]


class Outcome(Pytree):
    """How a solve went, (lanes,) each: `iterations`, relative `residual`, whether it `converged`, and whether its
    numbers were `finite`."""

    iterations: Array
    residual: Array
    converged: Array
    finite: Array


def norm(u: Array) -> Array:
    """Of each lane, (lanes,)."""
    return jnp.sqrt((u * u).sum((0, 1)))


def modal(body: Body, r: Array, scale: Array, density: Array) -> Linear:
    """x -> Q V (rho + scale Lambda)^-1 V' Q' x of all lanes: at rest the inverse itself, for each lane's stiffness,
    density and damping (`scale`, `density`: (lanes,), relative to those of the modes).

    V and Lambda are shared: two large matrix products, in single precision, which is enough to precondition with and a
    third of the time. Q: the mean rotation of some elements around each node.
    """
    q = body.fence(lambda: sum(r[body.around[:, k]] for k in range(body.around.shape[1])) / body.around.shape[1])
    whole = body.density * (density + scale * body.frequencies)
    weight = body.fence(lambda: (1 / whole).astype(body.shapes.dtype))

    def apply(x: Array) -> Array:
        turned = body.fence(lambda: jnp.asarray(sum(q[:, i] * x[:, i, None] for i in AXES), weight.dtype))
        inside = weight * matmul(body.shapes.T, turned.reshape(len(body.shapes), -1))
        back = matmul(body.shapes, inside).reshape(x.shape)
        found: Array = body.fence(lambda: sum(q[:, :, j] * back[:, j, None].astype(x.dtype) for j in AXES))
        return found

    return apply


def solve(
    matrix: Linear, precondition: Linear, b: Array, target: Array, asked: Array, limit: Array
) -> tuple[Array, Outcome]:
    """(x, outcome), until the last of the lanes `asked` (lanes,) has a residual below `target` (lanes,).

    Those that have stand still. Each lane's numbers are its own: one that is not finite ends, and is not converged.
    """

    def trip(state: Any) -> Any:
        x, r, p, rz, active, k = state
        q = matrix(p)
        alpha = jnp.where(active, rz / (p * q).sum((0, 1)), 0)
        x, r = x + alpha * p, r - alpha * q
        z = precondition(r)
        following = (r * z).sum((0, 1))
        beta = jnp.where(active, following / rz, 0)
        still = active & (norm(r) > target)
        return x, r, z + beta * p, jnp.where(active, following, rz), still, k + active

    z, size = precondition(b), norm(b)
    start = jnp.zeros_like(b), b, z, (b * z).sum((0, 1)), asked & (size > target), jnp.zeros(b.shape[-1], jnp.int32)
    x, r, _, _, active, k = jax.lax.while_loop(lambda s: s[4].any() & (s[5].max() < limit), trip, start)
    left = norm(r)
    good = (left <= target) & ~active
    return x, Outcome(k, jnp.where(size > 0, left / jnp.where(size > 0, size, 1), 0), good, jnp.isfinite(size + target))


SINGLE = jnp.float32
DIGITS = 1e-4
"""To which share of a residual a correction in single precision is found."""
NEARER = 0.7
"""Of the target: to what the last correction is found, since it is in single precision."""
HELPS = 0.1
"""To which share of the last residual a correction must lead for another to follow."""


def refined(
    matrix: Linear,
    precondition: Linear,
    single: tuple[Linear, Linear],
    b: Array,
    target: Array,
    asked: Array,
    limit: Array,
) -> tuple[Array, Outcome]:
    """As `solve`, in double precision: residuals in double, corrections by `single`, (matrix, precondition) of which
    each trip takes half the time; in double too where they do not lead on (Wilkinson 1963; Moler 1967)."""

    def trip(state: Any) -> Any:
        x, r, before, going, k = state
        size = jnp.abs(r).max((0, 1))
        size = jnp.where(size > 0, size, 1)
        wanted = jnp.maximum(NEARER * target, DIGITS * before) / size
        found, how = solve(*single, (r / size).astype(SINGLE), wanted.astype(SINGLE), going, limit)
        following = x + jnp.where(going, size * found.astype(x.dtype), 0)
        rest = b - matrix(following)
        left = norm(rest)
        better = going & (left < before)
        x, r = jnp.where(better, following, x), jnp.where(better, rest, r)
        on = better & (left > target) & (left < HELPS * before)
        return x, r, jnp.where(better, left, before), on, k + how.iterations

    size = norm(b)
    start = jnp.zeros_like(b), b, size, asked & (size > target), jnp.zeros(b.shape[-1], jnp.int32)
    x, r, left, _, k = jax.lax.while_loop(lambda s: s[3].any() & (s[4].max() < limit), trip, start)
    missing = asked & ~(left <= target)

    def on() -> Any:
        more, how = solve(matrix, precondition, r, target, missing, limit)
        return x + more, how.residual * left, k + how.iterations

    x, left, k = jax.lax.cond(missing.any(), on, lambda: (x, left, k))
    good, whole = left <= target, jnp.where(size > 0, size, 1)
    return x, Outcome(k, left / whole, good, jnp.isfinite(size + target))
