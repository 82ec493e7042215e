"""The error of a declaration that cannot be right, and checks that several declarations share."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from jaxfem.answers import described, texts


class AccuracyWarning(UserWarning):
    """The scene will run, but its discretisation is known to be biased there."""


class SceneError(ValueError):
    """A declaration that cannot be built; the message names the body, what is wrong and what to do."""


def refuse_traced(declared: Any, kind: str | None = None) -> None:
    """Refuse numbers inside jit, grad or vmap, which no check on the host can read; SceneError says where they belong.

    `declared`: a dataclass that users fill in, or numbers by name, those of a `kind` (a call of build).
    """
    plain = isinstance(declared, dict)
    kind = kind or ("call of build" if plain else type(declared).__name__)
    given = declared if plain else {each.name: getattr(declared, each.name) for each in dataclasses.fields(declared)}
    for name, value in given.items():
        if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(value)):
            raise SceneError(
                f"{name} of a {kind} is a value inside jax.grad, jit or vmap. A scene is declared and built outside of "
                "them, once, with plain numbers; what is differentiated or mapped over are `params` and the state that "
                "build returns, changed inside: params.replace(young=...), state.replace(...); contacts' and joints' "
                "numbers are in params.contacts and params.joints, planes, radii and offsets in model.contacts; other "
                "places of nodes at rest: jaxfem.rebuild(model, rest) "
                "(docs/derivatives.md)"
            )


def told(given: Any, hook: str, whose: str) -> list[str]:
    """The sentences that a kind's `hook` answers; SceneError for what is no list of them."""
    answer: Any = getattr(given, hook)()
    found = texts(answer)
    if found is None:
        raise SceneError(
            f"`{hook}` of {whose}, {type(given).__name__}, gives {described(answer)}; it must give a list of texts"
        )
    return found


def checked_vector(what: str, value: Any, length: int = 3) -> np.ndarray:
    """`value` as `length` finite numbers; SceneError names `what`."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.full(0, np.nan)
    if array.shape != (length,) or not np.isfinite(array).all():
        words = {3: "three", 4: "four"}.get(length, str(length))
        raise SceneError(f"{what} is {value!r}; give {words} finite numbers")
    return array


def checked_direction(what: str, value: Any) -> np.ndarray:
    """`value` as a unit vector (3,)."""
    array = checked_vector(what, value)
    length = np.linalg.norm(array)
    if length == 0:
        raise SceneError(f"{what} is all zeros; give a direction")
    direction: np.ndarray = array / length
    return direction


def checked_number(what: str, value: Any, low: float = -np.inf, high: float = np.inf, open_low: bool = False) -> float:
    """`value` as one number between `low` and `high` (above `low` if `open_low`); infinite only where a limit is."""
    wanted = f"more than {low:g}" if open_low else f"at least {low:g}" if low > -np.inf else "a number"
    if high < np.inf:
        wanted += f" and at most {high:g}"
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise SceneError(f"{what} is {value!r}; give {wanted}") from None
    if not (low <= number <= high) or (open_low and number == low):
        raise SceneError(f"{what} is {number:g}; it must be {wanted}")
    return number


def checked_choice(what: str, value: Any, known: Sequence[str], error: type[ValueError] = SceneError) -> None:
    """Refuse a word that is not one of those `known`; `error` names `what`."""
    if value not in known:
        raise error(f"{what} is {value!r}; known: {', '.join(known)}")
