"""The assembled tangent as a SciPy matrix: statics and vibration on the host, cheap to compile, as a second opinion."""

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sparse
import scipy.sparse.linalg as direct

from jaxfem.elements.domains import domain_strain
from jaxfem.methods.nodes.assembly import assemble_tangent
from jaxfem.model import domain_materials, nodal_mass, per_element
from jaxfem.tensors import array_of


@jax.jit
def _assembled(model, params):
    """The tangent at rest, without the terms of prestress, which vanish there."""
    materials = domain_materials(model, params)
    turns = [array_of(domain_strain(each, model.rest)[1]) for each in model.domains]
    zero, ones = jnp.zeros_like(model.free), jnp.ones_like(model.free)
    return assemble_tangent(model.domains, model.rest, turns, materials, zero, ones, model.pattern, False)


def stiffness(model, params) -> sparse.csc_matrix:
    """Stiffness at rest of all nodes, fixed ones too, (3 n, 3 n) in the user's order of nodes."""
    matrix, pattern = jax.tree.map(np.asarray, (_assembled(model, params), model.pattern))
    nodes, width = pattern.neighbours.shape
    blocks = matrix.blocks.reshape(nodes, 3, width, 3)
    rows = np.broadcast_to(3 * np.arange(nodes)[:, None, None, None] + np.arange(3)[:, None, None], blocks.shape)
    columns = np.broadcast_to(3 * pattern.neighbours[:, None, :, None] + np.arange(3), blocks.shape)
    total = _csr(blocks, rows, columns, (3 * nodes, 3 * nodes))
    for factor in matrix.factors:
        count = len(factor.spots)
        spots = (3 * factor.spots[..., None] + np.arange(3)).reshape(count, -1)
        b = _csr(factor.rows, np.broadcast_to(np.arange(count)[:, None], spots.shape), spots, (count, 3 * nodes))
        total = total + b.T @ sparse.diags(factor.weight) @ b
        if factor.shared is not None:
            clusters = factor.shared.clusters
            shape = (clusters.count, count)
            means = _csr(clusters.shares, clusters.owner, np.arange(count), shape)
            total = total + (means @ b).T @ sparse.diags(factor.shared.weight) @ (means @ b)
    order = (3 * pattern.place[:, None] + np.arange(3)).ravel()
    return total[order][:, order].tocsc()


def mass(model, params, kind: str) -> sparse.csc_matrix:
    """Mass matrix (3 n, 3 n): "lumped", "consistent" or "averaged"."""
    lumped = sparse.diags(np.asarray(nodal_mass(model, params.density)))
    cells = np.asarray(model.elements.cells)
    element = np.asarray(per_element(model, params.density) * model.elements.volumes)
    blocks = element[:, None, None] / 20 * (1 + np.eye(4))
    rows, columns = np.broadcast_to(cells[:, :, None], blocks.shape), np.broadcast_to(cells[:, None], blocks.shape)
    consistent = _csr(blocks, rows, columns, (model.nodes, model.nodes))
    scalar = {"lumped": lumped, "consistent": consistent, "averaged": (lumped + consistent) / 2}[kind]
    return sparse.kron(scalar, sparse.eye(3)).tocsc()


def free_entries(model) -> np.ndarray:
    """Numbers of the unknowns of nodes that are not fixed."""
    return np.flatnonzero(np.repeat(np.asarray(model.free) > 0, 3))


def linear_statics(model, params, forces, held=None) -> np.ndarray:
    """Displacements (n, 3) of linear elasticity under nodal `forces` (n, 3), fixed nodes moved by `held` (n, 3)."""
    matrix, free = stiffness(model, params), free_entries(model)
    found = np.zeros(3 * model.nodes) if held is None else np.array(held, float).ravel()
    found[free] = 0
    right = np.asarray(forces).ravel() - matrix @ found
    found[free] = direct.spsolve(matrix[free][:, free], right[free])
    return found.reshape(-1, 3)


def frequencies(model, params, kind="lumped", count=6, shift=-1e-3) -> tuple[np.ndarray, np.ndarray]:
    """Lowest frequencies (count,) [rad/s] and shapes (count, n, 3); `shift` [1/s^2] keeps the factors regular."""
    free = free_entries(model)
    k, m = stiffness(model, params)[free][:, free], mass(model, params, kind)[free][:, free]
    values, vectors = direct.eigsh(k, count, m, sigma=shift, tol=1e-12)
    shapes = np.zeros((count, 3 * model.nodes))
    shapes[:, free] = vectors.T
    return np.sqrt(np.maximum(values, 0)), shapes.reshape(count, -1, 3)


def _csr(values, rows, columns, shape) -> sparse.csr_matrix:
    return sparse.csr_matrix((np.ravel(values), (np.ravel(rows), np.ravel(columns))), shape=shape)
