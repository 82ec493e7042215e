"""Geometry of a box lower <= x <= upper, block by block: blocks without bounds cost nothing."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxfem.pytrees import Pytree


class Box(Pytree):
    """Bounds of an unknown's blocks (the leaves of its pytree): arrays of the block's shape, or None for no bound."""

    lower: tuple[Array | None, ...]
    upper: tuple[Array | None, ...]

    @property
    def bounded(self) -> bool:
        """Whether any block has a bound: known while tracing."""
        return any(bound is not None for bound in self.lower)

    def each(self, bounded: Callable[..., Any], unbounded: Callable[..., Any], *vectors: Any) -> list[Any]:
        """bounded(lower, upper, *blocks) for each block with bounds, unbounded(*blocks) for each other, in order."""
        rows = zip(self.lower, self.upper, *map(jax.tree.leaves, vectors), strict=True)
        return [unbounded(*blocks) if low is None else bounded(low, up, *blocks) for low, up, *blocks in rows]

    def clip(self, x: Any) -> Any:
        """The nearest point of the box."""
        blocks = self.each(lambda low, up, v: jnp.minimum(jnp.maximum(v, low), up), lambda v: v, x)
        return jax.tree.unflatten(jax.tree.structure(x), blocks)

    def contains(self, x: Any) -> Array:
        """Whether x satisfies every bound (false where it is NaN)."""
        inside = self.each(lambda low, up, v: jnp.all((low <= v) & (v <= up)), lambda v: None, x)
        return jnp.stack([v for v in inside if v is not None]).all()

    def feasible(self) -> Array:
        """Whether lower <= upper everywhere (false where a bound is NaN)."""
        pairs = zip(self.lower, self.upper, strict=True)
        orders = [jnp.all(low <= up) for low, up in pairs if low is not None and up is not None]
        return jnp.stack(orders).all() if orders else jnp.bool_(True)

    def split(self, x: Any, g: Any) -> tuple[Any, Any]:
        """The gradient's free part (inside the box) and chopped part (at a bound, and pulling away from it)."""
        parts = self.each(_split, lambda v, h: (h, jnp.zeros_like(h)), x, g)
        tree = jax.tree.structure(x)
        return jax.tree.unflatten(tree, [p[0] for p in parts]), jax.tree.unflatten(tree, [p[1] for p in parts])

    def divided(self, scaling: Any) -> "Box":
        """The same box in variables y = x / scaling, scaling > 0."""
        leaves = jax.tree.leaves(scaling)
        lower, upper = (
            tuple(None if bound is None else bound / s for bound, s in zip(side, leaves, strict=True))
            for side in (self.lower, self.upper)
        )
        return Box(lower, upper)

    def undivided(self, y: Any, scaling: Any, divided: "Box") -> Any:
        """x = scaling y, an entry at a bound of the divided box put exactly on its own, whatever the rounding."""

        def place(low: Array, up: Array, v: Array, s: Array, at_low: Array, at_up: Array) -> Array:
            return jnp.where(at_low, low, jnp.where(at_up, up, jnp.minimum(jnp.maximum(v * s, low), up)))

        tree = jax.tree.structure(y)
        lows = divided.each(lambda low, up, v: v <= low, lambda v: v, y)
        ups = divided.each(lambda low, up, v: v >= up, lambda v: v, y)
        masks = jax.tree.unflatten(tree, lows), jax.tree.unflatten(tree, ups)
        return jax.tree.unflatten(tree, self.each(place, lambda v, s, *_: v * s, y, scaling, *masks))

    def weak(self, x: Any, g: Any, threshold: Array) -> Array:
        """How many entries are at a bound, to within the threshold, with a gradient of no more than the threshold."""
        counts = self.each(partial(_weak, threshold), lambda v, h: None, x, g)
        total: Array = sum((c for c in counts if c is not None), start=jnp.int32(0))
        return total


def where_at(low: Array, up: Array, x: Array) -> tuple[Array, Array, Array]:
    """Masks of the entries at the lower bound only, at the upper only, and at neither (equal bounds are in none)."""
    at_low, at_up = x <= low, x >= up
    return at_low & ~at_up, at_up & ~at_low, ~(at_low | at_up)


def _split(low: Array, up: Array, x: Array, g: Array) -> tuple[Array, Array]:
    at_low, at_up, free = where_at(low, up, x)
    chopped = jnp.where(at_low, jnp.minimum(g, 0), jnp.where(at_up, jnp.maximum(g, 0), 0))
    return jnp.where(free, g, 0), chopped


def _weak(threshold: Array, low: Array, up: Array, x: Array, g: Array) -> Array:
    touching = (jnp.minimum(x - low, up - x) <= threshold) & (jnp.abs(g) <= threshold) & (low < up)
    return jnp.sum(touching, dtype=jnp.int32)


def make_box(like: Any, lower: Any, upper: Any) -> Box:
    """Box around a pytree: a bound is None, a scalar, or a pytree of its structure with None for blocks without one."""
    leaves = jax.tree.leaves(like)
    tree: Any = jax.tree.structure(like)

    def blocks(bound: Any) -> list[Any]:
        scalar = jax.tree_util.all_leaves([bound]) and jnp.ndim(bound) == 0
        return [bound] * len(leaves) if bound is None or scalar else tree.flatten_up_to(bound)

    def pair(block: Array, low: Any, up: Any) -> tuple[Array | None, Array | None]:
        if low is None and up is None:
            return None, None
        bounds = (-jnp.inf if low is None else low, jnp.inf if up is None else up)
        low, up = (jnp.broadcast_to(jnp.asarray(bound, block.dtype), block.shape) for bound in bounds)
        return low, up

    pairs = [pair(*row) for row in zip(leaves, blocks(lower), blocks(upper), strict=True)]
    return Box(tuple(p[0] for p in pairs), tuple(p[1] for p in pairs))
