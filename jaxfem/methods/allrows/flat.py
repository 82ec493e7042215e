"""All groups of rows one after the other: vectors (R,) in place of a table of groups, and one product for all.

What is said of each group by itself is compiled for each; of a small scene, compiling is most of what a run costs.
"""

from collections import OrderedDict
from collections.abc import Mapping

import jax
import jax.numpy as jnp

from jaxfem.methods.allrows.operator import RowOperator
from jaxfem.pytrees import Pytree
from jaxfem.rows.bounds import Bounds, Impulses, named
from jaxfem.rows.points import PointRows, pushes, rates
from jaxfem.system.coupled import apply_inverse_mass
from jaxfem.system.soft import System

Array = jax.Array
FlatBounds = tuple[Array, Array]


class FlatRows(Pytree):
    """The rows of all groups, R in all, group by group as each lies in memory.

    `compliance`, `bias`, `right` = b and `diagonal` of A, (R,): see `RowOperator`.
    """

    groups: OrderedDict[str, PointRows]
    compliance: Array
    bias: Array
    right: Array
    diagonal: Array
    inverse: tuple[Array, Array | None]

    def apply(self, velocities: Array) -> Array:
        """J v: (n, 3) -> (R,)."""
        return flat(rates(self.groups, velocities))

    def apply_transpose(self, impulses: Array) -> Array:
        """J' lam: (R,) -> (n, 3)."""
        return pushes(self.groups, self.split(impulses))

    def moved(self, impulses: Array) -> Array:
        """M^-1 J' lam, (n, 3)."""
        return apply_inverse_mass(self.inverse, self.apply_transpose(impulses))

    def product(self, impulses: Array) -> Array:
        """A lam, (R,)."""
        return self.apply(self.moved(impulses)) + self.compliance * impulses

    def split(self, values: Array) -> Impulses:
        """Values (R,) group by group."""
        return split(values, {name: rows.bias for name, rows in self.groups.items()})


def flat_rows(system: System, operator: RowOperator) -> FlatRows:
    """The rows of a system of rigid bodies, with what their operator knows of them."""
    groups = system.extra
    compliance, bias = (flat({n: getattr(r, part) for n, r in groups.items()}) for part in ("compliance", "bias"))
    return FlatRows(groups, compliance, bias, flat(operator.right), flat(operator.diagonal), operator.inverse)


def flat(values: Mapping[str, Array]) -> Array:
    """Values of all groups one after the other, (R,): in the order of the table, which is the system's everywhere."""
    return jnp.concatenate([each.reshape(-1) for each in values.values()])


def split(values: Array, like: Mapping[str, Array]) -> Impulses:
    """Values (R,) as a table of groups of the shapes of `like`."""
    at, parts = 0, []
    for each in like.values():
        parts.append(values[at : at + each.size].reshape(each.shape))
        at += each.size
    return named(like, parts)


def flat_bounds(bounds: Bounds, like: Mapping[str, Array]) -> FlatBounds | None:
    """Bounds (R,) of all rows, infinite where a group has none; None where no group has any."""
    low, up = bounds
    if all(each is None for each in low.values()):
        return None

    def side(own: Mapping[str, Array | None], none: float) -> Array:
        whole = ((jnp.full_like(each, none) if (b := own[name]) is None else b) for name, each in like.items())
        return jnp.concatenate([each.reshape(-1) for each in whole])

    return side(low, -jnp.inf), side(up, jnp.inf)
