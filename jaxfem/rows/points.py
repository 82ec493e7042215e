"""Sparse rows: each block of rows couples a few triples of the unknown. Joints, limits, motors, contacts, friction."""

from collections import OrderedDict
from collections.abc import Mapping

import jax
import jax.numpy as jnp

from jaxfem.indexing import gather, scatter_add, with_last
from jaxfem.pytrees import Pytree, static
from jaxfem.tensors import contract, taken

Array = jax.Array


class PointRows(Pytree):
    """m blocks of r rows over k triples each; arrays of shape (m, r).

    `triples` (m, k): which triples of the unknown (n, 3) a block couples, 0 to n - 1, repeats allowed (those of a joint
    may count from the end, see `counted`); `jacobian` (m, r, 3 k):
    the rows' coefficients, a triple's side by side; `compliance` (m, r) >= 0; `bias` (m, r), c of J v + C lam - c;
    `lower`, `upper` (m, r) or None when none of these rows is bounded. A row that is off has lower = upper = 0.
    `unknowns`: n, the number of triples in all.
    """

    triples: Array
    jacobian: Array
    compliance: Array
    bias: Array
    unknowns: int = static()
    lower: Array | None = None
    upper: Array | None = None

    @property
    def bounds(self) -> tuple[Array, Array] | None:
        """lower and upper, (m, r), or None."""
        return None if self.lower is None or self.upper is None else (self.lower, self.upper)

    def counted(self) -> "PointRows":
        """The same with triples that count from the end, as in NumPy, counted from the start: those of users may."""
        from_end = self.triples < 0
        return self.replace(triples=jnp.where(from_end, self.triples + self.unknowns, self.triples).astype(jnp.int32))

    def apply(self, velocities: Array) -> Array:
        """J v: (n, 3) -> (m, r). One small dense product a block."""
        return contract("mrk,mk->mr", self.jacobian, taken(velocities, self.triples))

    def apply_transpose(self, impulses: Array) -> Array:
        """J' lam: (m, r) -> (n, 3)."""
        parts = contract("mrk,mr->mk", self.jacobian, impulses).reshape(*self.triples.shape, 3)
        return scatter_add(parts, self.triples, self.unknowns)

    def diagonal(self, inverse_mass: Array, inverse_inertia: Array | None = None) -> Array:
        """Diagonal of J M^-1 J': (m, r). Repeated triples are summed first.

        `inverse_mass` (n,); `inverse_inertia` (b, 3, 3) adds blocks on the last b triples, whose scalars are then zero.
        """
        m, r, _ = self.jacobian.shape
        parts = self.jacobian.reshape(m, r, -1, 3)
        same = self.triples[:, :, None] == self.triples[:, None, :]
        if inverse_inertia is not None:
            scalars = inverse_mass[:, None, None] * jnp.eye(3, dtype=inverse_mass.dtype)
            blocks = gather(with_last(scalars, inverse_inertia), self.triples)
            return contract("mrai,maij,mrbj,mab->mr", parts, blocks, parts, same.astype(parts.dtype))
        same = same * gather(inverse_mass, self.triples)[:, :, None]
        return contract("mrai,mrbi,mab->mr", parts, parts, same)


def rates(groups: Mapping[str, PointRows], velocities: Array) -> OrderedDict[str, Array]:
    """J v of all groups, (m, r) each, of velocities (n, 3): what they need is taken from these at once."""
    ends, at, found = taken(velocities, _triples(groups)), 0, OrderedDict[str, Array]()
    for name, rows in groups.items():
        m, k = rows.triples.shape
        found[name] = contract("mrk,mk->mr", rows.jacobian, ends[at : at + 3 * m * k].reshape(m, 3 * k))
        at += 3 * m * k
    return found


def pushes(groups: Mapping[str, PointRows], impulses: Mapping[str, Array]) -> Array:
    """The sum of J' lam of all groups, (n, 3), of impulses (m, r) each: added up at once."""
    parts = (contract("mrk,mr->mk", rows.jacobian, impulses[name]) for name, rows in groups.items())
    unknowns = next(iter(groups.values())).unknowns
    return scatter_add(jnp.concatenate([part.reshape(-1, 3) for part in parts]), _triples(groups), unknowns)


def _triples(groups: Mapping[str, PointRows]) -> Array:
    return jnp.concatenate([rows.triples.reshape(-1) for rows in groups.values()])
