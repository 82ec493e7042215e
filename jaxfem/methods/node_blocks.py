"""What methods share that assemble a matrix over the nodes of plain linear tetrahedra, block by block, and solve it.

Blocks stand in padded rows ("ELL"): those of a node lie side by side, so that a product is one small dense one a node.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.batching import lanes_in_turn
from jaxfem.elements.strains import PLAIN
from jaxfem.methods.base import CannotServe, Facts
from jaxfem.model import Model
from jaxfem.pytrees import Pytree, on_device
from jaxfem.solvers.implicit import or_nan, unless_zero
from jaxfem.solvers.pcg import pcg
from jaxfem.solvers.status import SolveInfo
from jaxfem.tensors import EXACT

Array = jax.Array


class NodePairs(Pytree):
    """Nodes that share an element: `neighbours` (n, w), a node's own first and on padding; `slots` (E, k, k): place of
    the block of an element's corners a and b among the n w blocks, of k corners (two of a spring)."""

    neighbours: Array
    slots: Array

    def summed(self, blocks: Array) -> Array:
        """The matrix (n, 3, 3 w) of blocks (E, k, k, 3, 3)."""
        n, width = self.neighbours.shape
        total = jnp.zeros((n * width, 3, 3), blocks.dtype).at[self.slots].add(blocks)
        return total.reshape(n, width, 3, 3).transpose(0, 2, 1, 3).reshape(n, 3, 3 * width)

    def product(self, matrix: Array, field: Array) -> Array:
        """The matrix times a nodal field (n, 3)."""
        near = field[self.neighbours].reshape(len(field), -1)
        return jnp.einsum("nik,nk->ni", matrix, near, precision=EXACT)


def node_pairs(cells: np.ndarray, nodes: int) -> NodePairs:
    """The pairs of the corners of `cells` (E, k); host side."""
    corners = cells.shape[1]
    first, second = np.repeat(cells, corners, 1), np.tile(cells, (1, corners))
    own = np.arange(nodes)
    # A node's own pair sorts first: it is numbered 0, all others by their node + 1.
    key = first * (nodes + 1) + np.where(first == second, 0, second + 1)
    found, place = np.unique(np.concatenate([own * (nodes + 1), key.ravel()]), return_inverse=True)
    row, column = found // (nodes + 1), found % (nodes + 1) - 1
    column = np.where(column < 0, row, column)
    rank = np.arange(len(found)) - np.searchsorted(row, own)[row]
    width = int(rank.max(initial=0)) + 1
    neighbours = np.repeat(own[:, None], width, 1)
    neighbours[row, rank] = column
    slots = (row * width + rank)[place[nodes:]].reshape(-1, corners, corners)
    return NodePairs(on_device(neighbours, jnp.int32), on_device(slots, jnp.int32))


class NodeSystem(Pytree):
    """A step as A v = `right` (n, 3) [N s] on the free nodes: A of `matrix`, see `NodePairs`.

    `free` (n, 1) bool; `prescribed` (n, 3) [m/s]; `scale` (n,) [kg] stands for A on what is not free; `floor` [N s]:
    residual below which only rounding is left.
    """

    pairs: NodePairs
    matrix: Array
    right: Array
    free: Array
    prescribed: Array
    scale: Array
    floor: Array
    tolerance: Array
    max_iterations: Array

    def merged(self, unknown: Array) -> Array:
        """Velocities of all nodes (n, 3) from the unknown on the free ones."""
        return jnp.where(self.free, unknown, self.prescribed)

    def gradient(self, unknown: Array) -> Array:
        """The residual (n, 3) of the unknown; what is not free is to be zero."""
        left = self.pairs.product(self.matrix, self.merged(unknown)) - self.right
        return jnp.where(self.free, left, self.scale[:, None] * unknown)


@lanes_in_turn
def _solved(system: NodeSystem, right: Array, absolute: Array) -> tuple[Array, SolveInfo]:
    """A^-1 right by conjugate gradients, preconditioned with the nodes' own blocks."""
    own = jnp.where(system.free[:, :, None], system.matrix[:, :, :3], jnp.eye(3, dtype=right.dtype))
    own = own * jnp.where(system.free[:, :, None], 1, system.scale[:, None, None])
    inverse = jnp.linalg.inv(own)

    def product(vector: Array) -> Array:
        moved = system.pairs.product(system.matrix, jnp.where(system.free, vector, 0))
        return jnp.where(system.free, moved, system.scale[:, None] * vector)

    return pcg(
        product,
        right,
        lambda r: jnp.einsum("nij,nj->ni", inverse, r, precision=EXACT),
        tol=system.tolerance,
        max_iterations=system.max_iterations,
        absolute=absolute,
    )


@dataclasses.dataclass(frozen=True)
class NodeCondition:
    """A v = right as a condition on v; its tangent is solved with the same matrix."""

    symmetric: bool = True

    def gradient(self, inputs: NodeSystem, unknown: Array) -> Array:
        """See `NodeSystem`."""
        return inputs.gradient(unknown)

    def solve(self, inputs: NodeSystem, guess: Array) -> tuple[Array, Any]:
        """From a guess (n, 3): what it leaves is solved for, so that nothing is done where all stands still."""
        guess = jnp.where(inputs.free, guess, 0)
        increment, info = _solved(inputs, -inputs.gradient(guess), inputs.floor)
        return guess + increment, info

    def tangent_solve(self, inputs: NodeSystem, unknown: Array, right: Array, matvec: Any) -> Array:
        """With the same matrix and preconditioner."""
        return or_nan(*unless_zero(lambda given, r: _solved(given, r, jnp.zeros_like(given.floor)), inputs, right))


def rounding_floor(mass: Array, load: Array, velocities: Array) -> Array:
    """Residual [N s] below which only rounding is left, where impulses `load` act on masses that move."""
    size = jnp.linalg.norm(load) + jnp.linalg.norm(mass[:, None] * velocities)
    floor: Array = jax.lax.stop_gradient(16 * jnp.finfo(mass.dtype).eps * size)
    return floor


def refuses_but_plain(facts: Facts) -> str | None:
    """Why a method for plain linear tetrahedra under backward Euler cannot serve a scene, or None."""
    if not facts.soft or facts.coupled:
        return (
            'is for soft bodies alone, without rigid bodies, joints or contacts: use "condensed" or "auto" for scenes '
            "that hold such"
        )
    if facts.smoothed:
        return f'takes strain = "{PLAIN}" alone, not "{facts.smoothed[0]}": use "condensed" for that'
    if facts.mass != "lumped":
        return f'takes mass = "lumped" alone, not "{facts.mass}": use "condensed" for that'
    if not facts.scheme.euler:
        return f'takes scheme = "backward_euler" alone, not "{facts.scheme.name}": use "condensed" for that'
    return None


def check_linear(model: Model) -> None:
    """CannotServe where the stress of a body is not linear in its strain and the rate of that alone."""
    for name, law in zip(model.bodies, model.laws, strict=True):
        if not law.linear or law.remembers:
            raise CannotServe(
                f'takes linear elastic bodies alone, and "{name}" is of {type(law).__name__}: use "condensed" for that'
            )


def check_polar(model: Model) -> None:
    """CannotServe where bodies ask for rotations that a method without any of elements would leave out in silence."""
    if model.rotation_kind != "polar":
        raise CannotServe(
            f'knows no rotations of elements, and the bodies ask for rotation = "{model.rotation_kind}": leave it out, '
            'or use "assembled" or "condensed" for it'
        )
