"""Modes at rest, on the host in double precision: all of a small body's, or those of groups of nodes."""

from typing import Any, NamedTuple

import numpy as np

from jaxfem.mesh.groups import body_groups

ALL = 4000  # free directions, beyond which all modes are too dear to find (6 s) and to use
GROUP = 12  # nodes of a group
MOST = 1200  # modes of groups
MAPS = 12  # modes of a group
SMOOTHING = 4  # passes that take what is quick out of them
QUICK = 0.1  # of the largest eigenvalue of D^-1 K, from which on modes are quick
POWER = 20  # passes that find that
ALIKE = 1e-6  # of the largest: what is left of a group's mode that its others make up

Modes = tuple[np.ndarray, np.ndarray]
"""Squared frequencies (m,), and shapes (3 nf, m) that are orthonormal with the masses."""


class Rest(NamedTuple):
    """A body at rest: `gradients` (E, 4, 3), `volumes` (E,), `cells` (E, 4), `mass` (n,), of which the first
    `free_count` nodes move; `bulk`, `shear` (E,): 3K and 2 mu; `share` of the mass that is consistent, see
    `elements/mass.py`."""

    gradients: np.ndarray
    volumes: np.ndarray
    cells: np.ndarray
    mass: np.ndarray
    free_count: int
    bulk: np.ndarray
    shear: np.ndarray
    share: float


def all_modes(rest: Rest) -> Modes:
    """All modes of a body."""
    import scipy.linalg

    values, vectors = scipy.linalg.eigh(_stiffness(rest).toarray(), _mass(rest).toarray())
    return np.maximum(values, 0), vectors


def group_modes(rest: Rest, points: np.ndarray, node_body: np.ndarray) -> Modes:
    """Modes of a body whose groups of nodes move by affine maps only: what is slow in it, nearly.

    `points` (n, 3), `node_body` (n,). Each group's maps are made orthonormal, and those left out that its nodes, few or
    on a line, do not tell from others.
    """
    import scipy.linalg
    import scipy.sparse

    free = rest.free_count
    groups = body_groups(points[:free], _numbered(node_body[:free]), GROUP, MOST // MAPS)
    columns, rows, entries, width = [], [], [], 0
    for nodes in groups:
        root = np.sqrt(np.repeat(rest.mass[nodes], 3))
        left, size, _ = np.linalg.svd(root[:, None] * _maps(points[nodes]), full_matrices=False)
        own = left[:, size > ALIKE * size[0]] / root[:, None]
        places = (3 * nodes[:, None] + np.arange(3)).ravel()
        rows.append(np.repeat(places, own.shape[1]))
        columns.append(np.tile(width + np.arange(own.shape[1]), len(places)))
        entries.append(own.ravel())
        width += own.shape[1]
    joined = [np.concatenate(each) for each in (entries, rows, columns)]
    plain = scipy.sparse.csr_array((joined[0], (joined[1], joined[2])), shape=(3 * free, width))
    stiffness = _stiffness(rest)
    spread = _smoothed(stiffness, plain.toarray())
    values, vectors = scipy.linalg.eigh(*(spread.T @ (whole @ spread) for whole in (stiffness, _mass(rest))))
    return np.maximum(values, 0), spread @ vectors


def _smoothed(stiffness: Any, fields: np.ndarray) -> np.ndarray:
    """Fields (3 nf, m) without what is quick in them, as at the borders of groups: a Chebyshev polynomial of D^-1 K
    that is small on the upper part of its spectrum (smoothed aggregation: Vanek, Mandel & Brezina 1996)."""
    inverse = 1 / stiffness.diagonal()[:, None]
    vector = np.random.default_rng(0).normal(size=(len(inverse), 1))
    for _ in range(POWER):
        vector = inverse * (stiffness @ vector)
        top = float(np.abs(vector).max())
        vector /= top
    top *= 1.05
    middle, half = 0.5 * top * (1 + QUICK), 0.5 * top * (1 - QUICK)
    for step in range(SMOOTHING):
        root = middle + half * np.cos(np.pi * (step + 0.5) / SMOOTHING)
        fields = fields - inverse * (stiffness @ fields) / root
    return fields


def _maps(points: np.ndarray) -> np.ndarray:
    """Displacements (3 k, 12) of k nodes by the affine maps."""
    arm = points - points.mean(0)
    arm = np.hstack([np.ones((len(arm), 1)), arm / max(np.sqrt((arm**2).sum(1).mean()), 1e-300)])
    found: np.ndarray = np.einsum("kl,ij->kilj", arm, np.eye(3)).reshape(3 * len(points), MAPS)
    return found


def _numbered(body: np.ndarray) -> np.ndarray:
    """Numbers of bodies without those that have no free node."""
    return np.unique(body, return_inverse=True)[1]


def _stiffness(rest: Rest) -> Any:
    """Of the free directions, (3 nf, 3 nf), sparse."""
    g, mu, lam = rest.gradients, rest.shear / 2, (rest.bulk - rest.shear) / 3
    outer = np.einsum("eai,ebj->eaibj", g, g)
    own = np.einsum("eakbk,ij->eaibj", outer, np.eye(3))
    local = lam[:, None, None, None, None] * outer + mu[:, None, None, None, None] * (
        outer.transpose(0, 1, 4, 3, 2) + own
    )
    local = (local * rest.volumes[:, None, None, None, None]).reshape(-1, 12, 12)
    return _assembled(rest, local)


def _mass(rest: Rest) -> Any:
    """Of the free directions, (3 nf, 3 nf), sparse, of a density of 1."""
    import scipy.sparse

    lumped = scipy.sparse.diags_array(np.repeat(rest.mass[: rest.free_count], 3)).tocsr()
    if not rest.share:
        return lumped
    tied = rest.share / 20 * np.kron(np.ones((4, 4)) - 4 * np.eye(4), np.eye(3))
    return lumped + _assembled(rest, rest.volumes[:, None, None] * tied)


def _assembled(rest: Rest, local: np.ndarray) -> Any:
    """The sum over elements of local matrices (E, 12, 12), of the free directions."""
    import scipy.sparse

    dof = (3 * rest.cells[:, :, None] + np.arange(3)).reshape(-1, 12)
    rows, columns = (np.broadcast_to(each, local.shape).ravel() for each in (dof[:, :, None], dof[:, None]))
    size, free = 3 * len(rest.mass), 3 * rest.free_count
    return scipy.sparse.csr_array((local.ravel(), (rows, columns)), shape=(size, size))[:free, :free]
