"""Rotations of the end of the step: balance of forces, derivatives, rest, lanes and single precision."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes

import jaxfem as jf
from jaxfem.model import nodal_mass


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["condensed", "mprgp"])
@pytest.mark.parametrize("scheme", ["backward_euler", "generalized_alpha"])
def test_implicit_rotations_balance_forces_at_the_end_of_the_step(scheme, solver):
    """M dv = dt f where the scheme takes its forces, with the exact corotated force; explicit ones miss that."""
    from jaxfem.elements.elasticity import viscoelastic_force
    from jaxfem.model import domain_materials

    dt, miss = 3e-2, {}
    for rotations in ("explicit", "implicit") if solver == "condensed" else ("implicit",):
        build = {"scheme": scheme, "solver": solver, "rotation_update": rotations, "tolerance": 1e-10}
        model, params, state = scenes.beam((2, 1, 1), young=6e4, strain="smoothed", build=build)
        states, info = jf.rollout(model, params, state, dt, 2)
        state, end = (jax.tree.map(lambda leaf, k=k: leaf[k], states) for k in (0, 1))
        assert info.status[1] == 0
        materials = domain_materials(model, params)

        def force(x, v, model=model, params=params, materials=materials):
            return viscoelastic_force(model.domains, x, v, materials, model.rotation_kind)

        mass = np.asarray(nodal_mass(model, params.density))[:, None]
        weight = mass * np.asarray(params.gravity)
        free = np.asarray(model.free) > 0
        if scheme == "backward_euler":
            inertia = mass * (end.velocities - state.velocities) / dt
            pull = force(end.positions, end.velocities)
        else:
            m, f = (2 * 0.8 - 1) / 1.8, 0.8 / 1.8
            inertia = mass * ((1 - m) * end.accelerations + m * state.accelerations)
            pull = force((1 - f) * end.positions + f * state.positions, (1 - f) * end.velocities + f * state.velocities)
        left = np.asarray(inertia - pull - weight)[free]
        miss[rotations] = np.abs(left).max() / np.abs(np.asarray(pull)).max()
    assert miss["implicit"] < 1e-7 < 1e-4 < miss.get("explicit", 1), miss


def test_one_long_implicit_step_is_the_equilibrium():
    """With inertia and damping out of the way a step leads to rest at once, through half a right angle."""
    build = {"rotation_update": "implicit", "tolerance": 1e-9}
    model, params, state = scenes.beam((4, 1, 1), young=8e3, damping=0.0, build=build)
    end, info = jf.step(model, params, state, 1e3)
    rest, found = jf.equilibrium(model, params, state)
    assert info.status == 0 and found.status == 0
    sag = float(jnp.abs(rest.positions - state.positions).max())
    assert sag > 0.05
    np.testing.assert_allclose(end.positions, rest.positions, atol=1e-6 * sag)


@pytest.mark.slow
def test_derivatives_through_implicit_rotations():
    """jvp = vjp = differences in E, nu, beta, dt and the start, in a batch too, also with an element inside out."""
    build = {"rotation_update": "implicit", "tolerance": 1e-13}
    model, params, state = scenes.beam((1, 1, 1), strain="smoothed", build=build)

    def loss(z, positions):
        own = params.replace(young=params.young * z[0], poisson=z[1], damping=z[2] * 1e-3)
        moved = state.replace(positions=positions, velocities=state.velocities + z[4])
        states, info = jf.rollout(model, own, moved, z[3] * 1e-2, 2)
        return jnp.sum((states.positions[-1] - model.rest) ** 2), info.status

    z = jnp.array([1.0, 0.4, 2.0, 1.0, 0.1])

    # A program each for the run, forwards and backwards: together they take longer to compile.
    run = jax.jit(
        jax.vmap(lambda z, positions: jax.linearize(lambda z: loss(z, positions), z, has_aux=True), (None, 0))
    )
    forwards = jax.jit(jax.vmap(lambda push, direction: push(direction), (0, None)))
    backwards = jax.jit(jax.vmap(lambda push: jax.linear_transpose(lambda step: push(step), z)(jnp.ones(()))[0]))
    inside_out = state.positions.at[-1].add(jnp.array([-0.12, 0.0, 0.0]))
    starts, h = jnp.stack([state.positions, inside_out]), 1e-5
    _, push, status = run(z, starts)
    assert (status == 0).all()
    slopes = backwards(push)
    scales = jnp.abs(slopes).max(1)
    for i, unit in enumerate(jnp.eye(5)):
        (ahead, _, reached), (behind, _, left) = run(z + h * unit, starts), run(z - h * unit, starts)
        assert not reached.any() and not left.any()
        forward, numerical = forwards(push, unit), (ahead - behind) / (2 * h)
        for slope, scale, pushed, central in zip(slopes[:, i], scales, forward, numerical, strict=True):
            np.testing.assert_allclose(pushed, slope, rtol=1e-7, atol=1e-9 * float(scale))
            np.testing.assert_allclose(slope, central, rtol=5e-6, atol=1e-8 * float(scale))


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_implicit_rotations_come_to_rest(dtype):
    """At rest all forces cancel: what rounding leaves of them ends the rounds, and is no failure."""
    for young in (2.6e5, 1e8):
        build = {"rotation_update": "implicit", "dtype": dtype}
        model, params, state = scenes.beam((4, 1, 1), young=young, damping=2e-2, build=build)
        states, info = jf.rollout(model, params, state, 2e-2, 100)
        assert not info.status.any(), young
        assert info.iterations[50:].max() <= info.iterations[:5].max()
        speed = np.abs(np.asarray(states.velocities)).max((1, 2))
        assert speed[-1] < (2e-6 if dtype == jnp.float32 else 1e-8)


@pytest.mark.slow
def test_implicit_rotations_with_driven_nodes_lanes_and_single_precision():
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (3, 1, 1))
    motion = jf.Driven("x-", jf.Motion(velocity=(0.0, 0.0, 0.2)))
    body = jf.SoftBody(mesh, young=1e5, poisson=0.3, density=1000.0, damping=2e-3, driven=[motion])
    ends = {}
    for dtype in (jnp.float32, jnp.float64):
        model, params, state = jf.build(jf.Scene([body]), rotation_update="implicit", dtype=dtype)

        def end(young, model=model, params=params, state=state):
            states, info = jf.rollout(model, params.replace(young=young), state, 1e-2, 10)
            return states.positions[-1], info.status

        young = jnp.array([1e5, 4e5], dtype)
        together, status = jax.vmap(end)(young)
        assert not status.any()
        for lane, each in zip(together, young, strict=True):
            np.testing.assert_allclose(lane, end(each)[0], atol=1e-6 if dtype == jnp.float32 else 1e-9)
        held = mesh.points[:, 0] < 1e-9
        np.testing.assert_allclose(together[0][held, 2] - mesh.points[held, 2], 0.02, atol=1e-8)
        ends[dtype] = together
    np.testing.assert_allclose(ends[jnp.float32], ends[jnp.float64], atol=2e-5)
