"""What a variant costs, by what the modes that lanes share do not know of: how far it will be deformed, and that its
bulk modulus is another share of its shear modulus.

With the acceleration q and the speed v of a mode of frequency w, in a time T it comes to about
    min(q T^2 / 2, 2 q / w^2) + |v| min(T, 1 / w).
Iterations go with 1 + a sqrt(t) + b sqrt(|log k|), t the root mean square of that over the body's size and k the share
over that of the modes: fitted to beams of 192 elements with E over a factor of 100 and nu from 0.2 to 0.45, of which
half come within one iteration, nine in ten within two.
"""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.loads import load_force
from jaxfem.model import Model, Params, State
from jaxfem.sweeping.engines.base import Task
from jaxfem.sweeping.lanes.body import Body
from jaxfem.sweeping.lanes.increments import Lane
from jaxfem.sweeping.lanes.run import Values
from jaxfem.sweeping.lanes.steps import lane_of
from jaxfem.tensors import matmul

Array = jax.Array
AT_ONCE = 32  # variants looked at together
DEFORMED, OTHERWISE = 2.1, 2.4  # a and b
STILL = 1e-9  # of the largest squared frequency: that of a mode in which a body moves as a whole


def costs(task: Task, parts: tuple[Model, Params, State], body: Body, values: Values) -> Array:
    """Of each variant of `values` (V, ...), its iterations up to a factor, (V,)."""
    model = parts[0]

    def one(own: Values) -> Array:
        params, state, dt = task.variant(parts, own)
        lane = lane_of(model, body, params)
        far = _deformation(model, body, params, state, lane, dt * task.steps) / jnp.cbrt(body.volumes.sum())
        share = (1.5 * lane.lam.mean() / lane.mu.mean() + 1) / body.bulk
        return 1 + DEFORMED * jnp.sqrt(far) + OTHERWISE * jnp.sqrt(jnp.abs(jnp.log(share)))

    found: Any = jax.lax.map(one, values, batch_size=AT_ONCE)
    return jnp.asarray(found)


def _deformation(model: Model, body: Body, params: Params, state: State, lane: Lane, time: Array) -> Array:
    """The root mean square of how far a variant's nodes will be deformed, () [m]."""
    elastic = body.frequencies[:, 0] > STILL * body.frequencies.max()
    density = lane.density * body.density

    def modal(field: Array) -> Array:
        return matmul(body.shapes.T, field[: body.free_count].reshape(-1).astype(body.shapes.dtype))

    force = lane.weight + load_force(model.loads, params.loads, state.positions)[body.order]
    share = lane.mass / density
    pull, speed = modal(force) / density, modal(share * state.velocities[body.order])
    squared = lane.stiffness * body.stiffness / density * body.frequencies[:, 0]
    root = jnp.sqrt(jnp.where(elastic, squared, 1))
    reached = jnp.abs(pull) * jnp.minimum(time**2 / 2, 2 / root**2) + jnp.abs(speed) * jnp.minimum(time, 1 / root)
    start = modal(share * (state.positions - model.rest)[body.order])
    whole = (jnp.where(elastic, reached + jnp.abs(start), 0) ** 2).sum()
    return jnp.sqrt(whole / body.volumes.sum())
