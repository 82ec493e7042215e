"""Time schemes in row form: where a step takes strains and rates, and how velocities become the next state.

A scheme only changes the coefficients of C and c, the velocities that loads are added to, and the recombination:
strain and rate are taken at  x_a = base + ahead + reach v  and  v_a = before + follow v,  v the end-of-step velocity,
and impulses count `weight` instead of dt. Rows are linearised at `base`.

Backward Euler: x_a = x + dt v, v_a = v. Generalised alpha (Chung & Hulbert 1993), with numbers from rho, the share of
the highest frequencies that a step leaves:  a_m = (2 rho - 1)/(rho + 1), a_f = rho/(rho + 1), g = 1/2 - a_m + a_f,
b = (1 - a_m + a_f)^2 / 4:
    M ((1 - a_m) a1 + a_m a0) = f at (1 - a_f) (x1, v1) + a_f (x0, v0)
    x1 = x0 + dt v0 + dt^2 ((1/2 - b) a0 + b a1),   v1 = v0 + dt ((1 - g) a0 + g a1).
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.pytrees import Pytree

Array = jax.Array

SCHEMES = ("backward_euler", "generalized_alpha")


class Stage(Pytree):
    """Where a step's rows are made, see above; `start` (n, 3): velocities before loads act. None stands for zeros.

    `reach`, `follow` and `weight` are one number each, or (n, 1) where bodies take the step by different schemes.
    """

    base: Array
    ahead: Array | None
    before: Array | None
    start: Array
    reach: Array
    follow: Any
    weight: Array

    def numbers(self, nodes: Array) -> tuple[Any, Any, Any]:
        """`reach`, `follow` and `weight` for rows on `nodes` (...): numbers, or arrays (...)."""
        reach, follow, weight = (v[nodes, 0] if jnp.ndim(v) else v for v in (self.reach, self.follow, self.weight))
        return reach, follow, weight


class Alpha(Pytree):
    """The numbers of generalised alpha for a given rho."""

    mass: Array
    force: Array
    gamma: Array
    beta: Array


def alpha_numbers(rho: Array) -> Alpha:
    """Chung & Hulbert 1993: second order, least low-frequency damping for `rho` in [0, 1]."""
    mass, force = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
    return Alpha(mass, force, 0.5 - mass + force, 0.25 * (1 - mass + force) ** 2)


def backward_euler_stage(positions: Array, velocities: Array, dt: Array) -> Stage:
    """Strain and rate at the end of the step, rows linearised at its start."""
    return Stage(positions, None, None, velocities, dt, 1.0, dt)


def alpha_stage(
    positions: Array, velocities: Array, accelerations: Array, prescribed: Array, free: Array, dt: Array, rho: Array
) -> Stage:
    """Strain and rate in between, rows linearised at the place that the old velocity leads to.

    That place is within O(dt^2) of the stage, so what is left of the rotations is of third order in a step. Nodes with
    `free` (n, 1) false move evenly with their `prescribed` velocity.
    """
    n = alpha_numbers(rho)
    reach = (1 - n.force) * n.beta / n.gamma * dt
    drift = (1 - n.force) * dt
    ahead = -reach * velocities + drift * dt * (0.5 - n.beta / n.gamma) * accelerations
    scale = n.gamma / (1 - n.mass)
    return Stage(
        base=positions + drift * velocities,
        ahead=jnp.where(free, ahead, (drift - reach) * prescribed - drift * velocities),
        before=n.force * velocities,
        start=velocities + dt * ((1 - n.gamma) - scale * n.mass) * accelerations,
        reach=reach,
        follow=1 - n.force,
        weight=scale * dt,
    )


def moved_to(stage: Stage, velocities: Array) -> Stage:
    """The stage with its rows linearised where end-of-step `velocities` (n, 3) lead; the forces there are exact."""
    place = stage.base + stage.reach * velocities
    place = place if stage.ahead is None else place + stage.ahead
    before = jnp.zeros_like(velocities) if stage.before is None else stage.before
    return stage.replace(base=place, ahead=-stage.reach * velocities, before=before)


def alpha_advance(
    positions: Array, velocities: Array, accelerations: Array, found: Array, free: Array, dt: Array, rho: Array
) -> tuple[Array, Array]:
    """Positions and accelerations (n, 3) at the end of the step, from its velocities `found`."""
    n = alpha_numbers(rho)
    new = (found - velocities) / (n.gamma * dt) - (1 - n.gamma) / n.gamma * accelerations
    moved = positions + dt * velocities + dt**2 * ((0.5 - n.beta) * accelerations + n.beta * new)
    return jnp.where(free, moved, positions + dt * found), jnp.where(free, new, 0.0)


def scheme_damping(scheme: str, frequencies: Any, dt: Any, rho_inf: Any = 0.8) -> Array:
    """Damping ratio that the time scheme itself gives to undamped modes of `frequencies` [rad/s] at steps `dt` [s].

    scheme: "backward_euler" or "generalized_alpha" (with its rho_inf). The shape of `frequencies` comes back; 0 for
    rigid motions. ValueError for an unknown scheme or impossible numbers.
    From the step's eigenvalue z = exp(s dt): ratio = -Re s / |s|.
    """
    if scheme not in SCHEMES:
        raise ValueError(f"scheme is {scheme!r}; known: {', '.join(SCHEMES)}")
    known = jnp.asarray(frequencies)
    turn = (known if jnp.issubdtype(known.dtype, jnp.floating) else known.astype(float)) * dt
    _check_damping(known, dt, rho_inf)
    slope = 1j / (1 - 1j * turn) if scheme == "backward_euler" else _alpha_slope(turn, jnp.asarray(rho_inf))
    # z = 1 + turn u, and log |z| without the digits that |z| = 1 + small would lose.
    decay = 0.5 * jnp.log1p(turn * (2 * slope.real + turn * jnp.abs(slope) ** 2))
    angle = jnp.arctan2(turn * slope.imag, 1 + turn * slope.real)
    moving = turn > 0
    return jnp.where(moving, -decay / jnp.hypot(decay, jnp.where(moving, angle, 1)), 0)


def _check_damping(frequencies: Any, dt: Any, rho: Any) -> None:
    """Refuse numbers that make no sense, where they are known; within a compiled function they are not looked at."""
    if any(isinstance(value, jax.core.Tracer) for value in (frequencies, dt, rho)):
        return
    if not bool(jnp.all(frequencies >= 0)):
        raise ValueError("frequencies must be 0 or more, in rad/s")
    if not (dt > 0 and 0 <= rho <= 1):
        raise ValueError(f"dt is {dt} and rho_inf {rho}; dt must be positive [s] and rho_inf from 0 to 1")


CONTINUATION = 12
"""Parts in which the eigenvalue is followed from slow modes to the one asked for."""


def _alpha_slope(turn: Array, rho: Array) -> Array:
    """u = (z - 1) / turn for the oscillating eigenvalue z of one step on a mode with dt = 1, omega = `turn`.

    z solves s^2 (1 + (1 - a_m) s) + turn^2 (1 + (1 - a_f) s) (1 + (g + 1/2) s + b s^2) = 0 with s = z - 1: followed
    from u = i at turn = 0 by Newton's method.
    """
    n = alpha_numbers(rho)

    def polynomial(u: Array, at: Array) -> Array:
        s = at * u
        return u**2 * (1 + (1 - n.mass) * s) + (1 + (1 - n.force) * s) * (1 + (n.gamma + 0.5) * s + n.beta * s**2)

    def trip(k: Array, u: Array) -> Array:
        at = turn * jnp.minimum(1, (k // 3 + 1) / CONTINUATION)
        value, slope = jax.jvp(partial(polynomial, at=at), (u,), (jnp.ones_like(u),))
        return u - value / slope

    return jax.lax.fori_loop(0, 3 * CONTINUATION + 3, trip, jnp.full(turn.shape, 1j))
