"""Edges of boxes against edges of boxes: what corners do not see, from crossed planks to two ridges.

Of the 12 x 12 pairs of edges those touch whose common perpendicular n leads out of both boxes there: each edge is the
furthest of its box along n, and the feet of the perpendicular lie on both. Their gap is the boxes' separation along n;
where a face of one separates them by more, faces and corners have it (separating axes: Gottschalk, Lin & Manocha 1996).
Selecting is all that is not smooth, so derivatives go through a pair's geometry as they do for corners.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.pytrees import static
from jaxfem.rows.attachments import Configuration, difference, moving_with_body
from jaxfem.rows.candidates import Candidates, Pairs
from jaxfem.rows.contact import LEANING
from jaxfem.tensors import contract, matmul

Array = jax.Array

MOST = 8
"""Pairs of edges that take part for two boxes, the closest: corners of the patch in which two faces overlap."""
TOLERANCE = 1e-3
"""Of the boxes' size: how exactly an edge must be the furthest one, and how much a face may separate more."""
BURIED, LEAN = 0.02, 0.01
"""Of the boxes' size: boxes further inside each other are taken for that much apart in a fixed direction, which tells
where they part if they are in one place."""
FAR = 1e3
"""Gap of what does not take part, in boxes' sizes."""
AXES = np.repeat(np.arange(3), 4)
SIGNS = np.array([np.insert([i, j], axis, 0) for axis in range(3) for i in (-1, 1) for j in (-1, 1)], float)
"""Edges of a box: the axis along which each runs, and its middle in halves of the box's size."""


class BoxEdges(Candidates):
    """Pairs of boxes: rigid bodies `a` and `b` (m,), halves of their sizes (m, 3), and their origins from the bodies'
    centres of mass (m, 3); `margin` (8 m,), 8 candidates for each pair."""

    a: Any
    b: Any
    half_a: Any
    half_b: Any
    origin_a: Any
    origin_b: Any
    margin: Any
    rough: bool = static()

    @property
    def kind(self) -> str:
        """Words for the kinds of partners."""
        return "rigid-rigid box edges"

    def pairs(self, at: Configuration) -> Pairs:
        """The closest pairs of edges; both sides push at the middle of the gap."""
        turn_a, turn_b = at.rotations[self.a], at.rotations[self.b]
        centre_a = at.centers[self.a] + contract("mij,mj->mi", turn_a, self.origin_a)
        centre_b = at.centers[self.b] + contract("mij,mj->mi", turn_b, self.origin_b)
        above = jnp.where(self.a > self.b, 1.0, -1.0).astype(centre_a.dtype)
        found = jax.vmap(_closest)(centre_a, centre_b, turn_a, turn_b, self.half_a, self.half_b, above)
        gap, normal, middle = (leaf.reshape(-1, *leaf.shape[2:]) for leaf in found)
        a, b = jnp.repeat(self.a, MOST), jnp.repeat(self.b, MOST)
        relative = difference(moving_with_body(at, b, middle), moving_with_body(at, a, middle))
        return Pairs(gap, normal, relative)


def _closest(
    centre_a: Array, centre_b: Array, turn_a: Array, turn_b: Array, half_a: Array, half_b: Array, above: Array
) -> tuple[Array, Array, Array]:
    """Gap (8,), normal from b to a (8, 3) and middle of the gap (8, 3) of the pairs of edges that touch first.

    `above`: 1 or -1, the side of b on which a is taken to be where they are in one place.
    """
    size = jax.lax.stop_gradient(jnp.minimum(half_a.min(), half_b.min()))
    first, second = (jnp.repeat(jnp.arange(12), 12), jnp.tile(jnp.arange(12), 12))
    geometry = _perpendiculars(centre_a, centre_b, turn_a, turn_b, half_a, half_b, first, second)
    gap, normal, _, valid = jax.lax.stop_gradient(geometry)
    way = centre_a - centre_b
    faces = jax.lax.stop_gradient(_face_separation(way, turn_a, turn_b, half_a, half_b))
    lean = jnp.where(faces < -BURIED * size, LEAN * size * above, 0) * jnp.asarray(LEANING, way.dtype)
    parted = jax.lax.stop_gradient(_face_separation(way + lean, turn_a, turn_b, half_a, half_b))
    valid = valid & (gap + matmul(normal, lean) >= parted - TOLERANCE * size)
    # In the order of the edges, so that a pair keeps its place from step to step.
    chosen = jnp.sort(jax.lax.top_k(jnp.where(valid, -gap, -jnp.inf), MOST)[1])
    gap, normal, middle, _ = _perpendiculars(
        centre_a, centre_b, turn_a, turn_b, half_a, half_b, first[chosen], second[chosen]
    )
    return jnp.where(valid[chosen], gap, FAR * size), normal, middle


def _perpendiculars(
    centre_a: Array, centre_b: Array, turn_a: Array, turn_b: Array, half_a: Array, half_b: Array, i: Array, j: Array
) -> tuple[Array, Array, Array, Array]:
    """Gap, normal, middle of the gap, and whether it is one, for edges i of a and j of b."""
    axes, signs = jnp.asarray(AXES), jnp.asarray(SIGNS, half_a.dtype)
    along_a, along_b = turn_a.T[axes[i]], turn_b.T[axes[j]]
    arm_a, arm_b = matmul(signs[i] * half_a, turn_a.T), matmul(signs[j] * half_b, turn_b.T)
    across = jnp.cross(along_a, along_b)
    square = jnp.sum(across**2, -1)
    crossing = square > 1e-6
    safe = jnp.where(crossing, square, 1)
    normal = jnp.where(crossing[:, None], across, jnp.array([0, 0, 1.0], across.dtype)) / jnp.sqrt(safe)[:, None]
    # Out of b and into a: against a's edge, seen from a's centre, and along b's.
    side = jnp.sign(jnp.sum(normal * jax.lax.stop_gradient(arm_b - arm_a), -1))
    normal = jnp.where(side == 0, 1.0, side)[:, None] * normal
    way = (centre_b + arm_b) - (centre_a + arm_a)
    cosine = jnp.sum(along_a * along_b, -1)
    on_a, on_b = jnp.sum(way * along_a, -1), jnp.sum(way * along_b, -1)
    s, t = (on_a - cosine * on_b) / safe, (cosine * on_a - on_b) / safe
    foot_a = centre_a + arm_a + s[:, None] * along_a
    foot_b = centre_b + arm_b + t[:, None] * along_b
    gap = jnp.sum(normal * (foot_a - foot_b), -1)

    size = jnp.minimum(half_a.min(), half_b.min())
    short_a = _reach(normal, turn_a, half_a) + jnp.sum(normal * arm_a, -1)
    short_b = _reach(normal, turn_b, half_b) - jnp.sum(normal * arm_b, -1)
    furthest = jnp.maximum(short_a, short_b) <= TOLERANCE * size
    on_both = (jnp.abs(s) <= half_a[axes[i]]) & (jnp.abs(t) <= half_b[axes[j]])
    return gap, normal, 0.5 * (foot_a + foot_b), crossing & furthest & on_both


def _face_separation(way: Array, turn_a: Array, turn_b: Array, half_a: Array, half_b: Array) -> Array:
    """The largest separation of the boxes along a normal of one's faces; negative where all overlap."""
    normals = jnp.concatenate([turn_a.T, turn_b.T])
    reach = _reach(normals, turn_a, half_a) + _reach(normals, turn_b, half_b)
    return jnp.max(jnp.abs(matmul(normals, way)) - reach)


def _reach(directions: Array, turn: Array, half: Array) -> Array:
    """How far a box reaches from its centre along each direction (m, 3)."""
    return matmul(jnp.abs(matmul(directions, turn)), half)
