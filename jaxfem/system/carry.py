"""Digits of positions that single precision drops, carried to the next step (Kahan 1965; Moeller 1965).

Strains and gaps of contacts are taken with them: a metre from the origin the rounding of positions is a strain of 1e-6
in elements of a few centimetres, a kilometre away one of 1e-3; that of the deformation gradient is 1e-7.
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.model import Carry, State

Array = jax.Array


def increments_only(state: State) -> State:
    """The state at the origin, where a step yields by how much each position changes, to all digits."""
    rigid = state.rigid
    at_origin = None if rigid is None else rigid.replace(positions=jnp.zeros_like(rigid.positions))
    return state.replace(positions=jnp.zeros_like(state.positions), rigid=at_origin)


def carried(state: State, following: State, dt: Array) -> State:
    """The state that follows `state`, from one that holds the changes of positions, and what its sums have dropped."""
    carry = state.carry
    assert carry is not None
    positions, nodes = _sum(state.positions, following.positions, carry.nodes)
    time, instant = _sum(state.time, dt, carry.time)
    rigid, centers = following.rigid, carry.centers
    if rigid is not None and state.rigid is not None and centers is not None:
        places, centers = _sum(state.rigid.positions, rigid.positions, centers)
        rigid = rigid.replace(positions=places)
    return following.replace(positions=positions, time=time, rigid=rigid, carry=Carry(nodes, centers, instant))


def dropped_of(state: State) -> Array | None:
    """What rounding has dropped of places (n, 3) of nodes and rigid bodies, zero for their turns; None in double."""
    carry = state.carry
    if carry is None or carry.centers is None:
        return None if carry is None else carry.nodes
    return jnp.concatenate([carry.nodes, carry.centers, jnp.zeros_like(carry.centers)])


def first_carry(state: State, points: np.ndarray) -> Carry | None:
    """What `state` has dropped of nodes placed at `points` (n, 3) in double precision; None where that is its own."""
    if state.positions.dtype.itemsize > 4:
        return None
    nodes = jnp.asarray(points - np.asarray(state.positions, float), state.positions.dtype)
    centers = None if state.rigid is None else jnp.zeros_like(state.rigid.positions)
    return Carry(nodes, centers, jnp.zeros_like(state.time))


def without_carry(state: State) -> State:
    """The state with nodes that are exactly where it says."""
    if state.carry is None:
        return state
    return state.replace(carry=state.carry.replace(nodes=jnp.zeros_like(state.positions)))


def _sum(old: Array, change: Array, dropped: Array) -> tuple[Array, Array]:
    """old + change + dropped, and what rounding drops of that."""
    whole = change + dropped
    new = old + whole
    return new, jax.lax.stop_gradient(whole - (new - old))
