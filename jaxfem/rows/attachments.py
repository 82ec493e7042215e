"""Where joints and contacts hold on: material points and frames of rigid bodies, soft bodies and the world.

The unknown is a stack of triples: the n nodes, then the b rigid bodies' linear velocities, then their angular ones.
An attachment says where its point is and how its velocity follows from a few triples:  velocity = jacobian v[triples].
"""

from typing import Any, Protocol

import jax
import jax.numpy as jnp

from jaxfem.elements.barycentric import barycentric
from jaxfem.indexing import gather
from jaxfem.pytrees import Pytree, static
from jaxfem.tensors import contract, skew

Array = jax.Array


class Configuration(Pytree):
    """Positions at the start of a step: nodes (n, 3), rigid centres (b, 3) and rotations (b, 3, 3) body to world.

    `dropped` (n + 2 b, 3) [m]: digits that rounding has dropped of all that (see `Carry`), None where none are kept.
    """

    nodes: Array
    centers: Array
    rotations: Array
    dropped: Array | None = None

    @property
    def unknowns(self) -> int:
        """Number of triples in all."""
        return self.nodes.shape[0] + 2 * self.centers.shape[0]

    def linear(self, body: Array) -> Array:
        """Triples of bodies' linear velocities."""
        return self.nodes.shape[0] + body

    def angular(self, body: Array) -> Array:
        """Triples of bodies' angular velocities."""
        return self.nodes.shape[0] + self.centers.shape[0] + body


class Reshaping(Pytree):
    """Rest positions `before` and `after` (n, 3) [m], and how rigid bodies stand at the start, `turns` (b, 3, 3)."""

    before: Array
    after: Array
    turns: Array


class Placed(Pytree):
    """Points in the world: `position` (m, 3), and their velocity as `jacobian` (m, 3, 3 k) on `triples` (m, k)."""

    position: Array
    triples: Array
    jacobian: Array


class Point(Protocol):
    """m attached points of one kind."""

    @property
    def kind(self) -> str:
        """Word for the kind, part of a group's name."""

    def placed(self, at: Configuration) -> Placed:
        """Where they are."""

    def drift(self, change: Reshaping) -> Array | None:
        """How far (m, 3) [m] a new rest shape takes them; None where they are no part of one."""

    def carried(self, by: Array, change: Reshaping) -> "Point":
        """Points `by` (m, 3) [m] from where these were at the start, in the world."""


class RigidPoint(Pytree):
    """Points fixed in rigid bodies: `body` (m,), `local` (m, 3) from the centre of mass in the body's frame."""

    body: Any
    local: Any
    kind: str = static(default="rigid")

    def placed(self, at: Configuration) -> Placed:
        """Centre plus the turned arm r; velocity v + w x r."""
        arm = self.arm(at)
        return moving_with_body(at, self.body, gather(at.centers, self.body) + arm)

    def arm(self, at: Configuration) -> Array:
        """From the centre of mass to the point, in the world frame (m, 3)."""
        return contract("mij,mj->mi", gather(at.rotations, self.body), self.local)

    def drift(self, change: Reshaping) -> None:
        """They stay."""

    def carried(self, by: Array, change: Reshaping) -> "RigidPoint":
        """Other points of the same bodies."""
        return self.replace(local=self.local + contract("mji,mj->mi", change.turns[self.body], by))


class SoftPoint(Pytree):
    """Points in soft bodies: weighted means of `nodes` (m, k), weights (m, k) of sum 1."""

    nodes: Any
    weights: Any
    kind: str = static(default="soft")

    def placed(self, at: Configuration) -> Placed:
        """The same mean of positions and of velocities."""
        m, k = self.nodes.shape
        spread = self.weights[:, None, :, None] * jnp.eye(3, dtype=self.weights.dtype)[:, None, :]
        position = contract("mk,mki->mi", self.weights, gather(at.nodes, self.nodes))
        return Placed(position, self.nodes, spread.reshape(m, 3, 3 * k))

    def drift(self, change: Reshaping) -> Array:
        """They ride with their nodes."""
        return contract("mk,mki->mi", self.weights, (change.after - change.before)[self.nodes])

    def carried(self, by: Array, change: Reshaping) -> "SoftPoint":
        """Points of the same elements, k = 4; their weights in the new shape."""
        places = contract("mk,mki->mi", self.weights, change.before[self.nodes]) + by
        return self.replace(weights=barycentric(change.after[self.nodes], places))


class WorldPoint(Pytree):
    """Points at rest: `place` (m, 3)."""

    place: Any
    kind: str = static(default="world")

    def placed(self, at: Configuration) -> Placed:
        """No triple, no velocity."""
        m = self.place.shape[0]
        return Placed(self.place, jnp.zeros((m, 0), jnp.int32), jnp.zeros((m, 3, 0), self.place.dtype))

    def drift(self, change: Reshaping) -> None:
        """They stay."""

    def carried(self, by: Array, change: Reshaping) -> "WorldPoint":
        """Other places."""
        return self.replace(place=self.place + by)


def moving_with_body(at: Configuration, body: Array, position: Array) -> Placed:
    """World points (m, 3) as parts of rigid bodies (m,): velocity v + w x (position - centre)."""
    arm = position - gather(at.centers, body)
    identity = jnp.broadcast_to(jnp.eye(3, dtype=arm.dtype), (*arm.shape, 3))
    triples = jnp.stack([at.linear(body), at.angular(body)], -1)
    return Placed(position, triples, jnp.concatenate([identity, -skew(arm)], -1))


class RigidFrame(Pytree):
    """Frames fixed in rigid bodies: `body` (m,), `local` (m, 3, 3) with the axes in columns."""

    body: Any
    local: Any
    kind: str = static(default="rigid")

    def axes(self, at: Configuration) -> Array:
        """Axes in the world, in columns (m, 3, 3)."""
        return contract("mij,mjk->mik", gather(at.rotations, self.body), self.local)

    def spin(self, at: Configuration) -> tuple[Array, Array]:
        """Angular velocity as jacobian (m, 3, 3) on triples (m, 1)."""
        identity = jnp.broadcast_to(jnp.eye(3, dtype=self.local.dtype), self.local.shape)
        return at.angular(self.body)[:, None], identity


class WorldFrame(Pytree):
    """Frames at rest: `local` (m, 3, 3) with the axes in columns."""

    local: Any
    kind: str = static(default="world")

    def axes(self, at: Configuration) -> Array:
        """The axes themselves."""
        local: Array = self.local
        return local

    def spin(self, at: Configuration) -> tuple[Array, Array]:
        """No triple."""
        m = self.local.shape[0]
        return jnp.zeros((m, 0), jnp.int32), jnp.zeros((m, 3, 0), self.local.dtype)


Frame = RigidFrame | WorldFrame


def difference(a: Placed, b: Placed) -> Placed:
    """b's points less a's, with both's triples side by side."""
    return Placed(
        b.position - a.position,
        jnp.concatenate([a.triples, b.triples], -1),
        jnp.concatenate([-a.jacobian, b.jacobian], -1),
    )


def relative_spin(a: Frame, b: Frame, at: Configuration) -> tuple[Array, Array]:
    """Angular velocity of b less that of a: triples (m, k) and jacobian (m, 3, 3 k)."""
    (ta, ja), (tb, jb) = a.spin(at), b.spin(at)
    return jnp.concatenate([ta, tb], -1), jnp.concatenate([-ja, jb], -1)
