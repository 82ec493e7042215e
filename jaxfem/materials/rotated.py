"""Laws of the strain in the rotated frame, e = U - I, U the stretch of F = R U: small-strain laws at large rotations.

Energy and stress are exact: R turns with F. Stress and stretch need not share axes, where there is a memory.
"""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.materials.base import Values
from jaxfem.materials.nonlinear import Nonlinear
from jaxfem.materials.principal import tangent_of
from jaxfem.rotation import known_rotation, polar_components
from jaxfem.tensors import Matrix3, matrix_of, product, symmetric, to_eigenbasis, transposed

Array = jax.Array


class RotatedLaw(Nonlinear):
    """A law whose energy is convex in the rotated strain: a subclass gives `sheared`, and `stiffness`."""

    def sheared(self, values: Values, strain: Array, internal: Any, dt: Any) -> Array:
        """Energy density (D,) [J/m^3] of the deviatoric strain (5, D), the rows 1 to 5 of the eigenbasis."""
        raise NotImplementedError(f"{type(self).__name__} does not say its energy: define `sheared`")

    def distortion(self, values: Values, gradient: Matrix3, internal: Any, dt: Any) -> Array:
        """That of the deviatoric strain."""
        return self.sheared(values, rotated(gradient)[1:], internal, dt)

    def dilation(self, gradient: Matrix3) -> Array:
        """Trace of the strain."""
        return ROOT3 * rotated(gradient)[0]

    def density(self, values: Values, bulk: Any, gradient: Array, internal: Any, dt: Any) -> Array:
        """Of both parts, with one rotation."""
        return self._of(values, bulk, rotated(matrix_of(gradient)), internal, dt)

    def definite(self, tangent: Array, values: Values, bulk: Any, gradient: Array, internal: Any, dt: Any) -> Array:
        """The tangent with the rotation held: the energy is convex in the strain."""
        turn = turn_of(gradient)

        def held(h: Array) -> Array:
            return self._of(values, bulk, rotated(matrix_of(h), turn), internal, dt)

        return tangent_of(held, gradient)

    def _of(self, values: Values, bulk: Any, strain: Array, internal: Any, dt: Any) -> Array:
        sheared = self.sheared(values, strain[1:], internal, dt)
        return sheared if bulk is None else sheared + 1.5 * bulk * strain[0] ** 2


ROOT3 = 3.0**0.5


def rotated(gradient: Matrix3, turn: Matrix3 | None = None) -> Array:
    """Strain sym(R'F) - I (6, D) in the eigenbasis, at H = F - I; R the nearest rotation, or `turn`."""
    deformation = tuple(tuple(gradient[i][j] + (1.0 if i == j else 0.0) for j in range(3)) for i in range(3))
    if turn is None:
        found = polar_components(jax.lax.stop_gradient(deformation))
        turn = known_rotation(deformation, found)
    stretch = symmetric(product(transposed(turn), deformation))
    return jnp.stack(to_eigenbasis([[stretch[i][j] - (1.0 if i == j else 0.0) for j in range(3)] for i in range(3)]))


def turn_of(gradient: Array) -> Matrix3:
    """The nearest rotation of F = I + `gradient` (3, 3, D)."""
    return polar_components(matrix_of(gradient + jnp.eye(3, dtype=gradient.dtype)[:, :, None]))
