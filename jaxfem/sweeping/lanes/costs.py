"""What a variant costs: how far it will be deformed, which is what the modes at rest, exact there, do not know of.

With the acceleration q and the speed v of a mode of frequency w, in a time T it comes to about
    min(q T^2 / 2, 2 q / w^2) + |v| min(T, 1 / w).
"""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.loads import load_force
from jaxfem.model import Model, Params, State
from jaxfem.sweeping.engines.base import Task
from jaxfem.sweeping.lanes.body import Body
from jaxfem.sweeping.lanes.run import Values
from jaxfem.sweeping.lanes.steps import lane_of

Array = jax.Array
AT_ONCE = 32  # variants looked at together
STILL = 1e-9  # of the largest squared frequency: that of a mode in which a body moves as a whole


def deformations(task: Task, parts: tuple[Model, Params, State], body: Body, values: Values) -> Array:
    """Of each variant of `values` (V, ...), the root mean square of how far its nodes will be deformed, (V,)."""
    model, count = parts[0], body.free
    elastic = body.frequencies[:, 0] > STILL * body.frequencies.max()

    def modal(field: Array) -> Array:
        return body.shapes.T @ field[:count].reshape(-1).astype(body.shapes.dtype)

    def one(own: Values) -> Array:
        params, state, dt = task.variant(parts, own)
        lane, time = lane_of(model, body, params), dt * task.steps
        force = lane.weight + load_force(model.loads, params.loads, state.positions)[body.order]
        share = lane.mass / (lane.density * body.density)
        pull, speed = modal(force) / (lane.density * body.density), modal(share * state.velocities[body.order])
        squared = lane.stiffness * body.stiffness / (lane.density * body.density) * body.frequencies[:, 0]
        root = jnp.sqrt(jnp.where(elastic, squared, 1))
        reached = jnp.abs(pull) * jnp.minimum(time**2 / 2, 2 / root**2) + jnp.abs(speed) * jnp.minimum(time, 1 / root)
        start = modal(share * (state.positions - model.rest)[body.order])
        return jnp.sqrt((jnp.where(elastic, reached + jnp.abs(start), 0) ** 2).sum() / body.volumes.sum())

    found: Any = jax.lax.map(one, values, batch_size=AT_ONCE)
    return jnp.asarray(found)
