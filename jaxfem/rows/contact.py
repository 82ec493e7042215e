"""Contact and friction: candidate pairs of fixed number, each a normal row and, where it is rough, two tangential ones.

A normal row keeps the gap g of a pair from closing within the step (it acts before they touch, so nothing tunnels):
    J v - c  complementary to  lam >= 0,   c = -g / dt  for g >= 0,   -PUSH g / dt  for g < 0,
the latter at most the pair's `separation` speed, or c = -e (J v)_old, if larger, where an impact is due; where rigid
bodies meet, `system/impacts.py` knows better. Friction rows are bounded by mu times the normal impulse; the route sees
to that. A pair that meets after the share t of the step goes on freely until then: J v - t J v* = 0 where it sticks,
and what is left of its sliding, with what is left of the normal velocity, is the next step's. Pairs that cannot meet
are switched off by a zero row.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.indexing import gather
from jaxfem.materials.quantities import positive, share
from jaxfem.pytrees import Pytree, static
from jaxfem.ranges import within
from jaxfem.rows.attachments import Configuration, RigidPoint, SoftPoint, difference, moving_with_body
from jaxfem.rows.candidates import Candidates, Pairs, pairs_of
from jaxfem.rows.points import PointRows
from jaxfem.rows.triangles import areas_around
from jaxfem.tensors import contract, taken

Array = jax.Array

PUSH = 0.2
"""Share of a penetration that a step takes back."""
DEEP = 1e-3
"""Of the margin: pairs inside each other by more lose the speed with which they were moved apart."""
BURIED, OVERLAP = 0.1, 0.2
"""Of the margin: points of rigid bodies inside each other by more go apart in one direction, that of the bodies; and so
do corners where a point a little further inside of their own body is inside the other, by that share of the way."""
ASIDE, BESIDE = 0.01, 0.06
"""Of the way from a corner to its body's centre, and of the size of the surface around a soft body's node: how far
further inside of that body the other's normal is taken as well."""
LEVEL = 1e-4  # of that way: by how much it may be off by rounding
LEAN, LEANING = 0.05, (0.31, 0.52, 0.79)
"""Of the margin: how far bodies in one place are taken for apart, and in which direction, to tell where they part."""
SAID_AGAIN = 1e-3  # of what a unit impulse moves a row's soft nodes by: how far rows give that others nearly say too


class ContactValues(Pytree):
    """What users differentiate of m candidates: `friction` (m,), `restitution` (m,) and `separation` (m,) [m/s], the
    speed with which what is inside each other is moved apart at most."""

    friction: Any = dataclasses.field(metadata=within(low=0) | positive("friction", "", "friction", needs="rough"))
    restitution: Any = dataclasses.field(metadata=within(low=0, high=1) | share("restitution", "restitution"))
    separation: Any = dataclasses.field(metadata=within(low=0, open_low=True, infinite=True))


class Gaps(Pytree):
    """What one-sided rows (m, r) wait for: `gap` [m or rad] to their bound, and (m, 1) `restitution`, `near` [m], the
    gap below which they touch, and `brake` [m/s], the speed apart that they may take away, of what is deep."""

    gap: Array
    restitution: Array
    near: Array
    brake: Array | None = None


class ShapeContacts(Candidates):
    """Points of bodies against shapes that have a signed distance: rigid bodies' own, or ground.

    `points` (m); `radius` (m,) of the ball around each; `shape`: one for all pairs if `shared`, else its leaves lead
    with m; `body` (m,): the rigid bodies that the shapes belong to, None for ground; `offset` (m, 3): their centres of
    mass from the shapes' origins, in the shapes' frames, None where they are one; `around` (m, f, 3): triangles of the
    points' own surface that they lie on, of nodes of soft bodies that meet shapes with edges, else None; `crease`:
    cosine between two normals below which there is an edge in between.
    """

    points: Any
    radius: Any
    shape: Any
    body: Any
    margin: Any
    rough: bool = static()
    shared: bool = static()
    offset: Any = dataclasses.field(default=None, kw_only=True)
    around: Any = dataclasses.field(default=None, kw_only=True)
    crease: float = static(default=0.9, kw_only=True)

    @property
    def kind(self) -> str:
        """Words for the kinds of partners."""
        return f"{self.points.kind}-{'ground' if self.body is None else 'rigid'} {type(self.shape).__name__.lower()}"

    @property
    def alone(self) -> bool:
        """One shape serves one contact."""
        return self.shared

    def for_nodes(self, nodes: Any, like: int) -> "ShapeContacts":
        """Nodes (k,) of soft bodies in place of the points, against what point number `like` may touch; for a look."""

        def copied(tree: Any) -> Any:
            return jax.tree.map(lambda leaf: jnp.repeat(leaf[like : like + 1], len(nodes), axis=0), tree)

        points = SoftPoint(jnp.asarray(nodes, jnp.int32)[:, None], jnp.ones((len(nodes), 1), self.margin.dtype))
        return self.replace(
            points=points,
            radius=copied(self.radius),
            shape=self.shape if self.shared else copied(self.shape),
            body=copied(self.body),
            offset=copied(self.offset),
            around=None,
            margin=copied(self.margin),
            names=(self.names[like],) * len(nodes),
        )

    def pairs(self, at: Configuration) -> Pairs:
        """The normal is the gradient of the distance; both sides push at the middle of the gap, or at a's node."""
        placed = self.points.placed(at)
        gap, normal = self._distance(placed.position, at)
        if self.around is not None:
            inside = jax.lax.stop_gradient(_further_inside(at.nodes, self.around))
            face, leaning, _ = self._at_edges(gap, normal, placed.position, inside, at)
            over = face <= gap + LEVEL * jnp.linalg.norm(inside, axis=-1)  # in a hollow the other face is further off
            gap, normal = jnp.where(over, face, gap), jnp.where(over[:, None], leaning, normal)
        elif isinstance(self.points, RigidPoint) and self.body is not None:
            gap, normal = self._of_corners(gap, normal, placed.position, self.points, at)
        gap = gap - self.radius
        if isinstance(self.points, RigidPoint):
            middle = placed.position - normal * (self.radius + gap / 2)[:, None]
            placed = moving_with_body(at, self.points.body, middle)
        if self.body is None:
            return Pairs(gap, normal, placed)
        return Pairs(gap, normal, difference(moving_with_body(at, self.body, placed.position), placed))

    def _of_corners(
        self, gap: Array, normal: Array, places: Array, points: RigidPoint, at: Configuration
    ) -> tuple[Array, Array]:
        """Gap and normal of corners: of bodies in one another, those of the plane across which they part."""
        inside = ASIDE * (gather(at.centers, points.body) - places) * (self.radius == 0)[:, None]
        depth = gap - self.radius
        gap, normal, there = self._at_edges(gap, normal, places, inside, at)
        both = there < -OVERLAP * jnp.linalg.norm(jax.lax.stop_gradient(inside), axis=-1)
        plane, way = self._parting(places, points, at)
        buried = (both | (depth < -BURIED * self.margin)) & (plane < self.radius)
        return jnp.where(buried, plane, gap), jnp.where(buried[:, None], way, normal)

    def _at_edges(
        self, gap: Array, normal: Array, places: Array, inside: Array, at: Configuration
    ) -> tuple[Array, Array, Array]:
        """Gap and normal of points at an edge, where rounding would choose among its faces: those of the face above
        which the points' own body is, the one nearest to what is a little further `inside` (m, 3) of that body; and the
        distance there."""
        there, leaning = self._distance(places + inside, at)
        edge = jnp.sum(normal * leaning, -1) < self.crease
        face = there - jnp.sum(leaning * inside, -1)
        return jnp.where(edge, face, gap), jnp.where(edge[:, None], leaning, normal), there

    def _parting(self, places: Array, points: RigidPoint, at: Configuration) -> tuple[Array, Array]:
        """Distances and normal of the plane that touches the other body where it is nearest to the centre of the
        points' own: bodies inside each other go apart across it, where their nearest faces would each push another
        way."""
        lean = LEAN * self.margin[:, None] * jnp.asarray(LEANING, places.dtype)
        centre = gather(at.centers, points.body) + jnp.where((points.body > self.body)[:, None], lean, -lean)
        height, way = self._distance(centre, at)
        return height + jnp.sum(way * (places - centre), -1), way

    def _distance(self, places: Array, at: Configuration) -> tuple[Array, Array]:
        def one(shape: Any, place: Array) -> Any:
            return shape.distance(place)

        measure = jax.vmap(jax.value_and_grad(one, argnums=1), in_axes=(None if self.shared else 0, 0))
        if self.body is None:
            return measure(self.shape, places)
        turn, centre = gather(at.rotations, self.body), gather(at.centers, self.body)
        local = contract("mji,mj->mi", turn, places - centre)
        gap, normal = measure(self.shape, local if self.offset is None else local + self.offset)
        return gap, contract("mij,mj->mi", turn, normal)


def _further_inside(nodes: Array, around: Array) -> Array:
    """Ways (m, 3) from points of a surface into its body: against the sum of areas of the triangles `around` them."""
    area = areas_around(nodes, around)
    square = jnp.sum(area**2, -1, keepdims=True)
    return -BESIDE * area / jnp.where(square > 0, square, 1) ** 0.25


def contact_rows(
    candidates: Any, at: Configuration, values: ContactValues, dt: Array, before: Array, unhindered: Array
) -> tuple[PointRows, PointRows | None, Gaps]:
    """Normal rows (m, 1), tangential rows (m, 2), None where nothing is rough, and gaps.

    `before`, `unhindered` (n, 3): velocities at the start of the step, and those that it would end with without rows.
    """
    pairs = pairs_of(candidates, at)
    triples, jacobian = pairs.relative.triples, pairs.relative.jacobian
    normal = contract("mi,mik->mk", pairs.normal, jacobian)[:, None]
    if at.dropped is not None:
        pairs = pairs.replace(gap=pairs.gap + _across(normal, triples, at.dropped)[:, 0])
    approach, coming = (_across(normal, triples, v)[:, 0] for v in (before, unhindered))
    on = ~(pairs.gap + dt * jnp.minimum(jnp.minimum(approach, coming), 0) >= candidates.margin)  # a NaN counts as near
    bias = _wanted_rate(pairs.gap, approach, coming, values, dt)
    deep = on & (pairs.gap < -DEEP * candidates.margin)
    gaps = Gaps(
        pairs.gap[:, None],
        values.restitution[:, None],
        DEEP * candidates.margin[:, None],
        jnp.where(deep, jnp.clip(approach, 0, values.separation), 0)[:, None],
    )
    zero = jnp.zeros_like(bias)[:, None]
    upright = PointRows(
        triples,
        normal * on[:, None, None],
        zero,
        jnp.where(on, bias, 0)[:, None],
        unknowns=at.unknowns,
        lower=zero,
        upper=jnp.where(on[:, None], jnp.inf, 0),
    )
    if not candidates.rough:
        return upright, None, gaps
    rubs = on & (pairs.gap > -candidates.margin)  # what is inside each other goes apart without
    across = contract("mri,mik->mrk", tangents(pairs.normal), jacobian) * rubs[:, None, None]
    none = jnp.zeros((*zero.shape[:1], 2), zero.dtype)
    way = _way_before(pairs.gap, coming, bias, dt)[:, None] * _across(across, triples, unhindered)
    rough = PointRows(triples, across, none, way, unknowns=at.unknowns, lower=none, upper=none)
    return upright, rough, gaps


def tangents(normal: Array) -> Array:
    """Two directions across each normal (m, 3): (m, 2, 3), orthonormal."""
    axis = jnp.where(jnp.abs(normal[:, :1]) < 0.8, jnp.eye(3, dtype=normal.dtype)[0], jnp.eye(3, dtype=normal.dtype)[1])
    first = axis - jnp.sum(axis * normal, -1, keepdims=True) * normal
    first = first / jnp.linalg.norm(first, axis=-1, keepdims=True)
    return jnp.stack([first, jnp.cross(normal, first)], 1)


def _across(rows: Array, triples: Array, velocities: Array) -> Array:
    return contract("mrk,mk->mr", rows, taken(velocities, triples))


def _way_before(gap: Array, coming: Array, bias: Array, dt: Array) -> Array:
    """Share (m,) of the step in which a pair that arrives has not met yet, and slides as if there were no friction."""
    arriving = (gap > 0) & (gap + dt * coming < 0) & (bias <= 0)
    return jnp.where(arriving, gap / jnp.where(arriving, -dt * coming, 1), 0)


def _wanted_rate(gap: Array, approach: Array, coming: Array, values: ContactValues, dt: Array) -> Array:
    """c of the normal rows. An impact is due where the gap would close faster than two steps of force explain.

    A pair that bounces turns back within the step, up to one step's way before it touches; one that does not, arrives.
    """
    restitution = values.restitution
    rate = jnp.minimum(-jnp.where(gap >= 0, gap, PUSH * gap) / dt, values.separation)
    impact = (restitution > 0) & (gap + dt * coming < 0) & (approach < -2 * jnp.abs(coming - approach))
    return jnp.where(impact, jnp.maximum(rate, -restitution * approach), rate)
