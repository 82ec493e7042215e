"""Digits of positions that single precision drops in short steps, carried to the next (Kahan 1965; Moeller 1965)."""

import jax
import jax.numpy as jnp

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


def first_carry(state: State) -> Carry | None:
    """Nothing dropped yet; None in double precision, which needs no carry."""
    if state.positions.dtype.itemsize > 4:
        return None
    centers = None if state.rigid is None else jnp.zeros_like(state.rigid.positions)
    return Carry(jnp.zeros_like(state.positions), centers, jnp.zeros_like(state.time))


def _sum(old: Array, change: Array, dropped: Array) -> tuple[Array, Array]:
    """old + change + dropped, and what rounding drops of that."""
    whole = change + dropped
    new = old + whole
    return new, jax.lax.stop_gradient(whole - (new - old))
