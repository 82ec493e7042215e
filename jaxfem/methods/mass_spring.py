"""Masses and springs on the edges of the mesh: what finite elements are compared with, not a model of a material.

Springs have k L^2 summed over an element equal to 6 E V: their stiffness, averaged over directions, is then that of a
solid of Young's modulus E with Poisson's ratio 1/4, which central forces have whatever is asked (Cauchy 1828; Love
1906, note B). So each edge of an element adds k = E V / L^2; for a regular tetrahedron that is .118 E L, where Lloyd,
Szekely & Harders 2007 have 2 sqrt(2)/25 E L = .113 E L (`calibration="lloyd"`: right for elements near regular alone).

Implicit: backward Euler linearised at the start of the step (Baraff & Witkin 1998), with the transverse stiffness of
springs that are pushed left out, so that the matrix is definite. Explicit: symplectic Euler, stable where
    omega^2 (dt^2 + 2 dt beta) < 4   for the highest frequency omega.
"""

import warnings
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.declared.errors import AccuracyWarning
from jaxfem.materials.moduli import ratio_and_modulus
from jaxfem.methods.base import Elasticity, Facts, Method, Solved
from jaxfem.methods.ending import ended
from jaxfem.methods.node_blocks import (
    NodeCondition,
    NodePairs,
    NodeSystem,
    check_linear,
    check_polar,
    node_pairs,
    refuses_but_plain,
    rounding_floor,
)
from jaxfem.model import Model, Params, State, StepInfo, element_damping, element_stiffness, nodal_mass
from jaxfem.pytrees import Pytree, on_device
from jaxfem.solvers.implicit import implicit_solution
from jaxfem.solvers.status import SolveInfo, Status, caused
from jaxfem.system.drag import nodal_drag
from jaxfem.system.soft import external_force, prescribed_velocity
from jaxfem.tensors import inner

Array = jax.Array
INTEGRATIONS = ("implicit", "explicit")
CALIBRATIONS = ("volume", "lloyd")
OWN_POISSON = 0.25
POWERS = 40  # power iterations for the highest frequency, which they find to a per cent from below
TOO_LONG = "dt is above the stability limit of explicit springs: take a smaller step, or integration = implicit"


class Springs(Pytree):
    """Edges of the mesh: `ends` (s, 2) nodes, `of_element` (E, 6) the springs of each element; `pairs` of `ends`."""

    ends: Array
    of_element: Array
    pairs: NodePairs


class Limit(Pytree):
    """The `square` () of the highest frequency [1/s^2] at which springs of `stiffness` (s,) swing `mass` (n,)."""

    square: Array
    stiffness: Array
    mass: Array

    def square_with(self, stiffness: Array, mass: Array) -> Array:
        """That of others: right where all change alike, else no less than it is."""
        return self.square * jnp.max(stiffness / self.stiffness) * jnp.max(self.mass / mass)


class Stretch(Pytree):
    """Springs at a moment: `stiffness` and `viscosity` (s,) [N/m, N s/m], unit vectors `along` (s, 3), `length` and
    `rest` (s,) [m]."""

    stiffness: Array
    viscosity: Array
    along: Array
    length: Array
    rest: Array


class MassSpring(Method):
    """Springs in place of elements; `integration`: "implicit" or "explicit"; `calibration`: "volume" or "lloyd"."""

    integration: str = "implicit"
    calibration: str = "volume"
    name: ClassVar[str] = "mass_spring"

    def refuses(self, facts: Facts) -> str | None:
        """All but plain bodies with lumped masses under backward Euler, and settings that are not known."""
        for what, value, known in (
            ("integration", self.integration, INTEGRATIONS),
            ("calibration", self.calibration, CALIBRATIONS),
        ):
            if value not in known:
                return f"has {what} = {value!r}: give one of {', '.join(known)}"
        return refuses_but_plain(facts)

    def plan(self, model: Model, params: Params, state: State) -> Springs:
        """The springs; warns where another Poisson's ratio was asked for than springs have."""
        check_linear(model)
        check_polar(model)
        asked = np.asarray(ratio_and_modulus(*element_stiffness(model, params))[0])
        if np.abs(asked - OWN_POISSON).max() > 0.01:
            warnings.warn(
                "springs have Poisson's ratio 1/4, whatever is asked for; this scene asks for "
                f"{asked.flat[np.abs(asked - OWN_POISSON).argmax()]:g}",
                AccuracyWarning,
                stacklevel=6,
            )
        cells = np.asarray(model.elements.cells, np.int64)
        every = np.sort(cells[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]], axis=2)
        ends, place = np.unique(every.reshape(-1, 2), axis=0, return_inverse=True)
        return Springs(
            on_device(ends, jnp.int32), on_device(place.reshape(-1, 6), jnp.int32), node_pairs(ends, model.nodes)
        )

    def prepare(self, model: Model, params: Params, state: State, dt: Array) -> "Limit | None":
        """What bounds explicit steps; None for implicit ones."""
        if self.integration == "implicit":
            return None
        springs = stretched(model, params, model.rest, self.calibration)
        square = highest_square(model, params, self.calibration)
        return Limit(square, springs.stiffness, nodal_mass(model, params.density))

    def elasticity(self, model: Model, params: Params, positions: Array, rates: Array) -> Elasticity:
        """That of the springs and their dashpots."""
        springs = stretched(model, params, positions, self.calibration)
        pulled = 0.5 * jnp.sum(springs.stiffness * (springs.length - springs.rest) ** 2)
        slip = jnp.sum(springs.along * _ways(model.plan, rates), axis=1)
        return Elasticity(pulled, spring_force(model, springs, rates), jnp.sum(springs.viscosity * slip**2))

    def step(
        self, model: Model, params: Params, state: State, dt: Array, forces: Array | None, cache: Any
    ) -> tuple[State, StepInfo]:
        """One step, by whichever integration."""
        springs = stretched(model, params, state.positions, self.calibration)
        load = external_force(model, params, state.positions, forces)
        if self.integration == "implicit":
            system = spring_system(model, params, state, dt, springs, load)
            unknown, info = implicit_solution(NodeCondition(), system, state.velocities)
            return ended(model, params, state, dt, Solved(system.merged(unknown), None, info), forces=forces)
        mass, drag = nodal_mass(model, params.density)[:, None], nodal_drag(model, params)[:, None]
        force = load + spring_force(model, springs, state.velocities)
        moved = (state.velocities + dt * force / mass) / (1 + dt * drag)
        velocities = jnp.where(model.free[:, None] > 0, moved, prescribed_velocity(model, params, state, dt))
        beta = jnp.max(jax.lax.stop_gradient(element_damping(model, params)))
        square = jax.lax.stop_gradient(cache.square_with(springs.stiffness, mass[:, 0]))
        status = jnp.where(square * (dt**2 + 2 * dt * beta) > 4, caused(Status.INVALID_VALUE, TOO_LONG), 0)
        none = jnp.int32(0)
        info = SolveInfo(status.astype(jnp.int32), none, jnp.zeros((), mass.dtype), none)
        return ended(model, params, state, dt, Solved(velocities, None, info), forces=forces)


def stretched(model: Model, params: Params, positions: Array, calibration: str) -> Stretch:
    """The springs where the nodes are at `positions` (n, 3)."""
    plan: Springs = model.plan
    _, young = ratio_and_modulus(*element_stiffness(model, params))
    young, beta = (
        jnp.broadcast_to(each, model.elements.volumes.shape) for each in (young, element_damping(model, params))
    )
    volumes = model.elements.volumes[:, None]
    rest = jnp.linalg.norm(_ways(plan, model.rest), axis=1)
    own = rest[plan.of_element]
    each = young[:, None] * (volumes / own**2 if calibration == "volume" else 2 * np.sqrt(2) / 25 * own)
    none = jnp.zeros_like(rest)
    way = _ways(plan, positions)
    length = jnp.linalg.norm(way, axis=1)
    return Stretch(
        none.at[plan.of_element].add(each),
        none.at[plan.of_element].add(beta[:, None] * each),
        way / length[:, None],
        length,
        rest,
    )


def _ways(plan: Springs, field: Array) -> Array:
    """From the first end of each spring to its second, (s, 3)."""
    return field[plan.ends[:, 1]] - field[plan.ends[:, 0]]


def spring_force(model: Model, springs: Stretch, velocities: Array | None) -> Array:
    """Force (n, 3) [N] of the springs, and of their dashpots where `velocities` (n, 3) are given."""
    plan: Springs = model.plan
    pull = springs.stiffness * (springs.length - springs.rest)
    if velocities is not None:
        pull = pull + springs.viscosity * jnp.sum(springs.along * _ways(plan, velocities), 1)
    force = pull[:, None] * springs.along
    return jnp.zeros_like(model.rest).at[plan.ends[:, 0]].add(force).at[plan.ends[:, 1]].add(-force)


def spring_system(model: Model, params: Params, state: State, dt: Array, springs: Stretch, load: Array) -> NodeSystem:
    """M (v - v0) + dt alpha M v + (dt^2 K + dt beta K_axial) v = dt f, see the head of this file."""
    pairs, mass = model.plan.pairs, nodal_mass(model, params.density)
    axial = springs.along[:, :, None] * springs.along[:, None, :]
    unit = jnp.eye(3, dtype=mass.dtype)
    # A spring that is pushed gives way across: its stiffness there is negative, and left out.
    across = jnp.maximum(1 - springs.rest / springs.length, 0)[:, None, None] * (unit - axial)
    own = (dt**2 * springs.stiffness)[:, None, None] * (axial + across)
    own = own + (dt * springs.viscosity)[:, None, None] * axial
    signs = jnp.array([[1.0, -1.0], [-1.0, 1.0]], mass.dtype)
    matrix = pairs.summed(signs[:, :, None, None] * own[:, None, None])
    inertia = mass * (1 + dt * nodal_drag(model, params))
    load = dt * (load + spring_force(model, springs, None))
    return NodeSystem(
        pairs=pairs,
        matrix=matrix.at[:, :, :3].add(inertia[:, None, None] * unit),
        right=mass[:, None] * state.velocities + load,
        free=model.free[:, None] > 0,
        prescribed=prescribed_velocity(model, params, state, dt),
        scale=mass,
        floor=rounding_floor(mass, load, state.velocities),
        tolerance=model.tolerance,
        max_iterations=model.max_iterations,
    )


def highest_square(model: Model, params: Params, calibration: str) -> Array:
    """Square of the highest frequency of the springs at rest, () [1/s^2], by power iterations: from below."""
    springs = stretched(model, params, model.rest, calibration)
    mass, free = nodal_mass(model, params.density)[:, None], model.free[:, None]
    held = springs.replace(viscosity=springs.stiffness, length=springs.rest)

    def trip(_: Any, vector: Array) -> Array:
        moved = -free * spring_force(model, held, vector) / mass
        unit: Array = moved / jnp.linalg.norm(moved)
        return unit

    start = free * jax.random.normal(jax.random.key(0), model.rest.shape, model.rest.dtype)
    vector = jax.lax.fori_loop(0, POWERS, trip, start)
    moved = -spring_force(model, held, vector)
    square: Array = inner(vector, moved) / jnp.sum(mass * vector**2)
    return square
