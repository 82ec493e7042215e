"""The exact tangent of the corotated energy at a shape, and a preconditioner from its warped, definite neighbour."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp

from jaxfem.methods.nodes.assembly import BlockMatrix, assemble_tangent
from jaxfem.methods.nodes.preconditioner import coarse_inverse, rigid_modes, two_level
from jaxfem.model import Model, Params, domain_materials

Array = jax.Array


def tangent_and_preconditioner(
    model: Model,
    params: Params,
    positions: Array,
    rotations: Sequence[Array],
    diagonal: Array,
    shift: Array | None = None,
) -> tuple[BlockMatrix, Callable[[Array], Array]]:
    """The Hessian at `positions` (n, 3) and r -> roughly its inverse times r, both in solver order.

    `rotations` (3, 3, D) of each kind of domains; `diagonal` (n,) is added to both, `shift` (n,) to what is inverted.
    """
    materials = domain_materials(model, params)

    def matrix(exact: bool, extra: Array) -> BlockMatrix:
        return assemble_tangent(model.domains, positions, rotations, materials, extra, model.free, model.pattern, exact)

    warped = matrix(False, diagonal if shift is None else diagonal + shift)
    turning = [r for r, each in zip(rotations, model.domains, strict=True) if not each.volumetric]
    modes = rigid_modes(model.pattern, positions, model.free, jnp.concatenate(turning, axis=-1))
    return matrix(True, diagonal), two_level(warped, modes, coarse_inverse(warped, modes))
