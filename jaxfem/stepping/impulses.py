"""Reading what a method remembers: the impulses of a step's rows, by name."""

import jax

from jaxfem.model import Model, State

Array = jax.Array


def impulses(model: Model, state: State) -> dict[str, Array]:
    """Impulses of the last step by groups of rows, (..., m, r) [N s or N m s]; divide by dt for forces.

    Names: "joint " and a name of `model.joints`; "contact " and one of `model.contacts` for normal impulses, with
    " friction" behind it for the two tangential ones; "elastic 1" and so on, (..., r, D), where the method solves for
    those. Within a group the entries are those of the model's (`model.contacts[name].names`). Empty where the method
    keeps none. `state` may have leading axes, as rollouts return it.
    """
    return dict(model.method.impulses(model, state.memory))
