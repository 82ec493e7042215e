"""What makes a list of nodes and elements a usable tetrahedral mesh, and the words for what does not."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

FLAT = 1e-12  # an element is degenerate when |volume| <= FLAT * longest_edge**3 (a regular one has 0.118)
EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])

CELL_ADVICE = {
    3: "these are triangles, a surface without volume: see jaxfem.mesh.from_surface, or mesh the volume",
    8: 'these are hexahedra: jaxfem.mesh.from_cells(points, {"hexahedron": cells}) cuts them into tetrahedra',
    6: 'these are wedges: jaxfem.mesh.from_cells(points, {"wedge": cells}) cuts them into tetrahedra',
    5: 'these are pyramids: jaxfem.mesh.from_cells(points, {"pyramid": cells}) cuts them into tetrahedra',
    10: "these are quadratic tetrahedra: use only the first four columns, cells[:, :4], through TetMesh.repaired",
}


class MeshError(ValueError):
    """A mesh that cannot be used; the message names the node or element and says what to do."""


class MeshWarning(UserWarning):
    """A mesh that can be used, but is likely not what was meant: torn along seams, in another unit, in part."""


def listed(numbers: Sequence[int] | Ints, limit: int = 8) -> str:
    """The first `limit` numbers as `4, 5, 9`, followed by how many were left out."""
    shown = ", ".join(str(int(number)) for number in numbers[:limit])
    return shown if len(numbers) <= limit else f"{shown} and {len(numbers) - limit} more"


def counted(count: int, noun: str) -> str:
    """`1 element`, `3 elements`."""
    return f"{count} {noun}" + ("" if count == 1 else "s")


def refuse_traced(value: Any, what: str) -> None:
    """MeshError for a value inside jax.grad, jit or vmap: meshes are checked on the host, with plain numbers."""
    try:
        np.asarray(value)
    except TypeError as problem:
        if "Tracer" in type(problem).__name__:  # JAX's, which this package does without
            raise MeshError(
                f"{what} is a value inside jax.grad, jit or vmap: make the mesh outside of them, with plain numbers, "
                "and give what build returns other rest positions inside, jaxfem.rebuild(model, rest)"
            ) from None
        raise


def is_positive(value: Any) -> bool:
    """Whether a value is one finite number above zero; MeshError for a traced one."""
    refuse_traced(value, "the size given to a mesh")
    return np.ndim(value) == 0 and np.issubdtype(np.asarray(value).dtype, np.number) and bool(0 < value < np.inf)


def as_points(points: Any, name: str) -> Floats:
    """A copy of the nodes as float64 (n, 3); MeshError names the first node that is not finite."""
    refuse_traced(points, f'points of "{name}"')
    array = np.array(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3 or not len(array):
        raise MeshError(f'points of "{name}" have shape {array.shape}: give (n, 3), one row x, y, z a node')
    bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if len(bad):
        where = ", ".join(f"{value:g}" for value in array[bad[0]])
        more = f" ({len(bad)} nodes are like that)" if len(bad) > 1 else ""
        raise MeshError(f'node {bad[0]} of "{name}" is at ({where}){more}: coordinates must be finite numbers')
    return array


def as_cells(cells: Any, nodes: int, name: str) -> Ints:
    """A copy of the elements as int64 (m, 4) whose entries are all below `nodes`; MeshError otherwise."""
    array = np.asarray(cells)
    if array.ndim == 2 and array.shape[1] in CELL_ADVICE:
        raise MeshError(f'cells of "{name}" have {array.shape[1]} columns: {CELL_ADVICE[array.shape[1]]}')
    if array.ndim != 2 or array.shape[1] != 4:
        raise MeshError(f'cells of "{name}" have shape {array.shape}: give (m, 4), four node numbers an element')
    if not len(array):
        raise MeshError(f'"{name}" has no elements: give at least one tetrahedron')
    integers = as_integers(array, f'cells of "{name}"')
    bad = np.flatnonzero(((integers < 0) | (integers >= nodes)).any(axis=1))
    if len(bad):
        row = integers[bad[0]]
        wrong = int(row[(row < 0) | (row >= nodes)][0])
        one_based = integers.min() == 1 and integers.max() == nodes
        hint = "the elements seem to count nodes from 1: subtract 1" if one_based else f"nodes are 0 to {nodes - 1}"
        raise MeshError(f'element {bad[0]} of "{name}" uses node {wrong}, which does not exist: {hint}')
    return integers


def as_triangles(triangles: Any, nodes: int, name: str) -> Ints:
    """A copy of a surface as int64 (k, 3) whose entries are all below `nodes`; MeshError otherwise."""
    faces = as_integers(triangles, f'triangles of "{name}"')
    if faces.ndim != 2 or faces.shape[1:] != (3,) or not len(faces):
        raise MeshError(f'triangles of "{name}" have shape {faces.shape}: give (k, 3), three node numbers a triangle')
    bad = np.flatnonzero(((faces < 0) | (faces >= nodes)).any(axis=1))
    if len(bad):
        raise MeshError(
            f'the triangles of "{name}" use a node that does not exist: triangle {bad[0]} has '
            f"{faces[bad[0]].tolist()}; give (k, 3) node numbers from 0 to {nodes - 1}"
        )
    return faces


def as_integers(values: Any, what: str) -> Ints:
    """A copy as int64; MeshError for anything that is not of an integer type (an empty list passes)."""
    array = np.asarray(values)
    if array.size and not np.issubdtype(array.dtype, np.integer):
        raise MeshError(f"{what} are of type {array.dtype}: give integers")
    return np.array(array, dtype=np.int64)


def signed_volumes(points: Floats, cells: Ints) -> Floats:
    """Volume of each element (m,), negative where the last three nodes run clockwise seen from the first."""
    a, b, c, d = (points[cells[:, i]] for i in range(4))
    volumes: Floats = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6.0
    return volumes


def edge_lengths(points: Floats, cells: Ints) -> Floats:
    """The six edge lengths of each element (m, 6)."""
    ends = points[cells[:, EDGES]]
    lengths: Floats = np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=-1)
    return lengths


def repeated_nodes(cells: Ints) -> Mask:
    """Which elements (m,) name a node twice."""
    ordered = np.sort(cells, axis=1)
    repeated: Mask = (ordered[:, 1:] == ordered[:, :-1]).any(axis=1)
    return repeated


def degenerate(points: Floats, cells: Ints) -> Mask:
    """Which elements (m,) have no volume to speak of, compared with their longest edge."""
    flat: Mask = np.abs(signed_volumes(points, cells)) <= FLAT * edge_lengths(points, cells).max(axis=1) ** 3
    return flat


def first_equal(rows: Ints) -> Ints:
    """For each row (m, k) the number (m,) of the first row with the same entries in any order."""
    ordered = np.sort(rows, axis=1)
    keys = _keys(ordered)
    # stable: equal rows stay in their own order
    order = np.lexsort(ordered.T) if keys is None else np.argsort(keys, kind="stable")
    new = np.ones(len(rows), dtype=bool)
    new[1:] = (ordered[order[1:]] != ordered[order[:-1]]).any(axis=1) if keys is None else np.diff(keys[order]) != 0
    first = np.empty(len(rows), dtype=np.int64)
    first[order] = order[new][np.cumsum(new) - 1]
    return first


def _keys(rows: Ints) -> Ints | None:
    """One number for each row of node numbers, which sorts several times faster; None where it would not fit."""
    if not rows.size or rows.min() < 0 or (int(rows.max()) + 1) ** rows.shape[1] > np.iinfo(np.int64).max:
        return None
    keys, base = rows[:, 0].copy(), int(rows.max()) + 1
    for column in rows.T[1:]:
        keys = keys * base + column
    return keys


def unreferenced(nodes: int, cells: Ints) -> Ints:
    """Numbers of the nodes that no element uses."""
    used = np.zeros(nodes, dtype=bool)
    used[cells] = True
    return np.flatnonzero(~used)


def refuse_bad_elements(points: Floats, cells: Ints, name: str) -> None:
    """MeshError naming the first element with a repeated node, without volume, or present twice; then idle nodes."""
    advice = "TetMesh.repaired(points, cells) drops such parts and says so"
    bad = np.flatnonzero(repeated_nodes(cells))
    if len(bad):
        nodes = listed(cells[bad[0]])
        raise MeshError(f'element {bad[0]} of "{name}" names a node twice (nodes {nodes}): {advice}')
    bad = np.flatnonzero(degenerate(points, cells))
    if len(bad):
        volume = signed_volumes(points, cells[bad[:1]])[0]
        count = f"; {len(bad)} elements are flat" if len(bad) > 1 else ""
        raise MeshError(f'element {bad[0]} of "{name}" has zero volume ({volume:.2g} m^3{count}): {advice}')
    first = first_equal(cells)
    bad = np.flatnonzero(first != np.arange(len(cells)))
    if len(bad):
        pair = f"elements {first[bad[0]]} and {bad[0]}"
        raise MeshError(f'{pair} of "{name}" have the same nodes ({listed(cells[bad[0]])}): {advice}')
    idle = unreferenced(len(points), cells)
    if len(idle):
        verb = "s belong" if len(idle) > 1 else " belongs"
        raise MeshError(f'node{verb} to no element of "{name}": {listed(idle)}: {advice}')


def flipped(points: Floats, cells: Ints, numbers: Ints | None = None) -> tuple[Ints, tuple[str, ...]]:
    """The elements with the last two nodes of every inside-out one swapped, and the note that says which.

    The note calls element i numbers[i], for elements that are a part of a longer list.
    """
    bad = np.flatnonzero(signed_volumes(points, cells) < 0)
    if not len(bad):
        return cells, ()
    turned = cells.copy()
    turned[bad, 2], turned[bad, 3] = cells[bad, 3], cells[bad, 2]
    were = "was" if len(bad) == 1 else "were"
    bad = bad if numbers is None else numbers[bad]
    return turned, (f"{counted(len(bad), 'element')} {were} oriented inside out and {were} flipped: {listed(bad)}",)
