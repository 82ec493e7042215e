"""Laws that are not linear in a step: an energy of the deformation gradient; stress and tangent follow from it.

The energy of a volume is that of its change of shape and that of its change of volume,
    W(F) = W_s(F) + K/2 theta(F)^2,   K the bulk modulus, theta = J - 1 unless the law says otherwise,
so that each can be taken on domains of its own, as strain rows do: both on elements, or the first on edges and the
second on nodes, where it does not lock. W_s has no bulk modulus at F = I: then small strains see the linear law.
"""

from typing import Any, ClassVar

import jax

from jaxfem.materials.base import Material, Values
from jaxfem.materials.invariants import volume_change
from jaxfem.materials.principal import definite_part
from jaxfem.tensors import Matrix3, matrix_of

Array = jax.Array


class Nonlinear(Material):
    """A law whose stress in a step is not linear in the strain; a subclass gives `distortion`, and `stiffness` at rest.

    Matrices H = F - I are components of shape (D,), values () or (D,); with a memory see also `internal0` and `commit`,
    whose strains are those of the rotated frame.
    """

    linear: ClassVar[bool] = False

    def distortion(self, values: Values, gradient: Matrix3, internal: Any, dt: Any) -> Array:
        """Energy density (D,) [J/m^3] of the change of shape at H = F - I `gradient`.

        Differentiable twice. `internal`: what is remembered; `dt` [s]: since then, None where rest is asked for.
        """
        raise NotImplementedError(f"{type(self).__name__} does not say its energy: define `distortion`")

    def dilation(self, gradient: Matrix3) -> Array:
        """theta (D,), the change of volume that the bulk modulus acts on."""
        return volume_change(gradient)

    def density(self, values: Values, bulk: Any, gradient: Array, internal: Any, dt: Any) -> Array:
        """Energy density (D,) at H (3, 3, D); `bulk`: K of what changes volume with it [Pa], None where none does."""
        components = matrix_of(gradient)
        shape = self.distortion(values, components, internal, dt)
        return shape if bulk is None else shape + 0.5 * bulk * self.dilation(components) ** 2

    def definite(self, tangent: Array, values: Values, bulk: Any, gradient: Array, internal: Any, dt: Any) -> Array:
        """The `tangent` d2 W/dF2 (9, 9, D) without its negative eigenvalues: its neighbour that Newton steps can use.

        By the eigenpairs of isotropic laws; a law that is not isotropic (whose memory has directions) has its own.
        """
        return definite_part(tangent, gradient)
