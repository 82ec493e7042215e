"""Backward Euler: first order, damps what moves fast, at ease with impacts: x1 = x0 + dt v1, M (v1 - v0) = dt f1."""

from typing import ClassVar

import jax

from jaxfem.schemes.base import Moving, Scheme, Stage

Array = jax.Array


class BackwardEuler(Scheme):
    """Strain and rate at the end of the step, rows linearised at its start: x_a = x + dt v, v_a = v."""

    name: ClassVar[str] = "backward_euler"
    order: ClassVar[int] = 1
    rigid: ClassVar[bool] = True
    restarts: ClassVar[bool] = False
    straight: ClassVar[bool] = True
    lanes: ClassVar[bool] = True
    euler: ClassVar[bool] = True

    def stage(self, state: Moving, prescribed: Array, free: Array, dt: Array) -> Stage:
        """The end of the step."""
        return Stage(state.positions, None, None, state.velocities, dt, 1.0, dt)

    def advance(self, state: Moving, velocities: Array, free: Array, dt: Array) -> tuple[Array, Array | None]:
        """Along the new velocities."""
        return state.positions + dt * velocities, None

    def slope(self, turn: Array) -> Array:
        """z = 1 / (1 - i turn)."""
        return 1j / (1 - 1j * turn)
