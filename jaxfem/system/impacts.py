"""Impacts placed within a step: rigid bodies go on with their old velocity until something strikes, then with the new.

A step knows velocities at its ends. Taken from its start on, the velocity after a bounce puts positions out by up to a
step's way, which of them depends on where in the step the impact falls, and so derivatives of all that follows are
those of the program, at any step (Hu et al., DiffTaichi, 2020). Here, for a row with gap g, rate u before the step and
u + a h at its end if nothing struck, the gap closes after the share t of the step, and what the row asks for follows:
    g/h + t (u + a h / 2) + t^2 a h / 2 = 0,     u_- = u + (t + 1/2) a h,
    c = -e u_- + (1/2 - t) a h   (at least -t a h / 2, so that the gap is not negative at the end).
The bodies struck move by h (b v_old + (1 - b) v), where b = t (u + a h - c) / (u - c) makes the row's own way that of
the parabola: bounces under constant force are exact, but for the half step by which symplectic Euler's velocities lag.

A row without restitution whose force goes on pressing needs none of this: it arrives at the end of the step with what
is left of its velocity, and loses that in the next, so the impulse acts in the shares 1 - t and t of two steps, as does
that of friction (see `rows/contact.py`).
Bodies that joints tie are struck together, those that touch or strike each other too; the first impact in a step
counts. Two bodies that both move are struck with the arms that they have then (`meeting_arms.py`): those of the step's
start would not keep angular momentum. Bodies tied to soft ones are left out, as are rows that are softer than rigid.
"""

from collections import OrderedDict
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxfem.batching import cond_any
from jaxfem.indexing import gather
from jaxfem.rows.bounds import Friction
from jaxfem.rows.contact import Gaps
from jaxfem.rows.points import PointRows, pushes
from jaxfem.system.meeting_arms import BETWEEN, with_arms_when_struck

Array = jax.Array

FORCE_STEPS = 2.0
"""An impact changes a row's rate by more than so many steps of force; what is slower comes to rest."""
PLAUSIBLE = 0.25
"""Of a row's rate: what the impulses of the last step may add in this one. They are not those of a smooth motion
where something struck in it."""
PRESSING = 1e-6
"""Of a row's rate: what force changes of it in a step, beyond rounding, where it takes apart what has met."""
STILL = 1e-2
"""Of the gap at which bodies touch: a way in a step that is none."""
ROUNDS = 4
"""Bodies in contact with each other through which an impact is passed on."""


class Approach(NamedTuple):
    """One-sided rows (m, r) before a step: `side` 1 or -1, 0 where off; `gap` [m or rad] and `rate` [per s], both
    counted outwards; `restitution` (m, 1); `near`: gap below which they touch; `bodies` (m, k): numbers of
    rigid bodies, as many as there are for what is none."""

    rows: PointRows
    side: Array
    gap: Array
    rate: Array
    coming: Array
    restitution: Array
    near: Array
    bodies: Array


class Event(NamedTuple):
    """Rows (m, r) in a step: `due` where one is placed, `arrives` where it or another strikes, the `share` of the step
    until then, and what the rate asked for follows from: the `time` at which the gap closes, of the step, and the
    `change` of the rate by force."""

    due: Array
    arrives: Array
    share: Array
    time: Array
    change: Array


def gaps_of(rows: PointRows, dt: Array) -> Gaps:
    """Those of rigid limits and ropes, read off their bias; infinite where the row is soft."""
    gap = jnp.where(rows.compliance == 0, -_sides(rows) * rows.bias * dt, jnp.inf)
    zero = jnp.zeros_like(gap[:, :1])
    return Gaps(gap, zero, zero)


def with_impacts(
    extra: OrderedDict[str, PointRows],
    gaps: Mapping[str, Gaps],
    friction: Mapping[str, Friction],
    islands: Array,
    velocities: tuple[Array, Array],
    inverse: Any,
    last: Any,
    dt: Array,
) -> tuple[OrderedDict[str, PointRows], Array]:
    """Rows with the rates that impacts ask for, and the share (b,) of the step that passes before each body is struck.

    `islands` (b,): see `island_slots`; `velocities` (n, 3): those before the step and those that loads alone lead to;
    `inverse`: a function, M^-1 of momenta (n, 3); `last`: impulses of the last step's rows by group, or another
    memory of a method, which says nothing here.
    """
    last = last if isinstance(last, Mapping) else {}
    before, unhindered = velocities
    ways = OrderedDict(
        (name, _approach(extra[name], each, islands, before, unhindered)) for name, each in sorted(gaps.items())
    )
    turning = tuple(extra) if any(way.rows.triples.shape[1] == BETWEEN for way in ways.values()) else ()
    plain = OrderedDict((name, extra[name].bias) for name in (*ways, *friction))
    arms = OrderedDict((name, extra[name].jacobian) for name in turning)
    none = jnp.zeros(islands.shape, before.dtype)

    def place() -> tuple[Any, Any, Array]:
        return _placed(extra, turning, ways, friction, islands, before, unhindered, inverse, last, dt)

    biases, arms, share = cond_any(_possible(ways.values(), dt), place, lambda: (plain, arms, none))
    changed = OrderedDict(extra)
    for name, bias in biases.items():
        changed[name] = changed[name].replace(bias=bias)
    for name, jacobian in arms.items():
        changed[name] = changed[name].replace(jacobian=jacobian)
    return changed, share


def island_slots(islands: Array, free: Array) -> Array:
    """Slots (b,): a number that bodies share which joints tie; b where they are tied to soft bodies, b + 1 where they
    do not move by themselves. `islands` (b,) as built."""
    return jnp.where(free > 0, islands, islands.shape[0] + 1)


def _sides(rows: PointRows) -> Array:
    if rows.lower is None or rows.upper is None:
        return jnp.zeros_like(rows.bias)
    return jnp.where(jnp.isinf(rows.upper), 1.0, jnp.where(jnp.isinf(rows.lower), -1.0, 0.0)).astype(rows.bias.dtype)


def _approach(rows: PointRows, gaps: Gaps, islands: Array, before: Array, unhindered: Array) -> Approach:
    count = islands.shape[0]
    nodes, side = rows.unknowns - 2 * count, _sides(rows)
    slots = jnp.where(rows.triples < nodes, count, islands[(rows.triples - nodes) % count])
    rate, coming = (side * rows.apply(v) for v in (before, unhindered))
    return Approach(rows, side, gaps.gap, rate, coming, gaps.restitution, gaps.near, slots)


def _possible(ways: Any, dt: Array) -> Array:
    """Whether anything may be placed; else a step costs no more than this. What rests has rates that are rounding."""

    def any_of(way: Approach) -> Array:
        slow = FORCE_STEPS * jnp.abs(way.coming - way.rate) + STILL * way.near / dt
        return jnp.any((way.side != 0) & (way.gap + 1.5 * dt * way.rate < 0) & (way.rate < -slow))

    found = [any_of(way) for way in ways]
    return jnp.stack(found).any()


def _placed(
    extra: OrderedDict[str, PointRows],
    turning: tuple[str, ...],
    ways: Mapping[str, Approach],
    friction: Mapping[str, Friction],
    islands: Array,
    before: Array,
    unhindered: Array,
    inverse: Any,
    last: Mapping[str, Array],
    dt: Array,
) -> tuple[OrderedDict[str, Array], OrderedDict[str, Array], Array]:
    """Biases of the groups, the Jacobians of those that are `turning`, and the bodies' shares."""
    known = {name: extra[name] for name in last if name in extra}
    held = inverse(pushes(known, last) if known else jnp.zeros_like(unhindered))
    events = [_event(way, held, islands.shape[0], dt) for way in ways.values()]
    slots = _shares(list(ways.values()), events, islands.shape[0])
    share = gather(slots, islands)
    nodes = before.shape[0] - 2 * share.shape[0]
    gone = jnp.concatenate([jnp.zeros(nodes, share.dtype), share, share])[:, None] * before
    rows = extra
    if turning:
        to = nodes + share.shape[0]
        rows = with_arms_when_struck(extra, dt * gone[nodes:to], islands < share.shape[0], nodes)
    biases = OrderedDict[str, Array]()
    for (name, way), event in zip(ways.items(), events, strict=True):
        rate = way.side * rows[name].apply(before)
        biases[name] = _bias(way._replace(rows=rows[name], rate=rate), event, slots, gone, dt)
    for name, each in friction.items():  # it acts on the velocities after the impact
        struck = gather(slots, ways[each.normal].bodies).max(axis=1, keepdims=True) > 0
        biases[name] = jnp.where(struck, 0, extra[name].bias)
    return biases, OrderedDict((name, rows[name].jacobian) for name in turning), share


def _event(way: Approach, held: Array, count: int, dt: Array) -> Event:
    """When the rows of a group strike, see the head of this file; `held` (n, 3): what the last impulses would add."""
    plain = way.coming - way.rate
    more = plain + way.side * way.rows.apply(held)
    change = jnp.where(jnp.abs(more) <= PLAUSIBLE * jnp.abs(way.rate), more, plain)
    end, gap = way.rate + change, jnp.maximum(way.gap, 0) / dt
    ours = jnp.all(way.bodies != count, axis=1, keepdims=True) & (way.side != 0)
    arrives = ours & (way.gap / dt + end < 0) & (way.rate < -FORCE_STEPS * jnp.abs(change))
    leaving = (change > PRESSING * jnp.abs(way.rate)) & (way.gap >= 0)
    due = arrives & ((way.restitution > 0) | leaving)

    speed = jnp.where(arrives, -(way.rate + change / 2), 1)
    gap = jnp.where(arrives, gap, 0)
    root = jnp.sqrt(jnp.where(arrives, jnp.maximum(speed**2 - 2 * change * gap, 1e-3 * speed**2), 1))
    time = 2 * gap / (speed + root)
    rate = _rate(way, time, change)
    share = time * (end - rate) / jnp.where(due, way.rate - rate, 1)
    pressing = gap / jnp.where(arrives, -end, 1)
    return Event(due, arrives, jnp.where(due, share, jnp.where(arrives, pressing, jnp.inf)), time, change)


def _rate(way: Approach, time: Array, change: Array) -> Array:
    """What an impact at the share `time` of the step asks for at its end."""
    striking = way.rate + (time + 0.5) * change
    return jnp.maximum((0.5 - time) * change - way.restitution * striking, -time * change / 2)


def _shares(ways: list[Approach], events: list[Event], count: int) -> Array:
    """The share of the step before an island is struck, by slot (b + 2,): that of its first impact, 0 without any.

    Which impact that is takes no part in derivatives.
    """
    width = max(way.bodies.shape[1] for way in ways)

    def owners(way: Approach) -> Array:
        more = ((0, 0), (0, width - way.bodies.shape[1]))
        return jnp.repeat(jnp.pad(way.bodies, more, constant_values=count + 1), way.gap.shape[1], 0)

    def flat(values: list[Array]) -> Array:
        return jnp.concatenate([each.reshape(-1) for each in values])

    bodies = jnp.concatenate([owners(way) for way in ways])
    shares, due, arrives = (flat([getattr(e, name) for e in events]) for name in ("share", "due", "arrives"))
    touching = flat([_touching(way) for way in ways])
    first = _first(bodies, jax.lax.stop_gradient(shares), due, arrives, touching, count)
    return jnp.where(first >= 0, shares[first], 0)


def _touching(way: Approach) -> Array:
    """Rows of bodies that rest on each other, or come to rest: they hand on what strikes one of them."""
    slow = FORCE_STEPS * jnp.abs(way.coming - way.rate) + 1e-6 * jnp.abs(way.rate).max()
    return (way.side != 0) & (way.gap <= way.near) & (jnp.abs(way.rate) <= slow)


def _first(bodies: Array, shares: Array, due: Array, arrives: Array, touching: Array, count: int) -> Array:
    """The row (b + 2,) whose share counts in each slot, -1 where none does."""
    size, number = count + 2, jnp.arange(shares.shape[0], dtype=jnp.int32)
    moving = bodies < count

    def settle(keys: Array, rows: Array, chosen: Array) -> tuple[Array, Array]:
        """Least key of each slot, and its row; `keys`, `rows`, `chosen` (R,) of rows."""
        wide = jnp.where(chosen[:, None] & moving, keys[:, None], jnp.inf)
        least = jnp.full(size, jnp.inf, keys.dtype).at[bodies].min(wide)
        same = jnp.isfinite(wide) & (wide == gather(least, bodies))
        return least, jnp.full(size, -1, jnp.int32).at[bodies].max(jnp.where(same, rows[:, None], -1))

    def spread(found: tuple[Array, Array]) -> tuple[Array, Array]:
        """For each row the least key of the bodies that it is between, and the row which that is of."""
        keys, rows = found
        own = jnp.where(moving, gather(keys, bodies), jnp.inf)
        best = jnp.argmin(own, axis=1)[:, None]
        key, row = (jnp.take_along_axis(each, best, 1)[:, 0] for each in (own, gather(rows, bodies)))
        return key, row

    struck = jnp.zeros(size, bool).at[bodies].max(due[:, None] & moving)
    counted = arrives & jnp.any(gather(struck, bodies) & moving, axis=1)

    def joined(i: Any, found: tuple[Array, Array]) -> tuple[Array, Array]:
        # In the first round what strikes, then what that is handed on by: settled in one place, so compiled once.
        key, row = (jnp.where(i == 0, first, on) for first, on in zip((shares, number), spread(found), strict=True))
        keys, rows = settle(key, row, jnp.where(i == 0, counted, due | arrives | touching))
        better = keys < found[0]
        return jnp.where(better, keys, found[0]), jnp.where(better, rows, found[1])

    none = jnp.full(size, jnp.inf, shares.dtype), jnp.full(size, -1, jnp.int32)
    found: tuple[Array, Array] = jax.lax.fori_loop(0, 1 + ROUNDS, joined, none)
    return found[1]


def _bias(way: Approach, event: Event, slots: Array, gone: Array, dt: Array) -> Array:
    """c of a group's rows: what impacts ask for, and elsewhere what keeps gaps open on ways that change on the way."""
    share = gather(slots, way.bodies).max(axis=1, keepdims=True)
    left = (-way.gap / dt - way.side * way.rows.apply(gone)) / jnp.maximum(1 - share, 1e-3)
    others = (share > 0) & (way.side != 0) & (way.gap >= 0)
    rate = jnp.where(event.due, _rate(way, event.time, event.change), jnp.minimum(left, 0))
    return jnp.where(event.due | others, way.side * rate, way.rows.bias)
