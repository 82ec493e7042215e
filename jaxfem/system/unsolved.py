"""Functions of a scene that ask for neither its method nor its memory: one trace serves all methods and steps."""

import functools
import inspect
from collections.abc import Callable
from typing import Any, TypeVar

from jaxfem.batching import one_trace

F = TypeVar("F", bound=Callable[..., Any])


def unsolved(function: F) -> F:
    """`function(model, params, state, ...)` by `one_trace`, given `Model.unsolved()` and a state without memory.

    What is given by its name, or left out, shares the trace of what is given in its place.
    """
    signature, traced = inspect.signature(function), one_trace(function)

    @functools.wraps(function)
    def call(*given: Any, **named: Any) -> Any:
        bound = signature.bind(*given, **named)
        bound.apply_defaults()
        model, params, state, *others = bound.args
        return traced(model.unsolved(), params, state.replace(memory=None), *others)

    same: Any = call
    return same  # type: ignore[no-any-return]
