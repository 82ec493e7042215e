"""Friction in the true cone, for rows that keep their impulses beside the nodes' matrix."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from jaxfem.rows.bounds import Impulses, friction_radii, into_disc, named
from jaxfem.rows.points import PointRows
from jaxfem.system.soft import System, inverse_mass

Array = jax.Array

SLIDES = 1e-6
"""Of the cone's radius: how near to it a pair of impulses slides."""


def width(system: System, rows: PointRows) -> Array:
    """Effective inverse mass (m, 1) of blocks of rows, the same for all rows of a block; not differentiated."""
    diagonal = rows.diagonal(*inverse_mass(system)) + rows.compliance
    return jax.lax.stop_gradient(jnp.max(diagonal, -1, keepdims=True))


def wished_impulses(system: System, impulses: Impulses, slack: Sequence[Array]) -> Impulses:
    """What impulses would be if nothing bounded them, each block taken alone; `slack`: c - J v of all of them."""
    parts = zip(impulses.values(), slack, system.extra.values(), strict=True)
    return named(impulses, (z + (s - each.compliance * z) / width(system, each) for z, s, each in parts))


def cone_residual(lam: Array, between: Array, radius: Array, wide: Array) -> Array:
    """Zero where pairs (m, 2) are those of the true cone: lam = P(lam + between / D), P the projection on the disc.

    Scaled as rows between their bounds where they stick, as rows at a bound where they slide.
    """
    wished = lam + between / wide
    off = into_disc(wished, radius) - lam
    slides = jax.lax.stop_gradient(jnp.sum(wished**2, -1) > radius**2)[:, None]
    return jnp.where(slides, -off, wide * off)


def sliding(system: System, impulses: Impulses, sides: Impulses) -> Impulses:
    """`sides` with pairs in a cone at a bound, both rows, where they slide, whatever their direction."""
    found = sides.copy()
    for name, each in system.friction.items():
        if each.cone:
            radius = friction_radii(system.friction, impulses)[name]
            length = jnp.linalg.norm(impulses[name], axis=-1, keepdims=True)
            found[name] = jnp.broadcast_to(length >= (1 - SLIDES) * radius, sides[name].shape).astype(jnp.int32)
    return found
