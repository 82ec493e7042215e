"""Reading what a method remembers: the impulses of a step's rows, by name."""

from typing import Any

import jax
import numpy as np

from jaxfem.answers import described, odd_word
from jaxfem.model import Model, State
from jaxfem.stepping.checks import StepError

Array = jax.Array


def impulses(model: Model, state: State) -> dict[str, Array]:
    """Impulses of the last step by groups of rows, (..., m, r) [N s or N m s]; divide by dt for forces.

    Names: "joint " and a name of `model.joints`; "contact " and one of `model.contacts` for normal impulses, with
    " friction" behind it for the two tangential ones; "elastic 1" and so on, (..., r, D), where the method solves for
    those. Within a group the entries are those of the model's (`model.contacts[name].names`). Empty where the method
    keeps none. `state` may have leading axes, as rollouts return it. StepError where a method of one's own answers what
    is no mapping of arrays.
    """
    found: Any = model.method.impulses(model, state.memory)
    if (odd := odd_word(found, lambda value: isinstance(value, jax.Array | np.ndarray))) is not None:
        raise StepError(
            f'`impulses{odd[0]}` of the method "{model.method.name}" gives {described(odd[1])}; it must give a mapping '
            "of names of groups of rows to arrays"
        )
    return dict(found)
