"""Candidate pairs of a contact, fixed in number: what each kind of partners says of itself, and where its pairs are."""

from typing import Any

import jax

from jaxfem.batching import one_trace
from jaxfem.pytrees import Pytree, static
from jaxfem.rows.attachments import Configuration, Placed

Array = jax.Array


class Pairs(Pytree):
    """m candidates: `gap` (m,) [m], `normal` (m, 3) from b to a, and a's velocity less b's (its position is unused)."""

    gap: Array
    normal: Array
    relative: Placed


class Candidates(Pytree):
    """m candidate pairs of one kind. A subclass also has `margin` (m,) [m], the distance from which a pair takes part,
    and the static flag `rough`, whether they have friction rows.

    `names` (m): the contacts that they are of; `cone`: whether friction is held in the true cone, else in a pyramid.
    """

    names: tuple[str, ...] = static(default=(), kw_only=True)
    cone: bool = static(default=False, kw_only=True)

    @property
    def kind(self) -> str:
        """Words for the kinds of partners."""
        raise NotImplementedError

    @property
    def alone(self) -> bool:
        """Whether they cannot share a group with those of another contact."""
        return False

    @property
    def give(self) -> float:
        """Least compliance of their rows, as a share of what a unit impulse moves soft nodes by; 0: the solver's."""
        return 0.0

    @property
    def slip(self) -> float:
        """That of friction rows, as a share of what it moves both sides by: so what sticks creeps."""
        return 0.0

    @property
    def deepest(self) -> Array | None:
        """How deep (m,) [m] pairs may be: beyond, they are coming through. None where that is not watched."""
        return None

    def pairs(self, at: Configuration) -> Pairs:
        """Where they are."""
        raise NotImplementedError


@one_trace
def pairs_of(candidates: Any, at: Configuration) -> Pairs:
    """Where the pairs of `candidates` are: one trace for all scenes with as many of their kind."""
    found: Pairs = candidates.pairs(at)
    return found
