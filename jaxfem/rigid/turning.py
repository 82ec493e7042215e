"""Free turning of rigid bodies: the mean spin of a step that keeps angular momentum and energy.

In the body's frame, with the momentum P0 at the start and the turn psi within the step (R1 = R0 exp psi),
    P1 = exp(-psi) P0,    psi = dt J^-1 (P0 + P1) / 2.
The spatial momentum R P is kept whatever psi is, and so is energy where psi is along J^-1 (P0 + P1): the change of
energy is half of (P1 - P0) . J^-1 (P1 + P0), and P1 - P0 is across the axis of the turn (an energy-momentum midpoint
rule, Simo & Wong 1991, with the exponential in place of Cayley's map, which makes steady spins exact). Symmetric in
time, of second order. A solution exists at any spin (Brouwer), and Newton's method finds it up to about a radian a
step. Beyond, the midpoint's prediction is turned onto the surface of constant energy, along its gradient.
"""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.batching import cond_any
from jaxfem.pytrees import Pytree
from jaxfem.solvers.differentiation import solved
from jaxfem.tensors import cross_matrix, determinant, matrix_of, product, times, transposed

Array = jax.Array
Vector = list[Array]
Matrix = Any

TRIPS = 12
"""Newton steps at most; two or three are what resolved turns take."""
KEEPING = 0.02
"""A matrix serves on while the largest residual falls below this share of the last."""
ROUNDING = 16.0
"""Times the precision: a turn that is known to its own rounding."""
NOISE, PASSES = 2.0, 3
"""Times the precision and the turn: a share of energy that is only rounding's. Corrections of what is more."""
SMALL = 1e-3
"""Square of an angle below which series are used."""


def mean_spin(inertia: Array, rotations: Array, spin: Array, dt: Array) -> Array:
    """Angular velocities (b, 3), in the world, along which free bodies turn from start to end of a step.

    `inertia` (b, 3, 3) in the bodies' frames, of any scale; `rotations` (b, 3, 3) body to world and `spin` (b, 3) in
    the world at the start. Differentiable.
    """
    turn = matrix_of(jnp.moveaxis(rotations, 0, -1))
    tensor = matrix_of(jnp.moveaxis(inertia, 0, -1))
    inverse = _inverse(tensor)
    own = times(transposed(turn), spin.T)
    inputs = _Turn(tensor, inverse, own, dt)
    guess = _predicted(inputs)
    found, good = solved(_solve, _tangent, inputs, jax.lax.stop_gradient(jnp.stack(guess)))
    psi = [jnp.where(good, one, other) for one, other in zip(found, guess, strict=True)]
    return jnp.stack(times(turn, _on_energy(inputs, psi))).T / dt


class _Turn(Pytree):
    """Inertia and its inverse (3x3 components), angular velocity in the body's frame, time step."""

    inertia: Any
    inverse: Any
    spin: Any
    dt: Array

    @property
    def momentum(self) -> Vector:
        """P0."""
        return times(self.inertia, self.spin)


def _predicted(inputs: _Turn) -> Vector:
    """The turn with the momentum that the spin at the start gives for the middle, as seen from the start."""
    half, momentum = [0.5 * inputs.dt * each for each in inputs.spin], inputs.momentum
    middle = _plus(momentum, _turned([-each for each in half], momentum))
    spin = times(inputs.inverse, middle)
    return [inputs.dt * each for each in _plus(spin, _turned(half, spin))]


def _solve(inputs: _Turn, guess: Array) -> tuple[Array, Array]:
    """psi (3, b) by Newton's method, its matrix kept while it serves; and which bodies (b,) have arrived.

    What a trip or a branch makes is handed on in components and before it is used: stacked or with many readers it
    would be computed anew for each of them, ten times as dear.
    """
    least = ROUNDING * jnp.finfo(guess.dtype).eps * jnp.sqrt(jnp.sum(guess**2, 0))

    def trip(carry: Any) -> Any:
        psi, matrix, _, last, trips = carry
        residual = _residual(inputs, psi)
        far = _root(_dot(residual, residual))
        good = far <= least
        most = jnp.max(jnp.where(good, 0, far / least))
        fresh = (most > KEEPING * last) | (trips == 0) & (most > 0)
        matrix = cond_any(fresh, lambda: _inverse(_derivative(inputs, psi)), lambda: matrix)
        moved = [jnp.where(good, p, p - s) for p, s in zip(psi, times(matrix, residual), strict=True)]
        return moved, matrix, good, most, trips + 1

    def running(carry: Any) -> Array:
        more: Array = ~jnp.all(carry[2]) & (carry[4] <= TRIPS)
        return more

    zero, none = jnp.zeros_like(guess[0]), jnp.zeros(guess.shape[1:], bool)
    start = (list(guess), [[zero] * 3] * 3, none, jnp.full((), jnp.inf, guess.dtype), jnp.int32(0))
    psi, _, good, _, _ = jax.lax.while_loop(running, trip, start)
    return jnp.stack(psi), good


def _tangent(psi: Array, good: Array, arguments: tuple[_Turn, Array], pushed: Any) -> Array:
    """How psi follows the condition: residual(inputs, psi) = 0, and its derivative in psi is `_derivative`."""
    right = pushed(lambda inputs, guess: jnp.stack(_residual(inputs, list(psi))))
    return -jnp.stack(times(_inverse(_derivative(arguments[0], list(psi))), list(right)))


def _residual(inputs: _Turn, psi: Vector) -> Vector:
    """psi - dt J^-1 (P0 + P1) / 2."""
    momentum = inputs.momentum
    change = _turned([-each for each in psi], momentum)
    mean = times(inputs.inverse, [p + 0.5 * d for p, d in zip(momentum, change, strict=True)])
    return [each - inputs.dt * spin for each, spin in zip(psi, mean, strict=True)]


def _derivative(inputs: _Turn, psi: Vector) -> Matrix:
    """Of the condition: I - dt/2 J^-1 [P1] Jl(-psi), with Jl the left Jacobian of the rotation vector."""
    square = _dot(psi, psi)
    first, second = _half_versine(square), _third(square)
    cross = cross_matrix(psi)
    twice = product(cross, cross)
    jacobian = [[float(i == j) - first * cross[i][j] + second * twice[i][j] for j in range(3)] for i in range(3)]
    end = _plus(inputs.momentum, _turned([-each for each in psi], inputs.momentum))
    moved = product(inputs.inverse, product(cross_matrix(end), jacobian))
    return [[float(i == j) - 0.5 * inputs.dt * moved[i][j] for j in range(3)] for i in range(3)]


def _on_energy(inputs: _Turn, psi: Vector) -> Vector:
    """The turn nearest to psi, along the gradient of energy, whose end has the energy of the start.

    Nothing where that is met to rounding, which is where Newton's method has ended well.
    """
    change = _turned([-each for each in psi], inputs.momentum)
    noise = NOISE * jnp.finfo(psi[0].dtype).eps * jnp.minimum(_root(_dot(psi, psi)), 2)
    off = jnp.any(jnp.abs(_excess(inputs, change)) > noise * _dot(inputs.momentum, inputs.spin))
    turned: Vector = cond_any(off, lambda: _put_on_energy(inputs, psi, change, noise), lambda: psi)
    return turned


def _put_on_energy(inputs: _Turn, psi: Vector, change: Vector, noise: Array) -> Vector:
    """The same, at the `change` of momentum that psi makes."""
    start = inputs.momentum
    some = _dot(start, start) > 0
    square = jnp.where(some, _dot(start, start), 1)
    moved, _ = jax.lax.scan(lambda at, _: (_nearer(inputs, at, square, noise), None), change, None, length=PASSES)
    # Where that has not arrived, in turns of several radians, the momentum stays where it is in the body.
    arrived = jnp.abs(_excess(inputs, moved)) <= 10 * noise * _dot(start, inputs.spin)
    moved = [jnp.where(arrived, each, 0) for each in moved]
    end, moved = _plus(start, change), _plus(start, moved)
    # The least rotation that takes the wanted end to the one found, as a quaternion.
    across = _cross(moved, end)
    along = _dot(moved, end) + _root(_dot(moved, moved)) * _root(_dot(end, end))
    along = jnp.where(some, along, 1)
    size = _root(_dot(across, across) + along**2)
    near = [along / size, *(each / size for each in across)]
    turned = _rotation_vector(_after(_quaternion(psi), near), psi)
    off = (moved[0] != end[0]) | (moved[1] != end[1]) | (moved[2] != end[2])
    return [jnp.where(off, one, other) for one, other in zip(turned, psi, strict=True)]


def _excess(inputs: _Turn, change: Vector) -> Array:
    """Twice the energy that a change of the momentum adds."""
    mean = [2 * start + each for start, each in zip(inputs.momentum, change, strict=True)]
    return _dot(times(inputs.inverse, change), mean)


def _nearer(inputs: _Turn, change: Vector, square: Array, noise: Array) -> Vector:
    """A change of the momentum that comes nearer to keeping energy; `square`: |P|^2, `noise`: a share of energy."""
    end, energy = _plus(inputs.momentum, change), _dot(inputs.momentum, inputs.spin)
    spin = times(inputs.inverse, end)
    slope = [u - _dot(end, spin) / square * p for u, p in zip(spin, end, strict=True)]
    excess = _excess(inputs, change)
    excess = jnp.sign(excess) * jnp.maximum(jnp.abs(excess) - noise * energy, 0)
    length = _along(excess, slope, _dot(slope, times(inputs.inverse, slope)), energy / square)
    shrink = jax.lax.rsqrt(1 + length**2 * _dot(slope, slope) / square)
    moved = [shrink * (p + length * g) - q for p, g, q in zip(end, slope, inputs.momentum, strict=True)]
    return [jnp.where(length != 0, one, other) for one, other in zip(moved, change, strict=True)]


def _along(excess: Array, slope: Vector, curvature: Array, share: Array) -> Array:
    """s with the energy of (P + s g), put back on the sphere of |P|, less by `excess`: the small root of a quadratic.

    Where there is none, the s of the least excess.
    """
    rate = _dot(slope, slope)
    some = (rate > 0) & (excess != 0)
    rate = jnp.where(some, rate, 1)
    bend = curvature - share * rate
    far = bend * excess > rate**2
    excess = jnp.where(far, rate**2 / jnp.where(far, bend, 1), excess)
    root = _root(rate**2 - bend * excess)
    return jnp.where(some, -excess / (rate + root), 0)


def _turned(psi: Vector, vector: Vector) -> Vector:
    """exp(psi) v - v, exact to the rounding of that difference."""
    square = _dot(psi, psi)
    once = _cross(psi, vector)
    twice = _cross(psi, once)
    first, second = _sine(square), _half_versine(square)
    return [first * a + second * b for a, b in zip(once, twice, strict=True)]


def _quaternion(psi: Vector) -> Vector:
    square = 0.25 * _dot(psi, psi)
    half = 0.5 * _sine(square)
    return [jnp.cos(_root(square)), *(half * each for each in psi)]


def _after(p: Vector, q: Vector) -> Vector:
    """The product p q of quaternions."""
    across = _cross(p[1:], q[1:])
    vector = [p[0] * b + q[0] * a + c for a, b, c in zip(p[1:], q[1:], across, strict=True)]
    return [p[0] * q[0] - _dot(p[1:], q[1:]), *vector]


def _rotation_vector(q: Vector, near: Vector) -> Vector:
    """The rotation vector of a quaternion with as many full turns as the one that it is `near` to."""
    vector = q[1:]
    square = _dot(vector, vector)
    some = square > jnp.finfo(square.dtype).eps ** 2
    size = jnp.sqrt(jnp.where(some, square, 1)) * jnp.where(_dot(vector, near) < 0, -1, 1)
    angle = jnp.arctan2(size, q[0])
    angle = angle + 2 * jnp.pi * jnp.round((0.5 * _root(_dot(near, near)) - angle) / (2 * jnp.pi))
    return [jnp.where(some, 2 * angle / size * each, other) for each, other in zip(vector, near, strict=True)]


def _sine(square: Array) -> Array:
    """sin a / a of a^2."""
    small = square < SMALL
    angle = jnp.sqrt(jnp.where(small, 1, square))
    series = 1 - square / 6 * (1 - square / 20 * (1 - square / 42 * (1 - square / 72)))
    return jnp.where(small, series, jnp.sin(angle) / angle)


def _half_versine(square: Array) -> Array:
    """(1 - cos a) / a^2 of a^2."""
    return 0.5 * _sine(0.25 * square) ** 2


def _third(square: Array) -> Array:
    """(a - sin a) / a^3 of a^2; to ten digits where it is small, for a derivative."""
    small = square < SMALL
    return jnp.where(small, 1 / 6 - square / 120 * (1 - square / 42), (1 - _sine(square)) / jnp.where(small, 1, square))


def _inverse(a: Matrix) -> Matrix:
    """Of any matrix that has one."""
    rows = [list(row) for row in a]
    columns = [_cross(rows[(i + 1) % 3], rows[(i + 2) % 3]) for i in range(3)]
    whole = determinant(rows)
    return [[columns[j][i] / whole for j in range(3)] for i in range(3)]


def _plus(u: Vector, v: Vector) -> Vector:
    return [a + b for a, b in zip(u, v, strict=True)]


def _dot(u: Vector, v: Vector) -> Array:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def _cross(u: Vector, v: Vector) -> Vector:
    return [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]


def _root(square: Array) -> Array:
    """A square root with the slope 0 at 0."""
    some = square > 0
    return jnp.where(some, jnp.sqrt(jnp.where(some, square, 1)), 0)
