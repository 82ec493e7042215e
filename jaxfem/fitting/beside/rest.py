"""Where a scene rests, for data that are of the body at rest."""

import jax.numpy as jnp

from jaxfem.fitting.beside.base import At
from jaxfem.model import State
from jaxfem.solvers import Status
from jaxfem.statics import equilibrium


def rested(at: At) -> tuple[State, jnp.ndarray]:
    """(the state at rest under the scene's loads, whether it was found)."""
    state, info = equilibrium(at.model, at.params, at.state)
    return state, info.status == int(Status.CONVERGED)
