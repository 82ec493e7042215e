"""J2 plasticity: a pulled bar there and back, Hill's thick cylinder, the loop's convergence, what is remembered."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.declared.joints import Joint, Part, frame_along
from jaxfem.elements import finite
from jaxfem.materials.principal import slope_of
from jaxfem.materials.rotated import rotated
from jaxfem.methods.nodes.condensed import condensed_matrix, linearised
from jaxfem.model import domain_materials
from jaxfem.rows.locks import LineLock
from jaxfem.system.memory import committed
from jaxfem.system.soft import momentum_gradient, step_system
from jaxfem.tensors import matrix_of

YOUNG, POISSON, YIELD = 1e6, 0.3, 2e3
GROWN, MOVED = 8e4, 6e4
STEEL = jf.J2Plastic(
    young=YOUNG, poisson=POISSON, yield_stress=YIELD, isotropic_hardening=GROWN, kinematic_hardening=MOVED
)
STILL = 1.0
"""A step so long that inertia is little beside forces [s]."""


def by_hand(strains):
    """Stress of a pulled bar over its strain, by the return mapping of one dimension (Simo & Hughes 1998, box 1.5)."""
    plastic, length, found = 0.0, 0.0, []
    for strain in strains:
        stress = YOUNG * (strain - plastic)
        relative = stress - MOVED * plastic
        excess = abs(relative) - (YIELD + GROWN * length)
        if excess > 0:
            flow = excess / (YOUNG + GROWN + MOVED)
            plastic += flow * np.sign(relative)
            length += flow
            stress = YOUNG * (strain - plastic)
        found.append(stress)
    return np.array(found)


def test_a_bar_pulled_and_pressed_follows_the_uniaxial_cycle():
    """Its sides are free, and far beyond yield on both sides the stress is that of the hand calculation."""
    values = {name: jnp.asarray(value, float) for name, value in STEEL.values.items()}
    bulk = STEEL.stiffness(values)[0] / 3
    strains = np.concatenate([np.linspace(0, 6e-3, 7)[1:], np.linspace(6e-3, -6e-3, 13)[1:], [0.0, 4e-3]])

    @jax.jit
    def pulled(strain, memory):
        def stress(narrow):
            gradient = jnp.diag(jnp.stack([strain, narrow, narrow]))[:, :, None]
            return slope_of(lambda h: STEEL.density(values, bulk, h, memory, None), gradient)[..., 0]

        def closer(_, narrow):
            side, rate = jax.jvp(lambda n: stress(n)[1, 1], (narrow,), (1.0,))
            return narrow - side / rate

        narrow = jax.lax.fori_loop(0, 12, closer, -0.4 * strain)
        reached = rotated(matrix_of(jnp.diag(jnp.stack([strain, narrow, narrow]))[:, :, None]))
        return stress(narrow)[0, 0], STEEL.commit(values, memory, reached, None, slice(0, 6))

    memory, found = STEEL.internal0(jnp.zeros((6, 1))), []
    for strain in strains:
        stress, memory = pulled(strain, memory)
        found.append(float(stress))
    np.testing.assert_allclose(found, by_hand(strains), atol=1e-9 * YIELD)


BAR = jf.mesh.box((0.2, 0.1, 0.1), (2, 1, 1))


def bar(traction, tolerance, **settings):
    """A bar that is pulled at both ends, without weight; one program steps it, however it is held."""
    loads = [jf.Traction("x+", (traction, 0.0, 0.0)), jf.Traction("x-", (-traction, 0.0, 0.0))]
    body = jf.SoftBody(BAR, material=STEEL, density=1e3, loads=loads, **settings)
    return jf.build(jf.Scene([body], gravity=(0, 0, 0)), tolerance=tolerance)


@pytest.mark.parametrize("strain", ["element", pytest.param("smoothed", marks=pytest.mark.slow)])
def test_steps_pull_a_bar_beyond_yield_and_let_it_go(strain):
    """By the stresses of the hand calculation: its strains come out, on any kind of domains; what flows is counted."""
    model, params, state = bar(1.0, tolerance=1e-10, strain=strain, fixed=[0])
    strains, found, flowed = np.array([1.5e-3, 4e-3, 6e-3, 4.5e-3, 7e-3]), [], []
    still = jnp.zeros_like(model.rest)  # so that the program is that of the test of Newton's loop
    for stress in by_hand(strains):
        pull = tuple(stress * jnp.array([side, 0.0, 0.0]) for side in (1, -1))
        state, info = jf.step(model, params.replace(loads=pull), state, STILL, forces=still)
        assert int(info.status) == 0
        flowed.append(int(info.counts["flowing"]))
        found.append(float(jnp.ptp(state.positions[:, 0])) / 0.2 - 1)
    np.testing.assert_allclose(found, strains, rtol=0.01)
    domains = model.domains[0].count
    assert flowed == [0, domains, domains, 0, domains]


class Rays(Joint):
    """Each node of a soft body stays on the ray from the z axis through it: what symmetry says of a narrow sector."""

    def parts(self, bodies, where):
        """A line for each node."""
        for place in bodies.soft[bodies.find(self.a, where)[1]].mesh.points:
            frame = bodies.frame(None, frame_along((place[0], place[1], 0.0)), where)
            ends = bodies.point(None, place, where), bodies.point(self.a, place, where)
            yield Part("line", LineLock(*ends, frame), self.softness)


@pytest.mark.slow
def test_steps_blow_up_a_thick_cylinder_as_hill_says(layers=10):
    """Plane strain, without hardening, by steps from rest so long that inertia is little. Yield is far below Young's
    modulus: near collapse the pressure on a bore that grows would otherwise be felt."""
    inner, outer, angle, yields = 1.0, 2.0, 0.1, YIELD / 100
    mesh = jf.mesh.box((outer - inner, angle, angle), (layers, 1, 1))
    radius, turn = inner + mesh.points[:, 0], mesh.points[:, 1]
    points = np.stack([radius * np.cos(turn), radius * np.sin(turn), mesh.points[:, 2]], 1)
    bent = jf.TetMesh(points, mesh.cells)
    within = bent.surface[np.isclose(mesh.points[bent.surface, 0], 0.0).all(axis=1)]
    law = jf.J2Plastic(young=YOUNG, poisson=POISSON, yield_stress=yields)
    body = jf.SoftBody(bent, material=law, density=1e3, strain="nodal_volume", loads=[jf.Pressure(within, 1.0)])
    scene = jf.Scene([body], gravity=(0, 0, 0), joints=[Rays(body, None)])
    model, params, state = jf.build(scene, solver="condensed", tolerance=1e-8)
    rim, shear = np.isclose(radius, outer), yields / np.sqrt(3)
    for edge in (1.0, 1.4, 1.8):  # radius to which it has yielded
        pressure = shear * (2 * np.log(edge / inner) + 1 - (edge / outer) ** 2)
        resting = state.replace(velocities=0 * state.velocities)
        state, info = jf.step(model, params.replace(loads=(jnp.asarray(pressure),)), resting, 4 * STILL)
        assert int(info.status) == 0 and (int(info.counts["flowing"]) > 0) >= (edge > 1.1)
        moved = np.mean(np.hypot(*np.asarray(state.positions)[rim, :2].T) - outer)
        wanted = 2 * shear * (1 - POISSON**2) * edge**2 / (YOUNG * outer)
        np.testing.assert_allclose(moved, wanted, rtol=0.01)


def test_thick_cylinder_under_pressure(strain="nodal_volume"):
    """Hill's solution, plane strain, without hardening: a sector whose layers move along their radii alone."""
    inner, outer, angle, height, layers = 1.0, 2.0, 0.1, 0.1, 16
    mesh = jf.mesh.box((outer - inner, angle, height), (layers, 1, 1))
    radius, turn = inner + mesh.points[:, 0], mesh.points[:, 1]
    points = np.stack([radius * np.cos(turn), radius * np.sin(turn), mesh.points[:, 2]], 1)
    law = jf.J2Plastic(young=YOUNG, poisson=POISSON, yield_stress=YIELD)
    body = jf.SoftBody(jf.TetMesh(points, mesh.cells), material=law, density=1e3, strain=strain)
    model, params, state = jf.build(jf.Scene([body]))
    layer = jnp.asarray(np.round((radius - inner) / (outer - inner) * layers).astype(int))
    along = jnp.asarray(np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1))

    def places(moved):
        return model.rest + moved[layer][:, None] * along

    def energy(moved, internal, pressure):
        area = inner * np.sin(angle) * height
        return total(model, params, internal, places(moved)) - pressure * area * moved[0]

    @jax.jit
    def rest(moved, state, pressure):
        def closer(_, moved):
            slope = jax.grad(energy)(moved, state.internal, pressure)
            return moved - jnp.linalg.solve(jax.hessian(energy)(moved, state.internal, pressure), slope)

        moved = jax.lax.fori_loop(0, 12, closer, moved)
        left = jnp.abs(jax.grad(energy)(moved, state.internal, pressure)).max()
        return moved, state.replace(internal=committed(model, params, state, places(moved), jnp.ones(()))[0]), left

    shear = YIELD / np.sqrt(3)
    moved = jnp.zeros(layers + 1)
    for edge in (1.0, 1.2, 1.4, 1.6, 1.8):  # radius to which it has yielded
        pressure = shear * (2 * np.log(edge / inner) + 1 - (edge / outer) ** 2)
        moved, state, left = rest(moved, state, pressure)
        assert float(left) < 1e-9 * YIELD
        wanted = 2 * shear * (1 - POISSON**2) * edge**2 / (YOUNG * outer)
        np.testing.assert_allclose(moved[-1], wanted, rtol=0.01)


def total(model, params, internal, positions):
    """Energy of a step that ends at `positions`, from what is remembered."""
    energy = 0.0
    for each, material, own in zip(model.domains, domain_materials(model, params), internal, strict=True):
        gradient = finite.displacement_gradient(each, positions)
        energy = energy + finite.energy(each, material.replace(internal=own), None, gradient)
    return energy


@pytest.mark.slow
def test_the_loop_converges_quadratically_where_it_yields():
    """Newton's method with the step's own matrix, from elastic to half plastic; and the step comes to the same."""
    model, params, state = bar(0.0, tolerance=1e-12, strain="smoothed", fixed="x-")
    pull = jnp.zeros_like(model.rest).at[jnp.asarray(BAR.nodes("x+")), 2].set(-1.5)
    free = jnp.flatnonzero(jnp.repeat(model.free, 3))

    @jax.jit
    def closer(v):
        system = step_system(model, params, state, jnp.asarray(1.0), pull)
        matrix, pattern = condensed_matrix(linearised(system, v)), model.pattern

        def product(flat):
            vector = jnp.zeros(v.size).at[free].set(flat).reshape(v.shape)
            return pattern.scattered(matrix.apply(pattern.gathered(vector))).reshape(-1)[free]

        dense = jax.vmap(product)(jnp.eye(len(free)))
        slope = momentum_gradient(system, v)
        change = jnp.linalg.solve(dense, slope.reshape(-1)[free])
        return v - jnp.zeros(v.size).at[free].set(change).reshape(v.shape), jnp.linalg.norm(slope)

    v, left = jnp.zeros_like(model.rest), []
    for _ in range(9):
        v, size = closer(v)
        left.append(float(size))
    left = np.array(left) / left[0]
    k = np.flatnonzero(left < 1e-5)[0]
    assert k < 8 and left[k] < 30 * left[k - 1] ** 1.7, left  # digits near double each time
    end, info = jf.step(model, params, state, STILL, forces=pull)
    assert int(info.status) == 0 and 0 < int(info.counts["flowing"])
    np.testing.assert_allclose(end.velocities, v, atol=1e-9 * float(jnp.abs(v).max()))
