"""Bounded rows as semismooth Newton sees them: their numbers beside J, and what follows from slack and centre alone."""

import jax
import jax.numpy as jnp

from jaxfem.pytrees import Pytree
from jaxfem.solvers import trees

Array = jax.Array
Blocks = tuple[Array, ...]
Bounds = tuple[tuple[Array | None, ...], tuple[Array | None, ...]]


class RowTerms(Pytree):
    """What goes with J, an entry a kind of rows: `slack` c - J x at the start, `compliance` C, bounds `lower` and
    `upper` (None: unbounded), `start` impulses, `local` compliance of the rows' own nodes, diag(J D^-1 J') with D the
    quadratic's diagonal blocks, `active`: masks (None: all) outside of which rows are left out."""

    slack: Blocks
    compliance: Blocks
    lower: tuple[Array | None, ...]
    upper: tuple[Array | None, ...]
    start: Blocks
    local: Blocks
    active: tuple[Array | None, ...]

    def softened(self, share: Array) -> Blocks:
        """Compliance of at least `share` of the nodes' own."""
        soft = (jnp.maximum(c, share * w) for c, w in zip(self.compliance, self.local, strict=True))
        return tuple(jnp.where(q > 0, q, 1) for q in soft)

    def within(self, bounds: Bounds) -> "RowTerms":
        """The same with other bounds."""
        return self.replace(lower=bounds[0], upper=bounds[1])

    def raw(self, slack: Blocks, centre: Blocks, soft: Blocks) -> Blocks:
        """Impulses without bounds, (slack + (soft - C) centre) / soft."""
        rows = zip(slack, centre, soft, self.compliance, strict=True)
        return tuple((s + (q - c) * z) / q for s, z, q, c in rows)

    def bounded(self, raw: Blocks) -> Blocks:
        """The nearest impulses within the bounds; zero for rows left out."""
        rows = zip(raw, self.lower, self.upper, self.active, strict=True)
        clipped = ((r if low is None else jnp.clip(r, low, up), on) for r, low, up, on in rows)
        return tuple(r if on is None else jnp.where(on, r, 0) for r, on in clipped)

    def inside(self, raw: Blocks) -> Blocks:
        """Masks of the rows strictly within their bounds."""
        rows = zip(raw, self.lower, self.upper, self.active, strict=True)
        inside = (
            (jnp.ones(r.shape, bool) if low is None or up is None else (low < r) & (r < up), on)
            for r, low, up, on in rows
        )
        return tuple(mask if on is None else mask & on for mask, on in inside)

    def violation(self, slack: Blocks, impulses: Blocks) -> Blocks:
        """By how much impulses are off, each row taken alone: lam - clip(lam + (slack - C lam) / (local + C))."""
        rows = zip(impulses, slack, self.compliance, self.local, strict=True)
        wished = tuple(z + (s - c * z) / (w + c) for z, s, c, w in rows)
        return trees.minus(impulses, self.bounded(wished))
