"""Contacts that have come through: what slips off an edge, or is pressed too hard, may end up on the wrong side."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.model import Model, State
from jaxfem.rows.candidates import pairs_of
from jaxfem.solvers.status import Status, caused
from jaxfem.system.coupled import configuration

Array = jax.Array


def piercing_status(model: Model, state: State, status: Array) -> Array:
    """The status of a step from `state`: that given, or where it is 0 that of a contact which began it deeper than it
    may be (`Candidates.deepest`)."""
    looked_at = [group for group in model.contacts.values() if group.deepest is not None]
    if not looked_at:
        return status
    at, groups = jax.lax.stop_gradient((configuration(state), looked_at))
    over = jnp.stack([jnp.min(pairs_of(each, at).gap + each.deepest) for each in groups])
    codes = [caused(Status.GAVE_WAY, f'contact "{each.names[0]}", {_THROUGH}') for each in groups]
    found = jnp.asarray(np.array(codes, np.int32))[jnp.argmin(over)]
    good = status == int(Status.CONVERGED)
    return jnp.where(good & (over.min() < 0), found, status).astype(jnp.int32)


_THROUGH = (
    "whose sides are on their way through each other: take a smaller time step, finer patches or a gentler load, and "
    "declare patches as far as the sides may slip"
)
