"""Bodies that several benchmarks step: (model, params, state) each."""

import jaxfem as jf


def cube(cells, dtype, tolerance, young=1e5, size=1.0, solver="auto"):
    """A cube of 5 tetrahedra a cell, hung by its upper face, 1000 kg/m^3, nu 0.3."""
    mesh = jf.mesh.box((size,) * 3, (cells,) * 3, tets_per_cell=5)
    body = jf.SoftBody(mesh, young=young, poisson=0.3, density=1000.0, fixed="z+", velocity=(0.5, 0.0, 0.0))
    return jf.build(jf.Scene([body]), dtype=dtype, tolerance=tolerance, solver=solver)


def beam(cells, dtype, tolerance, tets_per_cell=6, young=2.6e5):
    """A soft beam, 0.1 x 0.03 x 0.03 m, clamped at one end."""
    mesh = jf.mesh.box((0.1, 0.03, 0.03), cells, tets_per_cell=tets_per_cell)
    body = jf.SoftBody(mesh, young=young, poisson=0.4, density=1070.0, damping=2e-3, fixed="x-")
    return jf.build(jf.Scene([body]), dtype=dtype, tolerance=tolerance)


def brick(dtype, solver="condensed", tolerance=1e-4, young=1e9):
    """The stiff brick of Benevolensky & Voroshilov 2009, section 3.7, clamped at one end.

    All cells are cut alike: the sag that brick.py compares with is of that mesh.
    """
    mesh = jf.mesh.box((9.6, 0.2, 0.1), (96, 2, 1), tets_per_cell=12, mirrored=False)
    body = jf.SoftBody(mesh, young=young, poisson=0.35, density=2200.0, fixed="x-")
    return jf.build(jf.Scene([body]), dtype=dtype, solver=solver, tolerance=tolerance, max_iterations=100_000)
