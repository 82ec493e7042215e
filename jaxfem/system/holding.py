"""Whether joints hold: those that contradict each other, and those that a step leaves open.

Rows that agree, redundant or not, are met by a step's velocities to its tolerance; those that cannot are off by half of
a gap and more, however small the compliance that keeps their matrix regular. What opens although its row was met has
moved too far for a step whose rows are straight lines.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.model import Model, Params
from jaxfem.rows.attachments import Configuration
from jaxfem.solvers.status import Status, caused
from jaxfem.system.names import joint_name
from jaxfem.system.soft import System

Array = jax.Array

AGAINST = 1e-3
"""Of the scene's size: what joints that contradict each other leave open within a step."""
OPEN = 5e-2
"""Of the scene's size: joints further open than this at the end of a step have not held."""
MOMENTA = 4.0
"""Times the momentum of all that moves: impulses of joints that are not against each other stay below."""
TURN = 4.0
"""rad that count as the scene's size."""
MOST_PAIRS = 48
"""Joints up to which every two of them have a sentence of their own; of more, one is named."""


class _Still:
    """In place of a scheme's stage: rows made with it have the gap itself, with its sign turned, as their bias."""

    ahead = before = None

    def numbers(self, nodes: Any) -> tuple[float, float, float]:
        """Reach, follow and weight."""
        return 1.0, 0.0, 1.0


STILL: Any = _Still()


def violation(rows: Any) -> Array:
    """By how much each block of rows made at `STILL` is open, (m,) [m or rad].

    A row counts only where an unbounded impulse should close it.
    """
    gap = -rows.bias
    infinite = jnp.full_like(gap, jnp.inf)
    lower, upper = (-infinite, infinite) if rows.bounds is None else rows.bounds
    pushed, pulled = jnp.isinf(upper) & (gap < 0), jnp.isinf(lower) & (gap > 0)
    found: Array = jnp.where(pushed | pulled, jnp.abs(gap), 0.0).max(axis=1)
    return found


def unmet(model: Model, system: System, velocities: Array, impulses: Mapping[str, Array]) -> dict[str, Array]:
    """Rates (m,) [m/s or rad/s] by which each group of joints is not met by end-of-step velocities, by its name.

    Less what impulses as large as the momentum of all that moves leave of it by the trace of compliance.
    """
    found: dict[str, Array] = {}
    if not system.trace or model.size is None:
        return found
    system, velocities, size = jax.lax.stop_gradient((system, velocities, model.size))
    momentum = MOMENTA * jnp.sum(jnp.linalg.norm((system.free * system.mass)[:, None] * system.target, axis=1))
    for label, group in model.joints.items():
        name = joint_name(label)
        rows, trace = system.extra[name], system.trace[name]
        lam = jax.lax.stop_gradient(impulses.get(name, 0.0))
        left = rows.bias - rows.apply(velocities) - (rows.compliance - trace) * lam
        usual = (trace * momentum * (1.0 if group.length else size)).max(axis=1)
        found[name] = jnp.maximum(violation(rows.replace(bias=left)) - usual, 0)
    return found


def held(
    model: Model,
    params: Params,
    at: Configuration,
    velocities: Array,
    missed: Mapping[str, Array],
    dt: Array,
    status: Array,
) -> Array:
    """The status of a step that ended `at` a configuration: that given, or where it is 0 that of its joints.

    `velocities` (n, 3): those of the end, of all triples; `missed`: see `unmet`.
    """
    groups = {label: group for label, group in sorted(model.joints.items()) if group.holds}
    if not groups or model.size is None:
        return status
    params, at, velocities, size = jax.lax.stop_gradient((params, at, velocities, model.size))
    names = list(dict.fromkeys(name for group in groups.values() for name in group.names))
    number = {name: i for i, name in enumerate(names)}
    owner = np.array([number[name] for group in groups.values() for name in group.names])
    against, opened, over = [], [], []
    for label, group in groups.items():
        scale = size if group.length else TURN
        rows = group.rows(at, params.joints[label], STILL)
        opened.append(jnp.where(rows.compliance.max(axis=1) == 0, violation(rows) / scale, 0))
        over.append(_turned_over(rows, velocities, dt) if group.turns_over else jnp.zeros(rows.bias.shape[:1], bool))
        against.append(dt * missed.get(joint_name(label), jnp.zeros_like(opened[-1])) / scale)
    apart, unable = jnp.concatenate(opened), jnp.concatenate(against)
    first = jnp.argmax(unable)
    others = jnp.where(owner == jnp.asarray(owner)[first], 0, unable)
    second = jnp.where(others.max() > AGAINST, jnp.argmax(others), first)
    pairs = jnp.asarray(_codes_of_pairs(names))[jnp.asarray(owner)[first], jnp.asarray(owner)[second] % _pairs(names)]
    found = jnp.where(apart.max() > OPEN, jnp.asarray(_codes_of_open(names)[owner])[jnp.argmax(apart)], status)
    found = jnp.where(unable.max() > AGAINST, pairs, found)
    if any(group.turns_over for group in groups.values()):
        turned = jnp.concatenate(over)
        found = jnp.where(turned.any(), jnp.asarray(_codes_of_turned(names)[owner])[jnp.argmax(turned)], found)
    return jnp.where(status == int(Status.CONVERGED), found, status).astype(jnp.int32)


def _turned_over(rows: Any, velocities: Array, dt: Array) -> Array:
    """Which springs (m,), of rows made at `STILL`, a step has bent past half a turn: where they came from is more than
    that away from where they are."""
    came = -rows.bias - dt * rows.apply(velocities)
    found: Array = (rows.compliance.max(axis=1) > 0) & (jnp.sum(came**2, axis=1) > math.pi**2)
    return found


def _pairs(names: Sequence[str]) -> int:
    """Partners that a joint is named with."""
    return len(names) if len(names) <= MOST_PAIRS else 1


def _codes_of_open(names: Sequence[str]) -> np.ndarray:
    return np.array([caused(Status.OPEN_JOINTS, f"{name}, {_FAR}") for name in names], np.int32)


def _codes_of_turned(names: Sequence[str]) -> np.ndarray:
    return np.array([caused(Status.GAVE_WAY, f'joint "{name}", {_OVER}') for name in names], np.int32)


def _codes_of_pairs(names: Sequence[str]) -> np.ndarray:
    """Codes (j, j) that name two joints, or one on the diagonal; (j, 1) where there are very many."""
    if _pairs(names) == 1 < len(names):
        return np.array(
            [[caused(Status.CONTRADICTORY_JOINTS, f"{name} and others, {_BOTH}")] for name in names], np.int32
        )
    return np.array(
        [
            [caused(Status.CONTRADICTORY_JOINTS, f"{', '.join(dict.fromkeys(sorted((a, b))))}, {_BOTH}") for b in names]
            for a in names
        ],
        np.int32,
    )


_BOTH = "which cannot all hold: move an anchor, change a length, give one of them a compliance, or leave it out"
_OVER = "bent past half a turn, from where its spring turns it on: give it less compliance, or a smaller time step"
_FAR = "further than a twentieth of the scene's size: take a smaller time step"
