"""State of a scene, and what a step tells of itself."""

import dataclasses
from typing import Any

import jax

from jaxfem.pytrees import Pytree
from jaxfem.ranges import ranged, within
from jaxfem.rigid.dynamics import RigidState

Array = jax.Array


class Carry(Pytree):
    """What rounding dropped of places of `nodes` (n, 3) and rigid bodies' `centers` (b, 3) [m], and of `time` [s]."""

    nodes: Array
    centers: Array | None
    time: Array


class State(Pytree):
    """Where everything is: `positions` (n, 3) [m] and `velocities` (n, 3) [m/s] of all nodes, `time` () [s].

    `accelerations` (n, 3) [m/s^2] belong to the second-order scheme; None where they are unknown, as at the start: the
    next step then takes those that the forces give. Set them to None after moving a body by hand.
    `rigid`: poses and velocities of rigid bodies, None without them. `memory`: what the method keeps from one step to
    the next, its own affair; `jf.impulses` reads the impulses in it. It starts the solver, and affects a solution only
    through geometric stiffness, where a joint's pull on a rigid body is so strong that it must be treated implicitly
    (see `system/coupled.py`), and through the force that a body feels as it is struck (see `system/impacts.py`).
    `internal`: what materials with a memory remember, one entry for each kind of domains; None without such materials.
    `carry`: digits that single precision drops in short steps; None in double. `account`: energy that steps book, by
    kind [J] (see `with_account`); None where no account is kept.
    """

    positions: Array = dataclasses.field(metadata=within())
    velocities: Array = dataclasses.field(metadata=within())
    time: Array = dataclasses.field(metadata=within())
    memory: Any = dataclasses.field(default=None, metadata=ranged(None))
    accelerations: Array | None = dataclasses.field(default=None, metadata=within())
    rigid: RigidState | None = None
    internal: Any = dataclasses.field(default=None, metadata=within())
    carry: Carry | None = dataclasses.field(default=None, metadata=ranged(None))
    account: dict[str, Array] | None = dataclasses.field(default=None, metadata=ranged(None))


class StepInfo(Pytree):
    """How a step went: `status` (see `jaxfem.solvers.describe`), `iterations`, relative `residual`, counts of rows
    exactly at a bound (`weakly_active`, where derivatives are one-sided) and of `inverted` elements after the step.

    `scheme_damping`: damping ratio that the time scheme itself gives to the frequencies that `prepare` was given, in
    their shape; None without them. `substeps`: in how many parts the step was taken, where `rollout` takes failed ones
    again in halves; else None. `spin_loss`: the largest share of its angular momentum that a soft body which
    nothing holds lost, loads apart, to the time scheme or to what it touches; None where there is no such body.
    `counts`: how many domains of strain a law with a memory reports something of, by its word, such as "at_yield": at
    the edge of yield, where derivatives are one-sided; None where no law counts anything. `beyond_cone`: at how many
    points friction was more than the coefficient times the normal force, as the default pyramid allows along its
    diagonals, up to 1.41 times (`Contact(cone=True)` does not); None where all friction is in cones.
    """

    status: Array
    iterations: Array
    residual: Array
    weakly_active: Array
    inverted: Array
    scheme_damping: Array | None = None
    substeps: Array | None = None
    spin_loss: Array | None = None
    counts: dict[str, Array] | None = None
    beyond_cone: Array | None = None
