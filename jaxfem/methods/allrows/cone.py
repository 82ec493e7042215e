"""Rows put back where they may be: into their bounds, and pairs of friction rows into the discs of the true cone."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp

from jaxfem.rows.bounds import Impulses, into_disc, named
from jaxfem.system.soft import System

Array = jax.Array


def projected_step(
    system: System, impulses: Mapping[str, Array], gradient: Mapping[str, Array], diagonal: Mapping[str, Array]
) -> Impulses:
    """lam - D^-1 gradient put back into its bounds, and into discs of radius mu lam_n for friction."""

    def moved(name: str) -> Array:
        lam, own = impulses[name], diagonal[name]
        if name in system.friction:
            each = system.friction[name]
            step = lam - gradient[name] / jnp.max(own, -1, keepdims=True)
            return into_disc(step, each.coefficient * jnp.maximum(impulses[each.normal][:, 0], 0))
        step, bounds = lam - gradient[name] / own, system.rows[name].bounds
        return step if bounds is None else jnp.clip(step, *bounds)

    return named(impulses, map(moved, impulses))
