"""Faces of soft bodies against distance functions: the deepest point of each surface triangle, not only its corners.

The point is sought by trying a pattern around the best one so far, ever finer; that needs no derivative and is not
differentiated. Two steps of Newton's behind it, along the directions in which the distance is curved, make it exact;
the second, which starts where the curvature is that of the point itself, gives it the implicit derivative (cf. Macklin,
Erleben, Mueller, Chentanez, Jeschke & Corse 2020).
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.pytrees import static
from jaxfem.rows.attachments import Configuration, SoftPoint
from jaxfem.rows.candidates import Candidates, Pairs
from jaxfem.rows.contact import SAID_AGAIN, ShapeContacts
from jaxfem.rows.nearby import chosen, nearest
from jaxfem.tensors import contract, matmul

Array = jax.Array

MOST_FACES = 32
"""Triangles of a contact that take part in a step: those that may be nearest."""
TRIES, FINER = 28, 0.72  # how often the pattern is laid down, which starts as wide as the triangle, and how it shrinks
TURN = 2.4  # of the pattern between two tries [rad], the golden angle: narrow valleys run in any direction
PATTERN = np.array([(0, 0), *((r * np.cos(a), r * np.sin(a)) for r in (0.5, 1) for a in np.arange(10) * np.pi / 5)])
PLANE = np.array([(1, -1, 0), (3**-0.5, 3**-0.5, -2 * 3**-0.5)]) / 2**0.5  # weights that add up to zero
EVEN = 1e-5  # of the triangle's size: what decides where it lies flat, for its middle
NUDGE = 1e-3  # longest step of Newton's, in weights
CURVED = 1e-3  # of the triangle's size over the radius of curvature: below that nothing tells where it touches
CORNER = 1e-3  # weight of the two others up to which the nodes have it
LEVEL = 1e-5  # of the triangle's size: depth below what its corners say from which on it has a row
FAR = 1e3  # gap of what takes no part, in sizes of the triangle


class FaceContacts(Candidates):
    """Surface triangles `nodes` (m, 3) of soft bodies against shapes as in `ShapeContacts`.

    `body`, `offset`: the shapes' bodies and their centres of mass; `most`: how many of the triangles take part in a
    step, 0 for all, and `margin` (most,).
    """

    nodes: Any
    shape: Any
    body: Any
    margin: Any
    rough: bool = static()
    shared: bool = static()
    most: int = static()
    offset: Any = dataclasses.field(default=None, kw_only=True)

    @property
    def kind(self) -> str:
        """Words for the kinds of partners."""
        return f"soft faces-{'ground' if self.body is None else 'rigid'} {type(self.shape).__name__.lower()}"

    @property
    def alone(self) -> bool:
        """Its `most` triangles are one contact's."""
        return True

    @property
    def give(self) -> float:
        """Triangles beside each other, their nodes and the shape's corners say nearly the same where it lies flat."""
        return SAID_AGAIN

    def pairs(self, at: Configuration) -> Pairs:
        """Those of the deepest points; what a triangle's corners say, their own rows do, and it takes no part.

        So it is where it is deepest at a corner, and where it lies flat along the shape: rows said twice leave impulses
        open, and with friction they ask for slips that differ in their last digits, which takes thousands of rounds.
        """
        if self.most:
            return self._nearest(at).replace(most=0).pairs(at)
        corners = self._seen(at)
        weights = jax.vmap(_deepest, in_axes=(None if self.shared else 0, 0))(self.shape, corners)
        contacts = ShapeContacts(
            SoftPoint(self.nodes, weights),
            jnp.zeros_like(weights[:, 0]),
            self.shape,
            self.body,
            self.margin,
            self.rough,
            self.shared,
            offset=self.offset,
        )
        pairs = contacts.pairs(at)
        fixed = jax.lax.stop_gradient((self.shape, corners, weights))
        own = jax.vmap(_tells_more, in_axes=(None if self.shared else 0, 0, 0))(*fixed)
        return pairs.replace(gap=jnp.where(own, pairs.gap, FAR * jax.vmap(_size)(fixed[1])))

    def _nearest(self, at: Configuration) -> "FaceContacts":
        """The `most` triangles that may be nearest, in their order: no distance changes faster than its place."""

        def least(shape: Any, corners: Array) -> Array:
            middle = jnp.mean(corners, 0)
            bound: Array = shape.distance(middle) - jnp.sqrt(jnp.max(jnp.sum((corners - middle) ** 2, -1)))
            return bound

        fixed: FaceContacts = jax.lax.stop_gradient(self)
        corners = fixed._seen(jax.lax.stop_gradient(at))
        bound = jax.vmap(least, in_axes=(None if self.shared else 0, 0))(fixed.shape, corners)
        kept = {"margin": self.margin} | ({"shape": self.shape} if self.shared else {})
        fewer: FaceContacts = chosen(self, nearest(bound, self.most), **kept)
        return fewer

    def _seen(self, at: Configuration) -> Array:
        """The corners (m, 3, 3) in the frames of the shapes."""
        corners = at.nodes[self.nodes]
        if self.body is None:
            return corners
        local = contract("mji,mkj->mki", at.rotations[self.body], corners - at.centers[self.body][:, None])
        return local if self.offset is None else local + self.offset[:, None]


def _size(corners: Array) -> Array:
    return jnp.sqrt(jnp.max(jnp.sum((corners - jnp.roll(corners, 1, 0)) ** 2, -1)))


def _tells_more(shape: Any, corners: Array, weights: Array) -> Array:
    """Whether the point of `weights` (3,) is deeper than the distances of the corners (3, 3) say there."""
    spanned = matmul(weights, jax.vmap(shape.distance)(corners))
    deeper: Array = shape.distance(matmul(weights, corners)) < spanned - LEVEL * _size(corners)
    return deeper & (jnp.max(weights) < 1 - CORNER)


def _deepest(shape: Any, corners: Array) -> Array:
    """Barycentric weights (3,) of the point of a triangle (3, 3) where the distance is least; differentiable."""
    fixed = jax.lax.stop_gradient((shape, corners))

    def distance(given: Any, weights: Array) -> Array:
        shape, corners = given
        found: Array = shape.distance(matmul(weights, corners))
        return found

    size = _size(fixed[1])
    pattern, plane = jnp.asarray(PATTERN, corners.dtype), jnp.asarray(PLANE, corners.dtype)

    def finer(k: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        best, step = carry
        c, s = jnp.cos(TURN * k), jnp.sin(TURN * k)
        tries = jnp.maximum(best + step * matmul(matmul(pattern, jnp.array([[c, s], [-s, c]], best.dtype)), plane), 0)
        tries = tries / jnp.sum(tries, -1, keepdims=True)
        values = jax.vmap(lambda w: distance(fixed, w) + EVEN * size * jnp.sum((w - 1 / 3) ** 2))(tries)
        return tries[jnp.argmin(values)], FINER * step

    third = jnp.full(3, 1 / 3, corners.dtype)
    best, _ = jax.lax.fori_loop(0, TRIES, finer, (third, 2 * third[0]))
    near = _exact(distance, fixed, fixed, best, size)
    return _exact(distance, fixed, (shape, corners), near, size)


def _exact(distance: Any, fixed: Any, given: Any, best: Array, size: Array) -> Array:
    """One step of Newton's from the weights `best`, within the side that they are on."""
    inside = best > NUDGE
    on, count = inside.astype(best.dtype), jnp.sum(inside)
    first = jax.nn.one_hot(jnp.argmax(on), 3, dtype=best.dtype)
    last = jax.nn.one_hot(2 - jnp.argmax(on[::-1]), 3, dtype=best.dtype)
    across = (count == 3) * (on / 3 - (first + last) / 2)
    ways = jnp.stack([first - last, across], -1)  # (3, 2), zero where there is no such way

    def slope(given: Any, moved: Array) -> Array:
        found: Array = jax.grad(lambda moved: distance(given, best + matmul(ways, moved)))(moved)
        return found

    nothing = jnp.zeros(2, best.dtype)
    bend = jax.jacfwd(lambda moved: slope(fixed, moved))(nothing)
    turn = 0.5 * jnp.arctan2(2 * bend[0, 1], bend[0, 0] - bend[1, 1])
    axes = jnp.array([[jnp.cos(turn), -jnp.sin(turn)], [jnp.sin(turn), jnp.cos(turn)]])
    curvature = contract("ia,ij,ja->a", axes, bend, axes)
    curved = curvature > CURVED * size
    inverse = contract("ia,a,ja->ij", axes, jnp.where(curved, 1 / jnp.where(curved, curvature, 1), 0), axes)
    near = jnp.sum(jnp.abs(matmul(inverse, slope(fixed, nothing)))) < NUDGE
    return best - matmul(ways, jnp.where(near, matmul(inverse, slope(given, nothing)), 0))
