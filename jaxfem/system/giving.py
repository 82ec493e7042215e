"""Rows that give way: the trace of compliance by which rows are kept apart carries no more than some mass ratios.

Each row has a little compliance, a share of what a unit impulse on it moves it by (`coupled.py`). The lightest body
beside a row decides that, the heaviest one what it carries, so that from a ratio of about 1e8 on (1e5 in single
precision) the load opens joints and sinks contacts by what can be seen.
"""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.model import Model
from jaxfem.rows.contact import PUSH
from jaxfem.solvers.status import Status, caused
from jaxfem.system.names import contact_name, friction_name, joint_name
from jaxfem.system.soft import System

Array = jax.Array

GAVE = 1e-3
"""Of the scene's size: what a load may open a joint or sink a contact by; in a second, what a rim may creep that
sticks."""
TURN = 4.0
"""rad that count as the scene's size."""


def gave_way(model: Model, system: System, impulses: Mapping[str, Array], dt: Array) -> Array | None:
    """The code of a step in which a gap stays open by the trace of compliance alone, that names it; else 0.

    None where no rows are looked at.
    """
    if not system.trace or model.size is None:
        return None
    system, impulses, size = jax.lax.stop_gradient((system, dict(impulses), model.size))
    shares, codes = [], []
    for label, joints in model.joints.items():
        if joints.holds and (name := joint_name(label)) in impulses:
            open_by = _left(system, name, impulses[name], dt, 1.0)
            shares.append(open_by / (size if joints.length else TURN))
            codes.append(_codes("joint", joints.names, len(open_by)))
    for label, contacts in model.contacts.items():
        if (name := contact_name(label)) in system.trace and name in impulses:
            shares.append(_left(system, name, impulses[name], dt, PUSH) / size)
            codes.append(_codes("contact", contacts.names, len(shares[-1])))
        if (name := friction_name(label)) in system.trace and name in impulses:
            shares.append(jnp.max(system.trace[name] * jnp.abs(impulses[name]), axis=1) / size)  # in a second
            codes.append(_codes("contact", contacts.names, len(shares[-1])))
    if not shares:
        return None
    share = jnp.concatenate(shares)
    named = jnp.asarray(np.concatenate(codes))[jnp.argmax(share)]
    return jnp.where(share.max() > GAVE, named, int(Status.CONVERGED)).astype(jnp.int32)


def _left(system: System, name: str, impulses: Array, dt: Array, taken: float) -> Array:
    """What a lasting load leaves of gaps (m,) [m or rad], of which a step takes back the share `taken`.

    That is the gap of which what is taken back is what the trace gives; no more than the gap there is.
    """
    rows, trace = system.extra[name], system.trace[name]
    asked = jnp.abs(rows.bias) if taken == 1 else jnp.maximum(rows.bias, 0)
    given = jnp.minimum(asked, trace * jnp.abs(impulses)) * (rows.compliance <= 2 * trace)
    left: Array = dt / taken * given.max(axis=1)
    return left


def _codes(kind: str, names: tuple[str, ...], count: int) -> np.ndarray:
    """Codes (count,) of rows of which each name has as many, side by side."""
    own = np.array([caused(Status.GAVE_WAY, f'{kind} "{name}", {_WHY}') for name in names], np.int32)
    return np.repeat(own, -(-count // len(own)))[:count]


_WHY = (
    "which carries too much, beside a body so light or between things that do not give way: make light bodies heavier, "
    "compute in double precision, or see what presses"
)
