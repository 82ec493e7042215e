"""Steps with extra rows, drawn at random: contacts with box friction, tethers over eight triples, weak motors."""

from collections import OrderedDict

import jax.numpy as jnp
import numpy as np
import scenes

from jaxfem.methods.nodes.condensed import coarse_of
from jaxfem.rows.points import PointRows
from jaxfem.system.soft import step_system

DT = 1 / 60


def free_beam(dtype=None, tolerance=1e-9):
    """A beam of 72 elements, one end held; (model, params, state)."""
    build = {"dtype": dtype, "tolerance": tolerance}
    return scenes.beam((6, 1, 2), (0.12, 0.02, 0.04), build=build)


def random_scene(seed, model, params, state):
    """Material, load, shape and rows of one scene: (params, state, rows), of the same shapes for every seed."""
    rng = np.random.default_rng(seed)
    dtype = state.positions.dtype
    free = np.asarray(model.free)[:, None]
    young = 10 ** rng.uniform(4, 8)
    strained = 1e-3 * (1e4 / young) ** 0.5  # m; as much energy in a stiff body as in a soft one
    material = params.replace(
        young=jnp.asarray(young, dtype),
        poisson=jnp.asarray(rng.uniform(0, 0.45), dtype),
        damping=jnp.asarray(rng.choice([0.0, 2e-3]), dtype),
        gravity=jnp.asarray(rng.normal(0, 10, 3), dtype),
    )
    start = state.replace(
        positions=state.positions + jnp.asarray(strained * rng.normal(size=(*free.shape[:1], 3)) * free, dtype),
        velocities=jnp.asarray(0.3 * rng.normal(size=(*free.shape[:1], 3)) * free, dtype),
    )
    rows = (*contacts(rng, model.nodes, dtype), tethers(rng, model.nodes, dtype), motors(rng, model.nodes, dtype))
    return material, start, rows


def system_of(model, params, state, rows):
    """The step's system with the rows in it."""
    system = step_system(model, params, state, jnp.asarray(DT, state.positions.dtype))
    return system.replace(extra=OrderedDict((f"rows {number}", each) for number, each in enumerate(rows)))


def solved(method, system, state):
    """A method's solution of the step, from no impulses."""
    zeros = OrderedDict((name, jnp.zeros_like(rows.bias)) for name, rows in method.solved_rows(system).items())
    return method.solve(system, None, coarse_of(system), state.velocities, zeros)


def contacts(rng, nodes, dtype):
    """Normal rows that may only push, and friction within a box, at eleven nodes (one of them twice)."""
    at = rng.integers(0, nodes, (12, 1))
    at[1] = at[0]
    normal = rng.normal(size=(12, 1, 3))
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    sides = np.linalg.svd(normal)[2][:, 1:]
    compliance = 10 ** rng.uniform(-9, 0)
    push = _rows(at, normal, compliance, rng.normal(0, 0.3, (12, 1)), nodes, dtype, 0.0, np.inf)
    limit = 10 ** rng.uniform(-4, -1)
    return push, _rows(at, sides, compliance, np.zeros((12, 2)), nodes, dtype, -limit, limit)


def tethers(rng, nodes, dtype):
    """Two points of the body, each a mean of four nodes, kept together: no bounds."""
    at = np.stack([rng.choice(nodes, 8, replace=False) for _ in range(2)])
    weights = np.concatenate([rng.dirichlet(np.ones(4), 2), -rng.dirichlet(np.ones(4), 2)], axis=1)
    jacobian = np.einsum("mk,ij->mikj", weights, np.eye(3)).reshape(2, 3, 24)
    return _rows(at, jacobian, 10 ** rng.uniform(-9, -2), rng.normal(0, 0.1, (2, 3)), nodes, dtype)


def motors(rng, nodes, dtype):
    """Relative velocities of node pairs, held to a value as far as a bound allows."""
    at = np.stack([rng.choice(nodes, 2, replace=False) for _ in range(4)])
    limit = 10 ** rng.uniform(-4, -1)
    return _rows(at, rng.normal(size=(4, 2, 6)), 1e-6, rng.normal(size=(4, 2)), nodes, dtype, -limit, limit)


def _rows(at, jacobian, compliance, bias, nodes, dtype, lower=None, upper=None):
    full = [None if v is None else jnp.full(bias.shape, v, dtype) for v in (compliance, lower, upper)]
    arrays = jnp.asarray(jacobian, dtype), full[0], jnp.asarray(bias, dtype)
    return PointRows(jnp.asarray(at, jnp.int32), *arrays, nodes, full[1], full[2])
