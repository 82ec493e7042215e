"""Domains of laws that are not linear in a step: energy of the deformation gradient, its slope and its curvature.

A domain's stress impulse is the slope P = V dW/dF, its force on node a is -P grad N_a. Domains that take shape alone
have the energy of distortion, volumetric ones K/2 theta^2, clusters of these that of their mean theta: the same shares
of K on nodes and on clusters as the rows of linear laws have (see `bulk_shares`).
"""

from typing import Any, ClassVar, TypeGuard

import jax
import jax.numpy as jnp

from jaxfem.elements.domains import DomainMaterial, Domains, domain_gradient, domain_material, domain_mean, row_means
from jaxfem.indexing import scatter_add
from jaxfem.materials.nonlinear import Nonlinear
from jaxfem.materials.principal import slope_of, tangent_of
from jaxfem.pytrees import Pytree
from jaxfem.tensors import (
    EIGENBASIS,
    Matrix3,
    array_of,
    contract,
    determinant,
    matrix_of,
    product,
    symmetric,
    to_eigenbasis,
    transposed,
)

Array = jax.Array


class LawMaterial(DomainMaterial):
    """The material of domains whose law is not linear: its stiffness at rest, the `values` of its constants, () or one
    a set of rows, what is remembered (`internal`), and the time `dt` [s] since then, None at rest."""

    values: Any = None
    internal: Any = None
    dt: Any = None
    linear: ClassVar[bool] = False

    def bulk(self, domains: Domains) -> Any:
        """K of what the domains' energy takes of changes of volume, None where it takes none [Pa]."""
        if domains.rows.start > 0:
            return None
        return self.volumetric / 3


class Drag(Pytree):
    """The viscous stress D beta de/dt of a step, with the strain e in the frame that the step began with.

    `rotation` (3, 3, D); `known` (3, 3, D): H where the end-of-step velocities are zero; `before` (3, 3, D) [1/s]: rate
    that is known, None for zero; `share` [1/s]: the rate is before + share (H - known).
    """

    rotation: Array
    known: Array
    before: Array | None
    share: Any

    def rate(self, gradient: Array) -> Array:
        """dH/dt (3, 3, D)."""
        change: Array = self.share * (gradient - self.known)
        return change if self.before is None else change + self.before


class Curvature(Pytree):
    """The second derivative of a kind's energy in F: `whole` (9, 9, D); or of volumetric domains, with slopes `slope`
    (3, 3, D) of theta, weight slope slope' with `weight` (D,), or on means with (C,), and `bend` (9, 9, D)."""

    whole: Array | None = None
    slope: Array | None = None
    weight: Array | None = None
    bend: Array | None = None


def law_of(domains: Domains) -> Nonlinear:
    """The domains' law, which is not linear."""
    assert isinstance(domains.law, Nonlinear)
    return domains.law


def of_energy(material: DomainMaterial) -> TypeGuard[LawMaterial]:
    """Whether a material's law is not linear in a step, so that stress and tangent come of its energy."""
    return not material.linear


def material_of(domains: Domains, values: Any) -> DomainMaterial:
    """The material of domains from the elements' `values`; with a nonlinear law its stiffness is that at rest."""
    material = domain_material(domains, values)
    if domains.law.linear:
        return material
    own = {each.name: domain_mean(domains, values[each.name]) for each in domains.law.constants}
    return LawMaterial(material.volumetric, material.deviatoric, material.damping, None, own)


def displacement_gradient(domains: Domains, positions: Array) -> Array:
    """H = F - I of each domain at `positions` (n, 3): (3, 3, D)."""
    one = jnp.eye(3, dtype=positions.dtype)[:, :, None]
    return array_of(domain_gradient(domains, positions)) - one


def densities(domains: Domains, material: LawMaterial, drag: Drag | None, gradient: Array) -> Array:
    """Energy densities at H `gradient` (3, 3, D), with the potential of the drag: (D,), or (C,) with clusters."""
    law = law_of(domains)
    if domains.volumetric:
        theta = _theta(domains, gradient)
        square = theta**2
        if drag is not None:
            rate = drag.share * (theta - _theta(domains, drag.known)) + _known_rate(domains, drag)
            square = square + material.damping / drag.share * rate**2
        volumetric: Array = 0.5 * material.bulk(domains) * square
        return volumetric
    energy = law.density(material.values, material.bulk(domains), gradient, material.internal, material.dt)
    return energy if drag is None else energy + _drag_density(domains, material, drag, gradient)


def energy(domains: Domains, material: LawMaterial, drag: Drag | None, gradient: Array, scale: Any = 1.0) -> Array:
    """Sum of the energies of all domains, () [J], times `scale`, () or one a set of rows."""
    total: Array = jnp.sum(scale * domains.row_volumes * densities(domains, material, drag, gradient))
    return total


def slope(domains: Domains, material: LawMaterial, drag: Drag | None, gradient: Array, scale: Any = 1.0) -> Array:
    """P = dE/dF of each domain, (3, 3, D)."""
    found: Array = jax.grad(lambda h: energy(domains, material, drag, h, scale))(gradient)
    return found


def curvature(
    domains: Domains, material: LawMaterial, drag: Drag | None, gradient: Array, definite: Any, scale: Any = 1.0
) -> Curvature:
    """The second derivative of the energy; `definite`: the share () of its way to its definite neighbour, 0 to 1.

    As a number of Python, 0 and 1 have programs of their own.
    """
    law = law_of(domains)
    if domains.volumetric:
        return _volumetric_curvature(domains, material, drag, gradient, definite, scale)
    volumes = scale * domains.volumes
    terms = (material.values, material.bulk(domains))
    rest = (material.internal, material.dt)
    whole = tangent_of(lambda h: law.density(*terms, h, *rest), gradient)
    if not isinstance(definite, int) or definite:

        def moved(exact: Array) -> Array:
            found: Array = exact + definite * (law.definite(exact, *terms, gradient, *rest) - exact)
            return found

        whole = jax.lax.cond(definite > 0, moved, lambda exact: exact, whole)
    if drag is not None:
        whole = whole + _drag_tangent(domains, material, drag)
    return Curvature(volumes * whole)


def _volumetric_curvature(
    domains: Domains, material: LawMaterial, drag: Drag | None, gradient: Array, definite: Any, scale: Any
) -> Curvature:
    law, volumes = law_of(domains), scale * domains.row_volumes

    def dilation(h: Array) -> Array:
        return law.dilation(matrix_of(h))

    stiffness = volumes * material.bulk(domains)
    theta = _theta(domains, gradient)
    pressure, weight = stiffness * theta, stiffness
    if drag is not None:
        rate = drag.share * (theta - _theta(domains, drag.known)) + _known_rate(domains, drag)
        pressure = pressure + stiffness * material.damping * rate
        weight = stiffness * (1 + material.damping * drag.share)
    along = slope_of(dilation, gradient)
    if isinstance(definite, int) and definite == 1:
        return Curvature(slope=along, weight=weight)
    spread = pressure if domains.clusters is None else domains.clusters.spread(pressure)
    return Curvature(slope=along, weight=weight, bend=(1 - definite) * spread * tangent_of(dilation, gradient))


def force(domains: Domains, stress: Array, nodes: int) -> Array:
    """Nodal sums (nodes, 3) of P grad N_a, with P (3, 3, D)."""
    g = domains.gradients
    others = sum((stress[None, :, j] * g[1:, None, j] for j in (1, 2)), start=stress[None, :, 0] * g[1:, None, 0])
    # The first node takes the reaction, so that forces sum to zero to the last digit.
    forces = jnp.concatenate([-jnp.sum(others, axis=0, keepdims=True), others]).transpose(2, 0, 1)
    return scatter_add(forces, domains.cells, nodes)


def response(domains: Domains, positions: Array, material: LawMaterial) -> tuple[Array, Array]:
    """Energy () [J] and force on the nodes (n, 3) [N] at `positions` (n, 3)."""
    gradient = displacement_gradient(domains, positions)
    stress = slope(domains, material, None, gradient)
    return energy(domains, material, None, gradient), force(domains, -stress, positions.shape[0])


def cauchy_stress(domains: Domains, positions: Array, material: LawMaterial, rotation: Matrix3) -> Array:
    """R' P F' R / det F of each domain's own share, six coefficients (6, D) in the eigenbasis [Pa]."""
    gradient = displacement_gradient(domains, positions)
    stress = slope(domains, material, None, gradient) / domains.volumes
    deformation = matrix_of(gradient + jnp.eye(3, dtype=gradient.dtype)[:, :, None])
    pulled = product(matrix_of(stress), transposed(deformation))
    turned = symmetric(product(product(transposed(rotation), pulled), rotation))
    return jnp.stack(to_eigenbasis(turned)) / determinant(deformation)


def viscous_response(
    domains: Domains, positions: Array, velocities: Array, material: LawMaterial, rotation: Matrix3
) -> Array:
    """Force on the nodes (n, 3) [N] at `positions` and `velocities` (n, 3), with that of the viscous stress."""
    gradient = displacement_gradient(domains, positions)
    drag = Drag(array_of(rotation), gradient, array_of(domain_gradient(domains, velocities)), 1.0)
    return force(domains, -slope(domains, material, drag, gradient), positions.shape[0])


def _theta(domains: Domains, gradient: Array) -> Array:
    return row_means(domains, [law_of(domains).dilation(matrix_of(gradient))])[0]


def _known_rate(domains: Domains, drag: Drag) -> Any:
    """Rate of theta (D,) or (C,) that the known velocities give."""
    if drag.before is None:
        return 0.0
    law = law_of(domains)
    rate = jax.jvp(lambda h: law.dilation(matrix_of(h)), (drag.known,), (drag.before,))[1]
    return row_means(domains, [rate])[0]


def _drag_density(domains: Domains, material: LawMaterial, drag: Drag, gradient: Array) -> Array:
    """beta / (2 share) de/dt' D de/dt, whose slope in F is the viscous stress."""
    rate = symmetric(product(transposed(matrix_of(drag.rotation)), matrix_of(drag.rate(gradient))))
    rows = to_eigenbasis(rate)[domains.rows]
    square = sum(
        (w * r * r for w, r in zip(material.weights(domains), rows, strict=True)), start=jnp.zeros_like(rows[0])
    )
    density: Array = 0.5 * material.damping / drag.share * square
    return density


def _drag_tangent(domains: Domains, material: LawMaterial, drag: Drag) -> Array:
    """Second derivative (9, 9, D) of `_drag_density`: beta share B' D B, with B the rows of sym(R' dF)."""
    basis = jnp.asarray(EIGENBASIS[domains.rows], drag.rotation.dtype)
    rows = contract("ikd,rkj->rijd", drag.rotation, basis).reshape(len(basis), 9, -1)
    weights = jnp.stack([jnp.broadcast_to(w, rows.shape[-1:]) for w in material.weights(domains)])
    return contract("rad,rd,rbd->abd", rows, material.damping * drag.share * weights, rows)
