"""How much too stiff a mesh is: the weight of a body bends it less than it bends a finer one.

Displacements of a mesh of linear elements are too small, and what makes up for that in a fit is Young's modulus. Both
meshes hang still, small strains, under the body's own weight; of the compliances c = f . u, which fall short by a
multiple of h^2 (Strang & Fix 1973, section 1.6), the limit is c_2 + (c_2 - c_1) / 3 (Richardson 1911), c_2 of half the
size. Plain sparse algebra on the host: it compiles nothing.
"""

import jax.numpy as jnp
import numpy as np

from jaxfem.elements.tetra import shape_gradients
from jaxfem.materials.moduli import ratio_and_modulus
from jaxfem.mesh import TetMesh, refined
from jaxfem.mesh.topology import unique_edges
from jaxfem.model import Model, Params, element_stiffness, per_element

MOST = 10_000
"""Elements of a mesh that a finer one is made of: some seconds. The finest has eight times as many at most."""
PLAIN = 0.46
"""Poisson's ratio from which plain elements lock, which has a warning of its own."""
SHRINKS = 0.8
"""What a halving gains, of what the one before it gained: more where a support is a point, or the body can turn."""
STEPS = 1500
"""Of conjugate gradients: what needs more turns about its support."""
NOTICED = 0.05
"""By which share a stiffness is to be off."""
NEAR = 0.1
"""Share that one halving gains at most where errors fall as the square of the size."""
ACCURACY = 3e-3
HELD = "held"


def stiffened(model: Model, params: Params) -> float:
    """By which factor Young's modulus comes out on this mesh, about: below 1, which it approaches as meshes get finer.
    1 where that is not known: of other elements than plain ones, without weight, of more than `MOST` elements."""
    gravity, held = np.asarray(params.gravity, np.float64), np.asarray(model.free) == 0
    plain = bool(model.domains) and all(each.by_element and each.clusters is None for each in model.domains)
    if not plain or not gravity.any() or not held.any() or held.all() or model.elements.count > MOST:
        return 1.0
    volumetric, deviatoric = element_stiffness(model, params)
    if float(jnp.max(ratio_and_modulus(volumetric, deviatoric)[0])) > PLAIN:
        return 1.0
    of = [(volumetric - deviatoric) / 3, deviatoric / 2, per_element(model, params.density)]
    values = [np.broadcast_to(np.asarray(each, np.float64), model.elements.count) for each in of]
    cells = np.asarray(model.elements.cells, np.int64)
    mesh = TetMesh(np.asarray(model.rest, np.float64), cells, node_groups={HELD: np.flatnonzero(held)})
    found, u = list[float](), np.zeros((len(mesh.points), 3))
    while True:
        lam, mu, density = values
        compliance, u = _hung(mesh, lam, mu, density, gravity, u)
        found.append(compliance)
        gained = np.diff(found)
        if not np.isfinite(compliance) or (gained <= 0).any() or (gained[1:] > SHRINKS * gained[:-1]).any():
            return 1.0  # no limit is in sight
        if len(found) > 1 and (gained[-1] < NEAR * found[-1] or len(mesh.cells) > MOST / 8):
            return float(found[0] / (found[-1] + gained[-1] / 3))
        u = np.concatenate([u, u[unique_edges(mesh.cells)].mean(axis=1)])
        mesh, values = refined(mesh), [np.repeat(each, 8) for each in values]


def _hung(
    mesh: TetMesh, lam: np.ndarray, mu: np.ndarray, density: np.ndarray, gravity: np.ndarray, start: np.ndarray
) -> tuple[float, np.ndarray]:
    """f . u [J] and u (n, 3) of a body under its own weight f, found from a `start`; `lam`, `mu` [Pa] and `density`
    [kg/m^3] of its elements (E,)."""
    from scipy.sparse import coo_matrix, diags
    from scipy.sparse.linalg import cg

    cells, count = np.asarray(mesh.cells), len(mesh.points)
    gradients, volumes = shape_gradients(np.asarray(mesh.points), cells)
    inner = np.einsum("eai,ebi->eab", gradients, gradients)
    blocks = np.einsum("e,eai,ebj->eaibj", lam * volumes, gradients, gradients)
    blocks += np.einsum("e,eaj,ebi->eaibj", mu * volumes, gradients, gradients)
    blocks += np.einsum("e,eab,ij->eaibj", mu * volumes, inner, np.eye(3))
    numbers = (3 * cells[..., None] + np.arange(3)).reshape(len(cells), 12)
    shape = len(cells), 12, 12
    rows, columns = (np.broadcast_to(each, shape).ravel() for each in (numbers[:, :, None], numbers[:, None]))
    free = np.ones(count, bool)
    free[mesh.node_groups[HELD]] = False
    own = np.repeat(free, 3)
    matrix = coo_matrix((blocks.ravel(), (rows, columns)), shape=(3 * count, 3 * count)).tocsr()[own][:, own]
    weight = np.zeros(count)
    np.add.at(weight, cells, (density * volumes / 4)[:, None])
    force = (weight[:, None] * gravity).ravel()[own]
    u = np.zeros(3 * count)
    settings = {"rtol": ACCURACY, "M": diags(1 / matrix.diagonal()), "maxiter": STEPS}
    u[own], failed = cg(matrix, force, x0=start.ravel()[own], **settings)
    if failed:
        return float("inf"), u.reshape(count, 3)
    return float(2 * force @ u[own] - u[own] @ (matrix @ u[own])), u.reshape(count, 3)


def coarse_warnings(name: str, model: Model, params: Params, error: float) -> list[str]:
    """A warning of a mesh that puts Young's modulus off by more than `NOTICED` and than its `error`, a share of it."""
    factor = stiffened(model, params)
    if 1 - factor < max(NOTICED, error):
        return []
    return [
        f"{name}: the mesh is coarse. Its own weight bends it {100 * factor:.0f} % as far as a fine one, so that a "
        f"stiffness such as Young's modulus comes out {100 * (1 - factor):.0f} % too low, about, where a real part was "
        "recorded, and error bars know nothing of that. Take a finer mesh, or see by --refine how values move"
    ]
