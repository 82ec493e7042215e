"""Smoothing domains made from a mesh: which elements each averages over, and the gradients of their mean. Host side."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxfem.elements.domains import Clusters, Domains
from jaxfem.elements.strains import PARTS, STRAINS, Domain, Part
from jaxfem.materials.base import Material
from jaxfem.mesh.groups import body_groups
from jaxfem.pytrees import on_device

__all__ = ["STRAINS", "build_domains"]

# Clusters that share volumetric rows: larger ones are softer and cheaper. Past the most, they grow with the mesh.
CLUSTER_NODES = 8
MOST_CLUSTERS = 1024

_EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


def build_domains(
    kind: Domain,
    part: Part,
    law: Material,
    chosen: np.ndarray,
    cells: np.ndarray,
    gradients: np.ndarray,
    volumes: np.ndarray,
    body: np.ndarray,
    place: np.ndarray,
    points: np.ndarray,
    dtype: Any,
) -> Domains:
    """Domains of one kind ("element", "edge" or "node") over the `chosen` elements of a model, all of one `law`.

    `cells` (E, 4), `gradients` (E, 4, 3), `volumes` (E,), `body` (E,) of all elements, float64; `place` (n,) the rank
    of each node, by which a domain's nodes are sorted; `points` (n, 3).
    """
    owners, count = _owners(kind, cells[chosen])
    owner, element = owners.ravel(), np.repeat(chosen, owners.shape[1])
    piece = np.repeat(volumes[chosen] / owners.shape[1], owners.shape[1])
    total = np.bincount(owner, piece, count)
    share = piece / total[owner]
    weighted = gradients[element] * share[:, None, None]
    nodes, mean, valence = _mean_gradients(owner, count, cells[element], weighted, place)
    members, shares = _padded(owner, element, share)
    whole = kind == "element" and len(chosen) == len(cells)
    order = np.argsort(-valence, kind="stable")
    clusters = None
    if PARTS[part].bulk == "shared":
        own = np.unique(cells[chosen])[order]
        clusters = _clusters(points[own], body[members[order, 0]], total[order], nodes[order], valence[order], dtype)
    return Domains(
        on_device(nodes[order], jnp.int32),
        on_device(mean[order].transpose(1, 2, 0), dtype),
        on_device(total[order], dtype),
        on_device(body[members[order, 0]], jnp.int32),
        None if whole else on_device(members[order], jnp.int32),
        None if whole else on_device(shares[order], dtype),
        part,
        law,
        clusters,
    )


def _clusters(
    centres: np.ndarray, body: np.ndarray, volumes: np.ndarray, nodes: np.ndarray, valence: np.ndarray, dtype: Any
) -> Clusters:
    """Clusters of neighbouring nodal domains of one body."""
    bodies = np.unique(body, return_inverse=True)[1]
    groups = body_groups(centres, bodies, CLUSTER_NODES, MOST_CLUSTERS)
    owner = np.empty(len(centres), np.int64)
    for number, group in enumerate(groups):
        owner[group] = number
    total = np.bincount(owner, volumes)
    real = np.arange(nodes.shape[1]) < valence[:, None]
    count = int(nodes.max()) + 1
    pairs, slots = np.unique((owner[:, None] * count + nodes)[real], return_inverse=True)
    padded = np.full(nodes.shape, len(pairs))
    padded[real] = slots.ravel()
    return Clusters(
        on_device(owner, jnp.int32),
        on_device(volumes / total[owner], dtype),
        on_device(total, dtype),
        on_device(padded, jnp.int32),
        on_device(pairs // count, jnp.int32),
        on_device(pairs % count, jnp.int32),
    )


def _owners(kind: Domain, cells: np.ndarray) -> tuple[np.ndarray, int]:
    """Domains (E, s) among which each element is shared, and their number."""
    if kind == "element":
        return np.arange(len(cells))[:, None], len(cells)
    if kind == "node":
        corners, owners = np.unique(cells, return_inverse=True)
        return owners.reshape(cells.shape), len(corners)
    edges = np.sort(cells[:, _EDGES], axis=2).astype(np.int64).reshape(-1, 2)
    keys, owners = np.unique(edges[:, 0] * (cells.max() + 1) + edges[:, 1], return_inverse=True)
    return owners.reshape(len(cells), len(_EDGES)), len(keys)


def _mean_gradients(
    owner: np.ndarray, count: int, cells: np.ndarray, weighted: np.ndarray, place: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes (D, m) of each domain by their rank, the mean gradients (D, m, 3) in them, and how many there are (D,)."""
    ranks = int(place.max()) + 1
    keys, where = np.unique((owner[:, None].astype(np.int64) * ranks + place[cells]).ravel(), return_inverse=True)
    where = where.ravel()
    mean = np.stack([np.bincount(where, weighted[:, :, i].ravel(), len(keys)) for i in range(3)], axis=1)
    node = np.empty(len(keys), np.int64)
    node[where] = cells.ravel()
    own = keys // ranks
    nodes, gradients = _padded(own, node, mean)
    return nodes, gradients, np.bincount(own, minlength=count)


def _padded(owner: np.ndarray, integers: np.ndarray, floats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values gathered by their owner in rows of equal length: integers repeat the row's first, floats are 0."""
    order = np.argsort(owner, kind="stable")
    sorted_owner = owner[order]
    starts = np.flatnonzero(np.diff(sorted_owner, prepend=-1))
    column = np.arange(len(order)) - starts[sorted_owner]
    width = column.max() + 1
    rows = np.repeat(integers[order][starts][:, None], width, axis=1)
    rows[sorted_owner, column] = integers[order]
    padded = np.zeros((len(starts), width, *floats.shape[1:]))
    padded[sorted_owner, column] = floats[order]
    return rows, padded
