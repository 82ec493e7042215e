"""Kernels with lanes last: gradients, rotations, sums over nodes; what is 3 x 3 is written out along axes 1 and 2."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.rotation import ORDINARY, polar_components
from jaxfem.sweeping.lanes.body import Body

Array = jax.Array
AXES = range(3)
CYCLES = ((1, 2), (2, 0), (0, 1))
ROW = 8  # corners summed in one pass


def pairing(body: Body, field: Array, vectors: Array) -> Array:
    """Sum over corners of field_a (x) vector_a in each element, from differences to corner 0: (E, 3, 3, lanes)."""
    x = body.fence(lambda: field[body.corners])
    found: Array = body.fence(lambda: sum((x[:, a] - x[:, 0])[:, :, None] * vectors[:, a, None] for a in (1, 2, 3)))
    return found


def product(body: Body, a: Array, b: Array) -> Array:
    """Matrix products."""
    found: Array = body.fence(lambda: sum(a[:, :, k, None] * b[:, k, None] for k in AXES))
    return found


def rotation(body: Body, f: Array) -> tuple[Array, Array]:
    """Nearest rotations of F (E, 3, 3, lanes), and how many elements of each lane are inside out.

    F U^-1 from the invariants of C = F'F: tr U by Newton's method, U^-1 by Cayley-Hamilton (Hoger & Carlson 1984): few
    numbers are stored and much is done for each, which XLA compiles well. Where an element is flat or inverted, all are
    found again as elsewhere in the package, and those that are so get that rotation.
    """
    c = product(body, f.swapaxes(1, 2), f)
    first = body.fence(lambda: c[:, 0, 0] + c[:, 1, 1] + c[:, 2, 2])
    minors = ((0, 1), (1, 2), (0, 2))
    second = body.fence(lambda: sum(c[:, k, k] * c[:, m, m] - c[:, k, m] ** 2 for k, m in minors))
    det = determinant(body, f)
    bad = body.fence(lambda: det <= ORDINARY * first * jnp.sqrt(first))
    safe = body.fence(lambda: jnp.where(bad, 1.0, det))
    one, two = body.fence(lambda: (jnp.where(bad, 3.0, first), jnp.where(bad, 3.0, second)))
    t = body.fence(lambda: _trace(one, two, safe, 3 if f.dtype.itemsize > 4 else 2))
    a2 = body.fence(lambda: t / ((t * 0.5 * (t * t - one) - safe) * safe))
    a1 = body.fence(lambda: 1 / safe - a2 * 0.5 * (t * t + one))
    a0 = body.fence(lambda: 0.5 * (t * t - one) / safe - a2 * t * safe)
    squared, eye = product(body, c, c), jnp.eye(3, dtype=f.dtype)[..., None]
    inverse = body.fence(lambda: a0[:, None, None] * eye + a1[:, None, None] * c + a2[:, None, None] * squared)

    def ordinary() -> Array:
        whole: Array = sum(f[:, :, k, None] * inverse[:, k, None] for k in AXES)
        return whole if f.dtype.itemsize > 4 else _unit(body, whole)

    def otherwise() -> Array:
        whole = polar_components(tuple(tuple(f[:, i, j] for j in AXES) for i in AXES))
        return jnp.where(bad[:, None, None], jnp.stack([jnp.stack(row, 1) for row in whole], 1), ordinary())

    found: Array = jax.lax.cond(bad.any(), otherwise, ordinary)
    return found, (det <= 0).sum(0, dtype=jnp.int32)


def _unit(body: Body, r: Array) -> Array:
    """Rotations with |R|^2 = 3 to first order. Rounding of the coefficients of F U^-1 is the same along all axes: in
    single precision a strain of 1e-7 to 1e-6, which stiff bodies that hardly move feel."""
    stored = body.fence(lambda: r)
    size = body.fence(lambda: 1.5 - (stored * stored).sum((1, 2)) / 6)
    found: Array = stored * size[:, None, None]
    return found


def cross(a: Array, b: Array) -> Array:
    """Cross products along the last axis but that of the lanes."""
    return jnp.stack([a[..., i, :] * b[..., j, :] - a[..., j, :] * b[..., i, :] for i, j in CYCLES], -2)


def determinant(body: Body, f: Array) -> Array:
    """Of F (E, 3, 3, lanes)."""

    def cofactor(k: int) -> Array:
        i, j = CYCLES[k]
        found: Array = f[:, 1, i] * f[:, 2, j] - f[:, 1, j] * f[:, 2, i]
        return found

    found: Array = body.fence(lambda: sum(f[:, 0, k] * cofactor(k) for k in AXES))
    return found


def _trace(first: Array, second: Array, det: Array, rounds: int) -> Array:
    """tr U, the largest root of t = sqrt(first + 2 sqrt(second + 2 t det))."""
    t = jnp.sqrt(first + 2 * jnp.sqrt(second + 6 * det))
    for _ in range(rounds):
        w = jnp.sqrt(second + 2 * t * det)
        h = jnp.sqrt(first + 2 * w)
        t = t - (t - h) / (1 - det / (w * h))
    return t


def turned_gradients(body: Body, r: Array) -> Array:
    """R grad N_a of each element, (E, 4, 3, lanes)."""
    found: Array = body.fence(lambda: sum(r[:, None, :, j] * body.gradients[:, :, None, j] for j in AXES))
    return found


def strain_stress(body: Body, gradient: Array, lam: Array, mu: Array, shift: float = 0.0) -> Array:
    """V (lam tr(S) I + 2 mu S), S = sym(gradient) - shift I: (E, 3, 3, lanes) of gradients `pairing(field, turned)`.

    Strain is in the world's frame: isotropic laws need no more rotations than there are in the turned gradients.
    """
    eye = jnp.eye(3, dtype=gradient.dtype)[..., None]
    v = body.volumes[:, None, None]

    def stress() -> Array:
        trace = lam * (gradient[:, 0, 0] + gradient[:, 1, 1] + gradient[:, 2, 2] - 3 * shift) - 2 * mu * shift
        both = gradient + gradient.swapaxes(1, 2)
        return v * (mu[:, None, None] * both + trace[:, None, None] * eye)

    found: Array = body.fence(stress)
    return found


def strain_force(body: Body, turned: Array, gradient: Array, lam: Array, mu: Array) -> Array:
    """Sum over elements of V (lam tr(S) I + 2 mu S) r_a, S = sym(gradient), r_a = R grad N_a: (n, 3, lanes)."""
    return nodal_sum(body, corner_rows(body, strain_stress(body, gradient, lam, mu), turned))


def diagonal_blocks(body: Body, turned: Array, lam: Array, mu: Array, mass: Array) -> Array:
    """Blocks of M + K on the free nodes, (nf, 3, 3, lanes): sums of V (lam r r' + mu (r r' + |r|^2 I)) and masses."""
    square, volumes = (turned * turned).sum(2), body.volumes[:, None]
    own, share = volumes * (lam + mu)[:, None], volumes * mu[:, None] * square

    def column(j: int) -> Array:
        rows = body.fence(lambda: (own * turned[:, :, j])[:, :, None] * turned + share[:, :, None] * _axis(turned, j))
        whole = nodal_sum(body, rows.reshape(-1, *rows.shape[2:]))
        found: Array = (whole + mass * _axis(turned, j))[: body.free_count]
        return found

    return jnp.stack([column(j) for j in AXES], 2)


def _axis(like: Array, j: int) -> Array:
    """The unit vector of an axis, (3, 1)."""
    return jnp.eye(3, dtype=like.dtype)[j][:, None]


def inverses(body: Body, blocks: Array) -> Array:
    """Of symmetric blocks (n, 3, 3, lanes), by cofactors."""

    def found() -> Array:
        cofactors = [cross(blocks[:, i], blocks[:, j]) for i, j in CYCLES]
        whole = (blocks[:, 0] * cofactors[0]).sum(1)
        return jnp.stack(cofactors, 2) / whole[:, None, None]

    made: Array = body.fence(found)
    return made


def times(body: Body, blocks: Array, x: Array) -> Array:
    """One product of 3x3 blocks (n, 3, 3, lanes) a node."""
    found: Array = body.fence(lambda: sum(blocks[:, :, j] * x[:, j, None] for j in AXES))
    return found


def tied(body: Body, share: Array, x: Array) -> Array:
    """What masses that are not lumped add to M x, (n, 3, lanes): of each element `share` (E + 1, lanes) times the sum
    over its corners b of x_b - x_a. See `elements/mass.py`."""
    corners = body.fence(lambda: x[body.corners])
    rows = body.fence(lambda: share[:, None, None] * (corners.sum(1, keepdims=True) - 4 * corners))
    return nodal_sum(body, rows.reshape(-1, *rows.shape[2:]))


def corner_rows(body: Body, stress: Array, turned: Array) -> Array:
    """T r_a of each corner, (4 E, 3, lanes)."""
    rows: Array = body.fence(lambda: sum(stress[:, None, :, j] * turned[:, :, None, j] for j in AXES))
    return rows.reshape(-1, *rows.shape[2:])


def nodal_sum(body: Body, rows: Array) -> Array:
    """Sums of the elements' corners (4 E, 3, lanes) over each node, (n, 3, lanes)."""
    return jnp.concatenate([_summed(body, rows, index) for index in body.touch])[body.touch_back]


def _summed(body: Body, rows: Array, index: Array) -> Array:
    taken: Any = body.fence(lambda: rows[index])
    made: Any = None
    for start in range(0, index.shape[1], ROW):
        some = range(start, min(start + ROW, index.shape[1]))
        last = made
        made = body.fence(
            lambda some=some, last=last: sum((taken[:, k] for k in some), start=0.0 if last is None else last)
        )
    found: Array = made
    return found
