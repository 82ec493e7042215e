"""Elastic rows of laws that are not linear in a step: the exact energy as a function of velocity, and its tangent.

Strain is taken at x = base + ahead + reach v, so H = known + reach grad v, and the impulse on node a is
    -weight P grad N_a,   minus the slope in v of   Phi = weight / reach E(H(v)).
"""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.elements.domains import Domains, domain_gradient
from jaxfem.elements.finite import Curvature, Drag, LawMaterial, curvature, displacement_gradient, energy, force
from jaxfem.pytrees import Pytree, static
from jaxfem.schemes import Stage
from jaxfem.tensors import Matrix3, array_of

Array = jax.Array


class LawRows(Pytree):
    """The energy of domains in a step, as a function of the end-of-step velocities (n, 3); see the head of this file.

    `known` (3, 3, D): H at v = 0; `reach` [s], () or (D,); `rotation` (3, 3, D): the frames that the step begins with.
    """

    domains: Domains
    material: LawMaterial
    drag: Drag
    known: Array
    reach: Any
    scale: Any  # weight / reach of each set of rows
    rotation: Array
    nodes: int = static()

    def _gradient(self, velocities: Array) -> Array:
        at: Array = self.known + self.reach * array_of(domain_gradient(self.domains, velocities))
        return at

    def objective_and_impulse(self, velocities: Array) -> tuple[Array, Array]:
        """Phi () [J], which a step makes small beside the kinetic energy of the change of velocity, and `impulse`."""
        at = self._gradient(velocities)
        value, stress = jax.value_and_grad(lambda h: energy(self.domains, self.material, self.drag, h, self.scale))(at)
        return value, force(self.domains, -self.reach * stress, self.nodes)

    def impulse(self, velocities: Array) -> Array:
        """Nodal impulses (n, 3) [N s], minus the slope of Phi."""
        return self.objective_and_impulse(velocities)[1]

    def tangent(self, velocities: Array, definite: Any) -> "TangentRows":
        """How the impulses change with v at `velocities`; `definite`: see `curvature`."""
        at = self._gradient(velocities)
        found = curvature(self.domains, self.material, self.drag, at, definite, self.scale)
        return TangentRows(self.domains, self.rotation, self.reach, found)

    def noise(self, positions: Array) -> Array:
        """Impulse () [N s] that is only rounding: its change when positions (n, 3) change by half their last digit.

        Each by that of the largest, up or down by chance.
        """
        digit = 0.5 * jnp.finfo(positions.dtype).eps * jnp.max(jnp.abs(positions))
        kick = digit * jax.random.rademacher(jax.random.key(0), positions.shape, positions.dtype)
        kick = kick / jnp.min(self.reach)
        pair = jax.vmap(self.impulse)(jnp.stack([jnp.zeros_like(kick), kick]))
        found: Array = jnp.linalg.norm(pair[1] - pair[0])
        return found


class TangentRows(Pytree):
    """How impulses change with the velocities: `curvature` of the energy in H, with H = ... + `reach` grad v."""

    domains: Domains
    rotation: Array
    reach: Any
    curvature: Curvature


def law_rows(domains: Domains, stage: Stage, material: LawMaterial, rotation: Matrix3) -> LawRows:
    """Rows of one step, made at its `stage`; `rotation`: of the domains at its base."""
    reach, follow, weight = stage.numbers(domains.row_nodes)
    own, later, _ = stage.numbers(domains.cells[:, 0])
    known = displacement_gradient(domains, stage.base)
    if stage.ahead is not None:
        known = known + array_of(domain_gradient(domains, stage.ahead))
    before = None if stage.before is None else array_of(domain_gradient(domains, stage.before))
    frames = array_of(rotation)
    shares = follow / reach if domains.volumetric else later / own
    drag = Drag(frames, known, before, shares)
    return LawRows(domains, material, drag, known, own, weight / reach, frames, stage.base.shape[0])
