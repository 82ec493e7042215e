"""The elastic force with lanes last, with tangent and transpose by hand: each as dear as a product with the matrix.

With W the gradient of place + beta rate, R the rotations, r_a = R grad N_a, and rows of matrices as vectors:
    A = W R' = sum_a (place + beta rate)_a r_a',   T = V (lam tr(A - I) I + mu (A + A' - 2 I)),   f = sum_e T r_a.
The nearest rotation of F turns by dR = skew(w) R, (tr(S) I - S) w = vex(G - G') with S = F R', G = dF R', so
    dA = dW R' - A skew(w),   df = sum_e (dT + T skew(w)) r_a.
From a cotangent l of f, with L = sum_a l_a r_a' and H = V (lam tr(L) I + mu (L + L')), come back
    q = sum_i L_i x T_i - H_i x A_i  to w,   H r_a to place,   skew(p) r_a to the base, where (tr(S) I - S) p = q.
Left to itself JAX would transpose gathers into scatters and go through every branch that stores a value.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_derivatives import linear_call
from jax.flatten_util import ravel_pytree

from jaxfem.pytrees import Pytree, static
from jaxfem.rotation import _guarded_solve, _scale, _scaled, _spin_matrix
from jaxfem.sweeping.lanes.body import Body
from jaxfem.sweeping.lanes.kernels import AXES, CYCLES, corner_rows, cross, nodal_sum, pairing, strain_stress

Array = jax.Array


class Strained(Pytree):
    """What the force depends on, lanes last: `base` (n, 3) whose rotations are taken, `place` and `rate` (n, 3) which
    are strained, `lam`, `mu`, `beta` (E + 1 or 1). Without `rate` and `beta` they are in `place`: one damping for all
    elements is taken in one pass. `spin` (E + 1, 3): how rotations turn beside those of the base, or None.
    """

    base: Array
    place: Array
    rate: Array | None
    lam: Array
    mu: Array
    beta: Array | None
    spin: Array | None = None


class Held(Pytree):
    """What derivatives share: S, A of place and rate together, A of the rate, and T; whether there is a `spin`."""

    stretch: Array
    strained: Array
    rates: Array | None
    stress: Array
    lam: Array
    mu: Array
    beta: Array | None
    turns: bool = static()


@jax.custom_jvp
def elastic_force(body: Body, turned: Array, at: Strained) -> Array:
    """sum_e T r_a (n, 3, lanes) [N]; `turned` (E + 1, 4, 3, lanes): r_a.

    Differentiable in `at` alone, once: that the rotations are the nearest ones of its base is in that.
    """
    strained, _ = _gradients(body, turned, at)
    stress = strain_stress(body, strained, at.lam, at.mu, 1.0)
    return nodal_sum(body, corner_rows(body, stress, turned))


@elastic_force.defjvp
def _elastic_force_jvp(primals: Any, tangents: Any) -> tuple[Array, Array]:
    body, turned, at = primals
    strained, rates = _gradients(body, turned, at)
    stress = strain_stress(body, strained, at.lam, at.mu, 1.0)
    force = nodal_sum(body, corner_rows(body, stress, turned))
    stretch = pairing(body, at.base, turned) + body.nothing
    held = Held(stretch, strained, rates, stress, at.lam, at.mu, at.beta, at.spin is not None)
    # One flat vector: JAX cannot transpose a linear call where only some of its arguments have a tangent.
    flat, shaped = ravel_pytree(tangents[2])

    def pushed(shared: Any, flat: Array) -> Array:
        return _pushed(shared, shaped(flat))

    def pulled(shared: Any, force: Array) -> Array:
        return ravel_pytree(_pulled(shared, force))[0]

    change: Array = linear_call(pushed, pulled, (body, turned, held), flat)
    return force, change


def _gradients(body: Body, turned: Array, at: Strained) -> tuple[Array, Array | None]:
    """A of place and rate together, and of the rate alone where elements differ in damping."""
    strained = pairing(body, at.place, turned)
    if at.rate is None or at.beta is None:
        return strained, None
    rates, beta = pairing(body, at.rate, turned), at.beta
    return body.fence(lambda: strained + beta[:, None, None] * rates), rates


def _pushed(shared: tuple[Body, Array, Held], change: Strained) -> Array:
    """The force's change with that of what it depends on."""
    body, turned, held = shared
    spin = _spin(body, held.stretch, _vex(body, pairing(body, change.base, turned)))
    if change.spin is not None:
        spin = spin + change.spin
    strain, damped = pairing(body, change.place, turned), _damped(body, turned, held, change)
    eye = jnp.eye(3, dtype=spin.dtype)[..., None]

    def strained() -> Array:
        found = strain - cross(held.strained, spin[:, None])
        return found if damped is None else found + damped

    turned_strain = body.fence(strained)
    own = strain_stress(body, turned_strain, held.lam, held.mu, 0.0)

    def stress() -> Array:
        trace = change.lam * (_trace(held.strained) - 3) - 2 * change.mu
        both = held.strained + held.strained.swapaxes(1, 2)
        moduli = body.volumes[:, None, None] * (change.mu[:, None, None] * both + trace[:, None, None] * eye)
        return own + moduli + cross(held.stress, spin[:, None])

    return nodal_sum(body, corner_rows(body, body.fence(stress), turned))


def _damped(body: Body, turned: Array, held: Held, change: Strained) -> Array | None:
    """The change of beta times the rates' gradient, where elements differ in damping."""
    rates, beta = held.rates, held.beta
    if rates is None or beta is None or change.rate is None or change.beta is None:
        return None
    more, other = pairing(body, change.rate, turned), change.beta
    found: Array = body.fence(lambda: beta[:, None, None] * more + other[:, None, None] * rates)
    return found


def _pulled(shared: tuple[Body, Array, Held], force: Array) -> Strained:
    """What comes back to all that the force depends on."""
    body, turned, held = shared
    back = pairing(body, force, turned)
    stress = strain_stress(body, back, held.lam, held.mu, 0.0)
    spin = body.fence(lambda: (cross(back, held.stress) - cross(stress, held.strained)).sum(1))
    pull = _spin(body, held.stretch, spin)
    base = body.fence(lambda: cross(pull[:, None], turned))
    volumes, trace = body.volumes, _trace(back)
    both = ((held.strained + held.strained.swapaxes(1, 2)) * back).sum((1, 2))
    rate = beta = None
    if held.rates is not None and held.beta is not None:
        own = held.beta
        rate = nodal_sum(body, corner_rows(body, body.fence(lambda: own[:, None, None] * stress), turned))
        beta = _like(own, (stress * held.rates).sum((1, 2)))
    return Strained(
        base=nodal_sum(body, base.reshape(-1, *base.shape[2:])),
        place=nodal_sum(body, corner_rows(body, stress, turned)),
        rate=rate,
        lam=_like(held.lam, volumes * trace * (_trace(held.strained) - 3)),
        mu=_like(held.mu, volumes * (both - 2 * trace)),
        beta=beta,
        spin=spin if held.turns else None,
    )


def _spin(body: Body, stretch: Array, right: Array) -> Array:
    """w (E + 1, 3, lanes) of (tr(S) I - S) w = right, guarded as in `nearest_rotation`; its own transpose."""

    def found() -> Array:
        s = tuple(tuple(stretch[:, i, j] for j in AXES) for i in AXES)
        scale = _scale(s)
        return jnp.stack(_guarded_solve(_spin_matrix(_scaled(s, scale)), tuple(right[:, i] / scale for i in AXES)), 1)

    made: Array = body.fence(found)
    return made


def _vex(body: Body, g: Array) -> Array:
    """The axial vector of G - G', (E + 1, 3, lanes)."""
    found: Array = body.fence(lambda: jnp.stack([g[:, j, i] - g[:, i, j] for i, j in CYCLES], 1))
    return found


def _trace(a: Array) -> Array:
    return a[:, 0, 0] + a[:, 1, 1] + a[:, 2, 2]


def _like(value: Array, found: Array) -> Array:
    """Summed over the elements where they share one value."""
    return found.sum(0, keepdims=True) if value.shape[0] == 1 else found
