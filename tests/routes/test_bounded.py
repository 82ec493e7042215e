"""The condensed route with extra rows: the row solver's answer and derivative, on random scenes and at special ones."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import row_scenes
from row_scenes import free_beam, random_scene, system_of

from jaxfem.routes.bounded import pair_gradient
from jaxfem.routes.solution import solve_system
from jaxfem.routes.system import extra_rows

SEEDS = range(20)
TOLERANCE = {jnp.float64: 1e-9, jnp.float32: 1e-5}
NAMES = ("young", "density", "damping", "gravity")


def solver(model, route):
    """(params, state, rows, weights) -> weighted sum of the velocities, its gradient in params and rows, velocities."""

    def value(inputs, state, weights):
        params, rows = inputs
        system = system_of(model, params, state, rows)
        elastic = [jnp.zeros(each.bias.shape, each.bias.dtype) for each in system.rows[: -len(rows)]]
        impulses = (*elastic, *[jnp.zeros_like(each.bias) for each in rows]) if route == "mprgp" else None
        velocities, _, info = solve_system(system, route, state.velocities, impulses)
        return jnp.vdot(weights, velocities), (velocities, info)

    return jax.jit(jax.value_and_grad(value, has_aux=True, allow_int=True))


@pytest.fixture(scope="module")
def exact():
    """What MPRGP finds at a tolerance of 1e-12 in double precision, for each scene as single precision rounds it."""
    model, params, state = free_beam(jnp.float64, 1e-12)
    solve = solver(model, "mprgp")
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


@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
def test_twenty_scenes_give_the_row_solvers_answer_and_gradient(exact, dtype):
    model, _, _ = free_beam(dtype, TOLERANCE[dtype])
    solve = solver(model, "condensed")
    bound = 10 * TOLERANCE[dtype]
    worst = np.zeros(2)
    for seed, ((_, (velocities, _)), gradient) in zip(SEEDS, exact, strict=True):
        (params, state, rows), weights = scene_in(dtype, seed)
        (_, (found, info)), own = solve((params, rows), state, weights)
        assert info.status == 0 and found.dtype == dtype
        slopes = [relative_slopes(each, params, rows) for each in (own, gradient)]
        worst = np.maximum(worst, [error(found, velocities), error(*slopes)])
    assert (worst <= bound).all(), worst
