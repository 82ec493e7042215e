"""Rubber at rest against FElupe (Dutzler 2023), another finite element library, on the same mesh of plain elements."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf

fem = pytest.importorskip("felupe", reason="felupe is not installed: pip install felupe")

SHEAR, POISSON = 4e4, 0.4
BULK = 2 * SHEAR * (1 + POISSON) / (3 * (1 - 2 * POISSON))


def stable(f, **_):
    """Stress and elasticity of the energy of Smith, de Goes & Kim 2018, by hand, for FElupe."""
    m, lam = 4 / 3 * SHEAR, BULK + SHEAR / 6
    square = np.einsum("ij...,ij...->...", f, f)
    jump = np.linalg.det(np.moveaxis(f, (0, 1), (-2, -1)))
    turned = jump * np.moveaxis(np.linalg.inv(np.moveaxis(f, (0, 1), (-2, -1))), (-1, -2), (0, 1))
    return m, lam, square, jump, turned


def stress(x, **_):
    f = x[0]
    m, lam, square, jump, turned = stable(f)
    return [m * (1 - 1 / (square + 1)) * f + lam * (jump - 1 - 0.75 * m / lam) * turned, None]


def elasticity(x, **_):
    f = x[0]
    m, lam, square, jump, turned = stable(f)
    same = np.einsum("ik,jl->ijkl", np.eye(3), np.eye(3))[..., None, None]
    outer = np.einsum("ij...,kl...->ijkl...", turned, turned)
    crossed = np.einsum("il...,kj...->ijkl...", turned, turned)
    growth = (outer - crossed) / jump
    return [
        m * (1 - 1 / (square + 1)) * same
        + 2 * m / (square + 1) ** 2 * np.einsum("ij...,kl...->ijkl...", f, f)
        + lam * outer
        + lam * (jump - 1 - 0.75 * m / lam) * growth
    ]


C10, C01 = 0.35 * SHEAR, 0.15 * SHEAR


def mooney(f):
    """Stress of W = c10 (I1' - 3) + c01 (I2' - 3) + K/2 (J - 1)^2, by hand, also for complex F."""
    inverse = np.moveaxis(np.linalg.inv(np.moveaxis(f, (0, 1), (-2, -1))), (-1, -2), (0, 1))
    jump = np.linalg.det(np.moveaxis(f, (0, 1), (-2, -1)))
    cauchy = np.einsum("ki...,kj...->ij...", f, f)
    first = np.einsum("ii...->...", cauchy)
    second = 0.5 * (first**2 - np.einsum("ij...,ji...->...", cauchy, cauchy))
    shape = 2 * C10 * jump ** (-2 / 3) * (f - first / 3 * inverse)
    bent = first * f - np.einsum("ik...,kj...->ij...", f, cauchy) - 2 / 3 * second * inverse
    return shape + 2 * C01 * jump ** (-4 / 3) * bent + BULK * (jump - 1) * jump * inverse


def mooney_elasticity(x, **_):
    """Its slope, by complex steps: no digits cancel."""
    f, found = x[0], np.zeros((3, 3, *x[0].shape))
    for k in range(3):
        for m in range(3):
            moved = f.astype(complex)
            moved[k, m] += 1e-30j
            found[:, :, k, m] = mooney(moved).imag / 1e-30
    return [found]


LAWS = {
    "neo_hookean": (
        jf.NeoHookean(young=2 * SHEAR * (1 + POISSON), poisson=POISSON),
        lambda: fem.Material(stress, elasticity),
    ),
    "yeoh": (jf.Yeoh(c1=SHEAR / 2, poisson=POISSON), lambda: fem.NeoHooke(mu=SHEAR, bulk=BULK)),
    "mooney_rivlin": (
        jf.MooneyRivlin(c10=C10, c01=C01, poisson=POISSON),
        lambda: fem.Material(lambda x, **_: [mooney(x[0]), None], mooney_elasticity),
    ),
}


def shapes(points):
    """Places of the driven end of the bar: pulled by half its length, and twisted by a third of a turn."""
    end = np.isclose(points[:, 0], points[:, 0].max())
    pulled, twisted = points.copy(), points.copy()
    pulled[end, 0] += 0.05
    c, s = np.cos(2.0), np.sin(2.0)
    twisted[end, 1:] = (points[end, 1:] - 0.015) @ np.array([[c, s], [-s, c]]) + 0.015
    return {"pulled": (pulled, None), "twisted": (twisted, None), "loaded": (points, (0.0, 0.0, -0.15))}, end


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_shapes_at_rest_are_those_of_felupe(name):
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (4, 1, 1))
    points, cells = np.asarray(mesh.points), np.asarray(mesh.cells)
    law, other = LAWS[name]
    wanted, end = shapes(points)
    for case, (places, load) in wanted.items():
        fixed = np.isclose(points[:, 0], 0) | (end if load is None else False)
        body = jf.SoftBody(mesh, material=law, density=1e3, fixed=fixed)
        model, params, state = jf.build(jf.Scene([body], gravity=(0, 0, 0)), tolerance=1e-12)
        found, forces = state.positions, np.zeros_like(points)
        if load is not None:
            forces[end] = np.asarray(load) / end.sum()
        field = fem.FieldContainer([fem.Field(fem.RegionTetra(fem.Mesh(points, cells, "tetra")), dim=3)])
        solid = fem.SolidBody(other(), field)
        for share in (0.25, 0.5, 0.75, 1.0):
            # Between the places, so that each stretch of the way is short.
            held = jnp.where(fixed[:, None], points + share * (places - points), found)
            rest, info = jf.equilibrium(model, params, state.replace(positions=held), forces=share * forces)
            assert int(info.status) == 0, case
            found = rest.positions
            shift = np.where(fixed[:, None], share * (places - points), 0)[fixed]
            boundary = fem.Boundary(field[0], mask=fixed)
            dofs = fem.dof.partition(field, {"held": boundary})
            ext0 = fem.dof.apply(field, {"held": fem.Boundary(field[0], mask=fixed, value=shift.ravel())}, dofs[0])
            items = [solid, fem.PointLoad(field, np.arange(len(points)), share * forces)]
            field = fem.newtonraphson(items=items, dof0=dofs[0], dof1=dofs[1], ext0=ext0, tol=1e-12, verbose=0).x
        np.testing.assert_allclose(found, points + field[0].values, atol=1e-8 * 0.1, err_msg=case)


def pushed(points, faces, pressure):
    """Nodal forces of a pressure on the faces of this shape."""
    a, b, c = (points[faces[:, i]] for i in range(3))
    forces = np.zeros_like(points)
    for corner in faces.T:
        np.add.at(forces, corner, -pressure / 6 * np.cross(b - a, c - a))
    return forces


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_a_pressure_that_follows_bends_a_bar_as_felupe_does(name):
    """FElupe has no faces of tetrahedra: it is given the forces of its own shape until that changes no more."""
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (4, 1, 1))
    points, cells = np.asarray(mesh.points), np.asarray(mesh.cells)
    law, other = LAWS[name]
    body = jf.SoftBody(mesh, material=law, density=1e3, fixed="x-", loads=[jf.Pressure("z+", 1500.0)])
    model, params, state = jf.build(jf.Scene([body], gravity=(0, 0, 0)), tolerance=1e-12)
    rest, info = jf.equilibrium(model, params, state)
    assert int(info.status) == 0
    faces = np.asarray(model.loads[0].faces)
    field = fem.FieldContainer([fem.Field(fem.RegionTetra(fem.Mesh(points, cells, "tetra")), dim=3)])
    solid = fem.SolidBody(other(), field)
    boundary = {"held": fem.Boundary(field[0], fx=0.0)}
    free = fem.dof.partition(field, boundary)
    for _ in range(60):
        before = points + field[0].values
        load = fem.PointLoad(field, np.arange(len(points)), pushed(before, faces, 1500.0))
        items = [solid, load]
        field = fem.newtonraphson(items=items, dof0=free[0], dof1=free[1], tol=1e-12, verbose=0).x
        change = np.abs(points + field[0].values - before).max()
        if change < 1e-11:
            break
    assert change < 1e-11
    found = points + field[0].values
    assert np.abs(found - points).max() > 0.01
    np.testing.assert_allclose(rest.positions, found, atol=1e-8 * 0.1)
