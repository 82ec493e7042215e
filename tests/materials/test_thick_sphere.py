"""A thick sphere of rubber blown up by a pressure inside, against the closed form of what keeps its volume."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.elements import finite
from jaxfem.model import domain_materials

INNER, OUTER, LAYERS, NARROW = 1.0, 2.0, 16, 0.1
LAWS = {
    "neo_hookean": jf.Yeoh(c1=1e4, poisson=0.4998),  # with c1 alone
    "yeoh": jf.Yeoh(c1=1e4, c2=6e2, c3=20.0, poisson=0.4998),
}


def pressure_by_hand(law, stretch):
    """p(s_a) = integral of W'(s) / (s^3 - 1) from the outer stretch to the inner one `stretch` (Green & Zerna 1968)."""
    c = [law.values[name] or 0.0 for name in ("c1", "c2", "c3")]
    outer = np.cbrt(1 + (stretch**3 - 1) * (INNER / OUTER) ** 3)
    points, weights = np.polynomial.legendre.leggauss(40)
    s = outer + 0.5 * (stretch - outer) * (points + 1)
    x = s**-4 + 2 * s**2 - 3
    slope = (c[0] + 2 * c[1] * x + 3 * c[2] * x**2) * 4 * (s - s**-5)
    return 0.5 * (stretch - outer) * np.sum(weights * slope / (s**3 - 1))


@pytest.mark.parametrize("name", LAWS)
def test_a_thick_sphere_grows_as_the_closed_form_says(name):
    """Smoothed rows, nearly incompressible, to twice its inner radius: the pressure within 1 %, so far and on the way.

    A narrow sector whose layers move along their radii alone; the pressure is the slope of its energy in the volume
    that it encloses.
    """
    law = LAWS[name]
    mesh = jf.mesh.box((OUTER - INNER, NARROW, NARROW), (LAYERS, 1, 1), origin=(INNER, -NARROW / 2, -NARROW / 2))
    ray = np.stack([np.ones(len(mesh.points)), mesh.points[:, 1], mesh.points[:, 2]], 1)
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    radius = mesh.points[:, 0]
    body = jf.SoftBody(jf.TetMesh(radius[:, None] * ray, mesh.cells), material=law, density=1e3, strain="smoothed")
    model, params, _ = jf.build(jf.Scene([body]))
    layer = jnp.asarray(np.round((radius - INNER) / (OUTER - INNER) * LAYERS).astype(int))
    solid = float(jnp.sum(model.elements.volumes)) / (OUTER**3 - INNER**3)  # angle over 3, of the flat sector
    materials = domain_materials(model, params)

    def energy(moved):
        places = model.rest + moved[layer][:, None] * ray
        parts = zip(model.domains, materials, strict=True)
        return sum(finite.energy(d, m, None, finite.displacement_gradient(d, places)) for d, m in parts)

    @jax.jit
    def rest(inner, moved):
        """Energy made least in all layers but the inner one, and its slope there."""

        def closer(_, others):
            slope, bend = jax.grad(of)(others), jax.hessian(of)(others)
            return others - jnp.linalg.solve(bend, slope)

        def of(others):
            return energy(jnp.concatenate([inner[None], others]))

        found = jnp.concatenate([inner[None], jax.lax.fori_loop(0, 8, closer, moved[1:])])
        return found, jax.grad(energy)(found)

    rays = np.linspace(INNER, OUTER, LAYERS + 1)
    moved = jnp.zeros(LAYERS + 1)
    for stretch in (1.1, 1.25, 1.4, 1.6, 1.8, 2.0):
        kept = np.cbrt(rays**3 + INNER**3 * (stretch**3 - 1)) - rays
        moved, left = rest(jnp.asarray((stretch - 1) * INNER), jnp.asarray(kept))
        assert float(jnp.abs(left[1:]).max()) < 1e-8 * float(jnp.abs(left[0]))
        pressure = float(left[0]) / (3 * solid * (INNER + float(moved[0])) ** 2)
        np.testing.assert_allclose(pressure, pressure_by_hand(law, stretch), rtol=0.01)
        np.testing.assert_allclose(moved[-1], kept[-1], rtol=0.01)
