"""The condensed route with extra rows: the row solver's answer and derivative, on random scenes and at special ones."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivatives import Parted
from row_scenes import free_beam, random_scene, solved, system_of

import jaxfem as jf
from jaxfem.methods import Condensed, Mprgp

SEEDS = range(20)
TOLERANCE = {jnp.float64: 1e-9, jnp.float32: 1e-5}
NAMES = ("young", "density", "damping", "gravity")


def solver(model, method):
    """(params, state, rows, weights) -> weighted sum of the velocities, its gradient in params and rows, velocities."""

    def value(inputs, state, weights):
        params, rows = inputs
        system = system_of(model, params, state, rows)
        found = solved(method, system, state)
        return jnp.vdot(weights, found.velocities), (found.velocities, found.info)

    return jax.jit(jax.value_and_grad(value, has_aux=True, allow_int=True))


@pytest.fixture(scope="module")
def exact():
    """What MPRGP finds at a tolerance of 1e-12 in double precision, for each scene as single precision rounds it."""
    model, _, _ = free_beam(jnp.float64, 1e-12)
    solve = solver(model, Mprgp())
    found = []
    for seed in SEEDS:
        inputs, weights = scene_in(jnp.float32, seed)
        widened = jax.tree.map(lambda x: x.astype(jnp.float64) if x.dtype == jnp.float32 else x, inputs)
        found.append(solve((widened[0], widened[2]), widened[1], weights.astype(jnp.float64)))
    return found


def scene_in(dtype, seed):
    """A scene's values, rounded to single precision, in `dtype`; and weights of the velocities."""
    scene = random_scene(seed, *free_beam(jnp.float32, 1e-5))
    weights = jnp.asarray(np.random.default_rng(seed).normal(size=scene[1].positions.shape), jnp.float32)
    return jax.tree.map(lambda x: x.astype(dtype) if x.dtype == jnp.float32 else x, (scene, weights))


def relative_slopes(gradient, params, rows):
    """Derivatives in relative changes of the material and in the rows' biases, as one vector."""
    material = [np.ravel(getattr(gradient[0], name) * getattr(params, name)) for name in NAMES]
    return np.concatenate(material + [np.ravel(part.bias) for part in gradient[1]])


def error(found, expected):
    """Largest difference relative to the expected array's size."""
    expected = np.asarray(expected, np.float64)
    return np.linalg.norm(np.asarray(found, np.float64) - expected) / max(np.linalg.norm(expected), 1e-300)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
def test_twenty_scenes_give_the_row_solvers_answer_and_gradient(exact, dtype):
    model, _, _ = free_beam(dtype, TOLERANCE[dtype])
    solve = solver(model, Condensed())
    bound = 10 * TOLERANCE[dtype]
    errors = []
    for seed, ((_, (velocities, _)), gradient) in zip(SEEDS, exact, strict=True):
        (params, state, rows), weights = scene_in(dtype, seed)
        (_, (found, info)), own = solve((params, rows), state, weights)
        assert info.status == 0 and found.dtype == dtype
        slopes = [relative_slopes(each, params, rows) for each in (own, gradient)]
        errors.append([error(found, velocities), error(*slopes)])
    off, slopes_off = np.transpose(errors)
    assert slopes_off.max() <= bound
    # Where a soft body is held by stiff rows, a small residual leaves a larger error: MPRGP's own, at the same
    # tolerance, is a thousand times larger still there.
    assert np.median(off) <= bound and off.max() <= 11 * bound


def solve_rows(model, params, state, rows, bias=0.0):
    """Velocities, the extra rows' impulses and info of one step."""
    moved = tuple(each.replace(bias=each.bias + bias) for each in rows)
    found = solved(Condensed(), system_of(model, params, state, moved), state)
    return found.velocities, tuple(found.impulses.values()), found.info


@pytest.mark.slow
def test_lanes_of_a_batch_are_what_each_is_alone():
    model, params, state = free_beam(tolerance=1e-12)
    scenes = [random_scene(seed, model, params, state) for seed in (0, 3, 8)]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenes)
    together, impulses, info = jax.jit(jax.vmap(lambda scene: solve_rows(model, *scene)))(stacked)
    alone = jax.jit(lambda scene: solve_rows(model, *scene))
    for lane, scene in enumerate(scenes):
        velocities, own, each = alone(scene)
        np.testing.assert_allclose(together[lane], velocities, atol=1e-9)  # sums are ordered differently
        for a, b in zip(impulses, own, strict=True):
            np.testing.assert_allclose(a[lane], b, atol=1e-8)
        assert info.status[lane] == each.status == 0


@pytest.mark.slow
def test_derivatives_agree_with_differences():
    model, params, state = free_beam(tolerance=1e-12)
    material, start, rows = random_scene(5, model, params, state)
    weights = np.random.default_rng(1).normal(size=state.positions.shape)

    @Parted
    def loss(t):
        changed = material.replace(young=material.young * jnp.exp(t), density=material.density * jnp.exp(-t))
        velocities, impulses, _ = solve_rows(model, changed, start, rows, 0.1 * t)
        return jnp.vdot(weights, velocities) + jnp.sum(impulses[2])

    forward, (backward,), h = loss.forwards(0.0, direction=(1.0,)), loss.backwards(0.0), 1e-5
    np.testing.assert_allclose(forward, backward, rtol=1e-8)
    np.testing.assert_allclose(forward, (loss(h) - loss(-h)) / (2 * h), rtol=1e-6)


def test_a_row_that_touches_without_force_is_counted():
    """A contact that the free motion just reaches: at its bound, no force. MPRGP counts the same."""
    model, params, state = free_beam(tolerance=1e-11)
    push, *_ = random_scene(2, model, params, state)[2]
    system = system_of(model, params, state, ())
    free = jax.jit(functools.partial(solved, Condensed()))(system, state).velocities
    touching = push.replace(bias=(push.apply(free) - 1.0).at[4].add(1.0))
    bounded = system_of(model, params, state, (touching,))
    both = (jax.jit(functools.partial(solved, method)) for method in (Condensed(), Mprgp()))
    counts = [each(bounded, state).info.weakly_active for each in both]
    assert counts == [1, 1]


@pytest.mark.slow
@pytest.mark.parametrize("velocity", [(1.0, 0.0, 0.0), (0.6, -0.8, 0.0)])
def test_a_coefficient_of_zero_has_the_derivative_of_what_slides(velocity):
    """It was that of friction along both rows, of one sign whichever way the cube slid; with status 0."""
    cube = jf.SoftBody(jf.mesh.box((0.2, 0.2, 0.2), 1), young=1e5, poisson=0.0, density=1e3)
    scene = jf.Scene([cube], contacts=[jf.Contact(cube, jf.Plane(), friction=0.3)])
    model, params, state = jf.build(scene, solver="condensed", tolerance=1e-10)
    ((name, values),) = params.contacts.items()
    start = state.replace(velocities=jnp.broadcast_to(jnp.asarray(velocity), state.velocities.shape))

    @jax.jit
    def after(friction):
        rubbed = values.replace(friction=friction * jnp.ones_like(values.friction))
        return jf.step(model, params.replace(contacts={name: rubbed}), start, 1e-2)[0].velocities[:, :2]

    wanted = (after(1e-6) - after(0.0)) / 1e-6
    np.testing.assert_allclose(jax.jit(jax.jacrev(after))(0.0), wanted, atol=1e-5)
    np.testing.assert_allclose(jax.jit(jax.jacfwd(after))(0.0), wanted, atol=1e-5)
    assert np.abs(wanted).max() > 0.05


@pytest.mark.slow
@pytest.mark.parametrize("velocity", [(0.0, -1.0, 0.0), (0.0, 0.0, 0.0)])
def test_a_coefficient_of_zero_has_no_derivative_at_rest(velocity):
    cube = jf.SoftBody(
        jf.mesh.box((0.2, 0.2, 0.2), 1, origin=(1, 0, 1)), young=1e5, poisson=0.3, density=1e3, fixed="x-"
    )
    ball = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(0, 0, 0.1))
    scene = jf.Scene([cube, ball], contacts=[jf.Contact(ball, jf.Plane(), friction=0.3)])
    model, params, state = jf.build(scene, solver="condensed", tolerance=1e-10)
    ((name, values),) = params.contacts.items()
    start = state.replace(rigid=state.rigid.replace(velocities=jnp.asarray([velocity])))

    def after(friction):
        rubbed = values.replace(friction=friction * jnp.ones_like(values.friction))
        return jf.step(model, params.replace(contacts={name: rubbed}), start, 1e-2)[0].rigid.velocities[0, :2]

    wanted = -9.81e-2 * np.asarray(velocity)[:2]
    np.testing.assert_allclose(jax.jit(jax.jacrev(after))(0.0), wanted, atol=1e-9)
    np.testing.assert_allclose(jax.jit(jax.jacfwd(after))(0.0), wanted, atol=1e-9)
