"""How near the kinds of strain rows come: convergence order, locking, large rotations, no soft modes of the mesh."""

import host
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes

import jaxfem as jf
from jaxfem.model import nodal_mass

STRAINS = ["element", "nodal_volume", "smoothed"]

pytestmark = pytest.mark.filterwarnings("ignore::jaxfem.AccuracyWarning")


def exact(x):
    """A smooth displacement (3,) at x (3,)."""
    return jnp.stack(
        [
            jnp.sin(2 * x[0] + x[1]) * jnp.cos(x[2]),
            jnp.cos(x[0] - 2 * x[2]) * jnp.sin(1.5 * x[1]),
            jnp.sin(x[0] + x[1]) * jnp.cos(2 * x[2] + 0.3),
        ]
    )


def body_force(x, young=1e6, poisson=0.3):
    """Minus the divergence of the stress that `exact` makes, (3,) [N/m^3]."""
    lam, mu = young * poisson / (1 + poisson) / (1 - 2 * poisson), young / 2 / (1 + poisson)

    def stress(y):
        gradient = jax.jacfwd(exact)(y)
        return lam * jnp.trace(gradient) * jnp.eye(3) + mu * (gradient + gradient.T)

    return -jnp.einsum("ijj->i", jax.jacfwd(stress)(x))


def manufactured_error(strain, cells):
    """L2 norm of the displacement's error in the unit cube, its surface held at the exact values; linear regime."""
    mesh = jf.mesh.box((1.0, 1.0, 1.0), (cells,) * 3)
    points = mesh.points
    surface = ((points < 1e-9) | (points > 1 - 1e-9)).any(1)
    model, params, _ = jf.build(jf.Scene([jf.SoftBody(mesh, 1e6, 0.3, 1.0, fixed=surface, strain=strain)]))
    force = np.asarray(jax.vmap(body_force)(points)) * np.asarray(model.nodal_volumes)[:, None]
    found = host.linear_statics(model, params, force, np.asarray(jax.vmap(exact)(points)))
    # Four points an element, exact for quadratics.
    weights = np.full((4, 4), (5 - 5**0.5) / 20) + np.eye(4) * 5**0.5 / 5
    at, inside = (np.einsum("qa,eai->eqi", weights, field[mesh.cells]) for field in (points, found))
    error = inside - np.asarray(jax.vmap(jax.vmap(exact))(at))
    return np.sqrt((np.asarray(model.elements.volumes)[:, None] / 4 * (error**2).sum(-1)).sum())


@pytest.mark.parametrize("strain", STRAINS)
def test_displacements_converge_in_second_order(strain):
    coarse, fine = (manufactured_error(strain, n) for n in (4, 8))
    assert abs(np.log2(coarse / fine) - 2) < 0.2


OUTSIDE = scenes.outside("clamped_beams")
LOCKING_FREE = OUTSIDE["sag"]["values"]  # mm, by Poisson's ratio


@pytest.mark.parametrize(
    ("cells", "limits"),
    [
        ((10, 3, 3), (0.02, 0.05, 0.09)),
        pytest.param((20, 6, 6), (0.01, 0.015, 0.03), marks=pytest.mark.slow),
    ],
)
def test_smoothed_beam_sags_as_without_locking(cells, limits):
    mesh = jf.mesh.box((0.1, 0.03, 0.03), cells, tets_per_cell=12)
    body = jf.SoftBody(mesh, 263824.0, 0.3, 1070.0, fixed="x-", strain="smoothed")
    model, params, _ = jf.build(jf.Scene([body]))
    weight = np.asarray(nodal_mass(model, params.density)[:, None] * jnp.array([0, 0, -9.80709]))
    tip = mesh.points[:, 0] > 0.1 - 1e-9
    for (poisson, sag), limit in zip(LOCKING_FREE.items(), limits, strict=True):
        found = host.linear_statics(model, params.replace(poisson=jnp.asarray(float(poisson))), weight)
        assert abs(-1e3 * found[tip, 2].mean() / sag - 1) < limit


@pytest.mark.slow
@pytest.mark.parametrize(("tets", "limit"), [(6, 0.065), (12, 0.03)])
def test_smoothed_block_does_not_lock(tets, limit):
    """Bonded block pressed by 5 %: the reaction, against locking-free values from outside."""
    mesh = jf.mesh.box((1.0, 1.0, 1.0), (8, 8, 8), tets_per_cell=tets)
    low, high = mesh.points[:, 2] < 1e-9, mesh.points[:, 2] > 1 - 1e-9
    body = jf.SoftBody(mesh, 1e6, 0.3, 1000.0, fixed=low | high, strain="smoothed")
    model, params, _ = jf.build(jf.Scene([body]))
    held = -0.05 * high[:, None] * np.array([0, 0, 1.0])
    reactions = OUTSIDE["pressed block"]["values"]
    for (poisson, expected), allowed in zip(reactions.items(), (0.006, limit), strict=True):
        own = params.replace(poisson=jnp.asarray(float(poisson)))
        found = host.linear_statics(model, own, np.zeros_like(held), held)
        reaction = (host.stiffness(model, own) @ found.ravel()).reshape(-1, 3)[low, 2].sum()
        assert abs(abs(reaction) / expected - 1) < allowed


@pytest.mark.slow
def test_smoothed_elastica():
    """A 20:1 beam bent by a load at its tip or by its own weight, through large rotations; EI = 1 N m^2, 1 m long."""
    thickness = 0.05
    mesh = jf.mesh.box((1.0, thickness, thickness), (40, 2, 2), tets_per_cell=12)
    load = jf.Traction("x+", (0.0, 0.0, 0.0))
    body = jf.SoftBody(mesh, 12 / thickness**4, 0.3, 1.0, fixed="x-", loads=[load], strain="smoothed")
    model, params, state = jf.build(jf.Scene([body]))
    down = jnp.array([0.0, 0.0, -1 / thickness**2])
    for (tip_load, weight), (along, below) in OUTSIDE["elastica"]["values"]:
        own = params.replace(loads=(tip_load * down,), gravity=weight * down)
        rest, info = jf.equilibrium(model, own, state)
        assert info.status == 0 and info.inverted == 0
        tip = np.asarray(rest.positions)[mesh.points[:, 0] > 1 - 1e-9].mean(0)
        wanted, moved = np.array([along - 1, -below]), tip - [1, thickness / 2, thickness / 2]
        assert np.linalg.norm(moved[[0, 2]] - wanted) < 0.015 * np.linalg.norm(wanted)
        assert abs(moved[1]) < 0.002 * np.linalg.norm(wanted)  # the mesh does not push it aside


# rad/s, unit cube, E = 1 MPa, nu = 0.3, 1000 kg/m^3: extrapolated in h^2 from 5 and 10 cells a side of 12 tetrahedra,
# smoothed rows; the three kinds of mass agree to 0.1 %, plain rows' limits lie within 1 %.
FREE_CUBE = np.array([55.89, 55.89, 75.32, 75.32, 75.36, 76.63])


def free_cube(strain, cells, tets):
    mesh = jf.mesh.box((1.0, 1.0, 1.0), (cells,) * 3, tets_per_cell=tets)
    model, params, _ = jf.build(jf.Scene([jf.SoftBody(mesh, 1e6, 0.3, 1000.0, strain=strain)]))
    return model, params


@pytest.mark.slow
def test_smoothed_free_cube_has_the_right_frequencies():
    """No mode of the mesh lies among the lowest six that are not rigid."""
    model, params = free_cube("smoothed", 6, 12)
    for kind in ("lumped", "averaged"):
        found = host.frequencies(model, params, kind, 12, shift=-100.0)[0]
        assert (found[:6] < 1e-3).all()
        assert np.abs(found[6:] / FREE_CUBE - 1).max() < 0.05


def test_no_deformation_is_much_softer_than_in_plain_elements():
    """Averaging strains makes rough fields softer; a checkerboard free of energy would show here as a zero."""
    plain = host.stiffness(*free_cube("element", 3, 6)).toarray()
    energies, fields = np.linalg.eigh(plain)
    assert (energies[:6] < 1e-9 * energies[-1]).all()
    scaled = fields[:, 6:] / np.sqrt(energies[6:])
    for strain, least in (("nodal_volume", 0.3), ("smoothed", 0.1)):
        other = host.stiffness(*free_cube(strain, 3, 6)).toarray()
        softest = np.linalg.eigvalsh(scaled.T @ other @ scaled)[0]
        assert softest > least, (strain, softest)
