"""What free bodies keep: linear momentum whatever the tolerance of a solve, and angular momentum whatever their strain.

A solve ends with a residual r, and M (v - v*) = J' lam + r. Elastic rows neither push nor turn a body as a whole, so
    sum M (v - v*) = sum J' lam,   sum x0 x M (v - v*) = sum x0 x J' lam,   J and lam of the other rows alone,
and what r, or elastic rows linearised at a deformed shape, leave of that is taken out as a rigid velocity of the body.
Where positions move along the new velocities, x1 = x0 + dt v, this is the angular momentum of the end too:
sum x1 x M v = sum x0 x M v.

Bodies that push each other move as one in this, so that what holds between them holds still. What is pushed from
outside is not turned, nor shifted against what holds it: along the push, or where there is friction at all. The next
step would have to take that back. Nor is turned what has rigid bodies in it.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxfem.elements.mass import SharedMass
from jaxfem.indexing import gather, scatter_add
from jaxfem.model import Drifting, Model, Params, State, nodal_mass, shared_mass
from jaxfem.rows.bounds import Impulses
from jaxfem.system import rigid_part
from jaxfem.system.rigid_part import arms, cross, divided, spins
from jaxfem.system.soft import System, external_force
from jaxfem.tensors import contract

Array = jax.Array

PUSHED = {True: 1e-9, False: 1e-4}
"""Net impulse, as a share of the sum of impulses, from which bodies are pushed from outside; double and single."""


ROUNDING = 8.0
"""Times the precision and the momentum of a body's nodes: what is no loss of spin."""


class _Groups(NamedTuple):
    """Which bodies move as one: `of` (p,) for each point, their `number`, and for each group (g,), as 0 or 1, whether
    no joint or support holds it, `loose`, whether nothing outside pushes it either, `unpushed`, and whether it is soft
    too, `alone`."""

    of: Array
    number: int
    loose: Array
    unpushed: Array
    alone: Array

    def sums(self, values: Array) -> Array:
        """Sums (g, ...) of values (p, ...) of the points."""
        return scatter_add(values, self.of[: values.shape[0]], self.number)

    def spread(self, values: Array, points: int) -> Array:
        """Each of the first `points`' own of values (g, ...) of the groups."""
        return gather(values, self.of[:points])


def kept(model: Model, system: System, places: Array, velocities: Array, impulses: Impulses | None) -> Array:
    """Velocities (n, 3) found in a step from `places` (nodes, 3), with the momentum that free bodies keep.

    `impulses`: those of the extra rows. Differentiable, in the places too: `system.positions` are held fixed.
    """
    drifting = model.drifting
    if drifting is None:
        return velocities
    points, nodes = drifting.body.shape[0], model.nodes
    push, size = _pushes(system, impulses, points)
    groups = _groups(drifting, push, size, bool(system.extra))
    mass = system.mass[:points, None]
    defect = mass * (velocities - system.target)[:points] - push
    if system.shared_mass is not None and system.before is not None:
        defect = defect + system.shared_mass.apply(velocities - system.before)
    shift = -divided(groups.sums(defect), groups.sums(mass)) * groups.loose[:, None]
    bound = shift if system.friction else _along(shift, groups.sums(push))
    shift = shift - bound * (1 - groups.unpushed)[:, None]
    change = shift[groups.of]
    if model.scheme.straight:
        arm = arms(groups, mass[:nodes], places)
        torque = groups.sums(cross(arm, defect[:nodes]))
        spin = -spins(_inertia(groups, system.shared_mass, mass[:nodes], arm), torque) * groups.alone[:, None]
        change = change.at[:nodes].add(cross(groups.spread(spin, nodes), arm))
    moving = (system.free[:points] > 0)[:, None]
    return velocities.at[:points].add(jnp.where(moving, change, 0))


def turns_ahead(model: Model, params: Params, state: State, dt: Array) -> Array | None:
    """By how much each soft body will have turned as a whole at the end of a step, (bodies, 3, 3), where that is far.

    See `rigid_part.py`. None where no body is loose, and for schemes that know better.
    """
    if model.drifting is None or not model.scheme.straight:
        return None
    return rigid_part.turns_ahead(_angles(model, params, state, dt))


def turning_status(model: Model, params: Params, state: State, dt: Array, status: Array) -> Array:
    """The status of a step from `state`: that given, or where it is 0 that of a body which turns too far in it.

    Of soft bodies that nothing holds.
    """
    if model.drifting is None or not model.bodies:
        return status
    angle = _angles(model, *jax.lax.stop_gradient((params, state, dt)))
    return rigid_part.turning_status(model.bodies, model.scheme.straight, angle, status)


def _angles(model: Model, params: Params, state: State, dt: Array) -> Array:
    """Rotation vectors (bodies, 3) of each soft body's turn as a whole in a step, zero where something holds it."""
    groups, mass = _soft_bodies(model), nodal_mass(model, params.density)[:, None]
    return rigid_part.angles(groups, mass, state.positions, state.velocities, dt) * groups.loose[:, None]


def _soft_bodies(model: Model) -> _Groups:
    """Each soft body by itself, from its nodes."""
    assert model.drifting is not None
    count = len(model.bodies)
    loose = model.drifting.loose[:count]
    return _Groups(model.drifting.body[: model.nodes], count, loose, loose, loose)


def spin_loss(model: Model, params: Params, before: State, after: State, dt: Array, forces: Array | None) -> Array:
    """The largest share of its angular momentum about its centre that a body lost in a step, torques of loads apart.

    Of bodies that nothing holds; relative to sum m |x| |v| about the centre. Where joints or contacts pushed it, what
    they did is in it.
    """
    params, before, after, dt, forces = jax.lax.stop_gradient((params, before, after, dt, forces))
    groups = _soft_bodies(model)
    mass, shared = nodal_mass(model, params.density)[:, None], shared_mass(model, params.density)
    ends, noise = [], jnp.zeros(groups.number, mass.dtype)
    for state in (before, after):
        arm = arms(groups, mass, state.positions)
        mean = divided(groups.sums(mass * state.velocities), groups.sums(mass))
        own = state.velocities - mean[groups.of]
        momentum = mass * own if shared is None else mass * own + shared.apply(own)
        size = groups.sums(jnp.linalg.norm(arm, axis=1, keepdims=True) * jnp.linalg.norm(momentum, axis=1)[:, None])
        ends.append((groups.sums(jnp.cross(arm, momentum)), size[:, 0], arm))
        pace = jnp.linalg.norm(mass * state.velocities, axis=1, keepdims=True)
        noise += groups.sums(jnp.linalg.norm(arm, axis=1, keepdims=True) * pace)[:, 0]
    load = external_force(model, params, before.positions, forces)
    change = ends[1][0] - ends[0][0] - dt * groups.sums(jnp.cross(ends[0][2], load))
    scale = jnp.maximum(ends[0][1], ends[1][1])
    # A body that hardly turns has no more spin than the rounding of its way makes.
    lost = jnp.maximum(jnp.linalg.norm(change, axis=1) - ROUNDING * jnp.finfo(mass.dtype).eps * noise, 0)
    share = lost / jnp.where(scale > 0, scale, 1)
    return jnp.max(share * groups.loose)


def _pushes(system: System, impulses: Impulses | None, points: int) -> tuple[Array, Array]:
    """J' lam of the extra rows on each point (p, 3), and the sum of the sizes of its parts (p,)."""
    total = jnp.zeros((system.target.shape[0], 4), system.target.dtype)
    for name, rows in system.extra.items():
        assert impulses is not None
        parts = contract("mrk,mr->mk", rows.jacobian, impulses[name]).reshape(*rows.triples.shape, 3)
        size = jnp.linalg.norm(jax.lax.stop_gradient(parts), axis=-1, keepdims=True)
        total = total.at[rows.triples].add(jnp.concatenate([parts, size], -1))
    return total[:points, :3], total[:points, 3]


def _groups(drifting: Drifting, push: Array, size: Array, tied: bool) -> _Groups:
    """Each body that no row pushes is a group, and so are those together that rows may tie."""
    body, count = drifting.body, drifting.loose.shape[0] // 2
    if not tied:
        loose = drifting.loose[:count]
        return _Groups(body, count, loose, loose, loose * drifting.soft[:count])
    bodies = _Groups(body, count, *[drifting.loose[:count]] * 3)
    touched = bodies.sums(size[:, None])[:, 0] > 0
    number = jnp.arange(count, dtype=body.dtype)
    groups = _Groups(jnp.where(touched, count + drifting.together, number)[body], 2 * count, *[drifting.loose] * 3)
    net = jnp.linalg.norm(groups.sums(jax.lax.stop_gradient(push)), axis=1)
    inner = net <= PUSHED[net.dtype.itemsize > 4] * groups.sums(size[:, None])[:, 0]
    return groups._replace(unpushed=drifting.loose * inner, alone=drifting.loose * drifting.soft * inner)


def _inertia(groups: _Groups, shared: SharedMass | None, mass: Array, arm: Array) -> Array:
    """Inertia of each group about its centre of mass, (g, 3, 3)."""
    own = rigid_part.inertia(groups, mass, arm)
    if shared is None:
        return own
    turns = [cross(axis[None], arm) for axis in jnp.eye(3, dtype=arm.dtype)]  # velocities of turning about each axis
    products = jnp.stack([jnp.sum(a * shared.apply(b), -1) for a in turns for b in turns], -1)
    return own + groups.sums(products).reshape(-1, 3, 3)


def _along(vectors: Array, axes: Array) -> Array:
    """The parts of vectors (g, 3) along `axes` (g, 3) of any length."""
    square = jnp.sum(axes**2, -1, keepdims=True)
    return jnp.sum(vectors * axes, -1, keepdims=True) * axes / jnp.where(square > 0, square, 1)
