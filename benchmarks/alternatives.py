"""Is there a better discretisation?  python benchmarks/alternatives.py [--quick] [--out FOLDER]

Tip sag of a beam, 0.1 x 0.03 x 0.03 m, under a weight so small that it answers linearly, against locking-free Q2/Q1
elements, at nu 0.3, 0.45, 0.499, for what was tried and left: deviatoric rows smoothed over faces (Liu, Nguyen-Thoi,
Lam & Ye 2009) instead of edges, or not at all, with the same volumetric rows; quadratic tetrahedra (displacement only).
`blocks`: 3x3 blocks of the matrix, which is what a product costs.
"""

import jax
import numpy as np
from machine import describe
from report import arguments, finish

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import scipy.sparse as sparse  # noqa: E402
import scipy.sparse.linalg as direct  # noqa: E402
from jaxfem.bodies import smoothing  # noqa: E402

import jaxfem as jf  # noqa: E402
from jaxfem.mesh.topology import element_faces, face_counts  # noqa: E402

YOUNG, DENSITY, GRAVITY = 263824.0, 1070.0, 9.80709
LOCKING_FREE = {0.3: 7.056e-3, 0.45: 6.875e-3, 0.499: 6.786e-3}  # m, Q2/Q1 elements of an outside library
VOLUMETRIC = smoothing.STRAINS["smoothed"][1:]
EDGES = smoothing._EDGES
SMALL = 1e-4  # share of gravity that acts


def owners_with_faces(kind, cells, known=smoothing._owners):
    """Domains that share each element: the library's kinds, and "face"."""
    if kind != "face":
        return known(kind, cells)
    keys, owners = np.unique(face_counts(element_faces(cells))[0], return_inverse=True)
    return owners.reshape(len(cells), 4), len(keys)


def box(cells):
    return jf.mesh.box((0.1, 0.03, 0.03), cells)


def smoothed_over(kind, cells):
    """Errors of the tip sag with deviatoric rows on domains of `kind`, nodes and blocks."""
    smoothing.STRAINS["smoothed"] = ((kind, "deviatoric"), *VOLUMETRIC)
    mesh = box(cells)
    body = jf.SoftBody(mesh, YOUNG, 0.3, DENSITY, fixed="x-", strain="smoothed")
    model, params, state = jf.build(jf.Scene([body], gravity=(0, 0, -SMALL * GRAVITY)))
    tip, errors = mesh.points[:, 0] > 0.1 - 1e-9, {}
    for poisson, sag in LOCKING_FREE.items():
        rest, info = jf.equilibrium(model, params.replace(poisson=jnp.asarray(poisson)), state)
        assert info.status == 0
        moved = np.asarray(rest.positions)[tip, 2].mean() - mesh.points[tip, 2].mean()
        errors[f"nu_{poisson}"] = float(-moved / SMALL / sag - 1)
    return errors | {"nodes": model.nodes, "blocks": int(model.pattern.neighbours.size)}


def quadratic(cells):
    """Errors of the tip sag with ten-node tetrahedra, nodes and blocks."""
    mesh = box(cells)
    ends = np.sort(mesh.cells[:, EDGES], axis=2).reshape(-1, 2)
    edges, middle = np.unique(ends, axis=0, return_inverse=True)
    tets = np.hstack([mesh.cells, len(mesh.points) + middle.reshape(-1, 6)])
    points = np.vstack([mesh.points, mesh.points[edges].mean(1)])
    corners = mesh.points[mesh.cells]
    inverse = np.linalg.inv(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2))
    gradients = np.concatenate([-inverse.sum(1, keepdims=True), inverse], axis=1)
    unknowns = (3 * tets[..., None] + np.arange(3)).reshape(len(tets), 30)
    force = np.zeros(3 * len(points))
    share = np.array([-1 / 20] * 4 + [1 / 5] * 6)  # of an element's weight, each node's
    np.add.at(force, 3 * tets + 2, -DENSITY * GRAVITY * mesh.volumes[:, None] * share)
    free, tip = np.repeat(points[:, 0] > 1e-9, 3), points[:, 0] > 0.1 - 1e-9
    errors = {}
    for poisson, sag in LOCKING_FREE.items():
        element = quadratic_stiffness(gradients, mesh.volumes, poisson)
        rows, columns = np.repeat(unknowns, 30, 1).ravel(), np.tile(unknowns, (1, 30)).ravel()
        matrix = sparse.coo_matrix((element.ravel(), (rows, columns))).tocsc()
        moved = np.zeros_like(force)
        moved[free] = direct.spsolve(matrix[free][:, free], force[free])
        errors[f"nu_{poisson}"] = float(-moved.reshape(-1, 3)[tip, 2].mean() / sag - 1)
    return errors | {"nodes": len(points), "blocks": matrix.nnz // 9}


def quadratic_stiffness(gradients, volumes, poisson):
    """Stiffness (m, 30, 30) of ten-node tetrahedra from the gradients of their barycentric coordinates (m, 4, 3)."""
    lame, shear = YOUNG * poisson / ((1 + poisson) * (1 - 2 * poisson)), YOUNG / 2 / (1 + poisson)
    inner, outer = (1 + 3 / 5**0.5) / 4, (1 - 1 / 5**0.5) / 4  # four points, exact to second order
    total = np.zeros((len(volumes), 10, 3, 10, 3))
    for place in outer + (inner - outer) * np.eye(4):
        slopes = np.vstack([np.diag(4 * place - 1), np.zeros((6, 4))])
        for number, (i, j) in enumerate(EDGES):
            slopes[4 + number, [i, j]] = 4 * place[[j, i]]
        b = np.einsum("nk,ekx->enx", slopes, gradients)
        weight = volumes / 4
        total += np.einsum("e,eax,eby->eaxby", lame * weight, b, b)
        total += np.einsum("e,eay,ebx->eaxby", shear * weight, b, b)
        total += np.einsum("e,eak,ebk,xy->eaxby", shear * weight, b, b, np.eye(3))
    return total.reshape(-1, 30, 30)


def main():
    options = arguments(__doc__)
    smoothing._owners = owners_with_faces
    meshes = [(10, 3, 3)] if options.quick else [(10, 3, 3), (20, 6, 6)]
    figures = {"machine": describe(), "tets_per_cell": 6}
    for kind in ("edge", "face", "element"):
        figures[kind] = {"x".join(map(str, cells)): smoothed_over(kind, cells) for cells in meshes}
    figures["quadratic"] = {"x".join(map(str, c)): quadratic(c) for c in [(5, 2, 2), *meshes[:1]]}
    finish("alternatives", figures, options.out)


if __name__ == "__main__":
    main()
