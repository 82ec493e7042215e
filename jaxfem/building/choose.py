"""Which method solves a scene's steps: the one asked for, or for "auto" the first of a table that serves the scene."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxfem.answers import described, hashable, odd_leaf
from jaxfem.building.own_constants import with_own_constants
from jaxfem.declared import SceneError
from jaxfem.methods import METHODS, CannotServe, Condensed, Direct, Facts, ImplicitRotations, Method, Mprgp
from jaxfem.methods.by_rows import first_system
from jaxfem.methods.nodes.row_stiffness import MOST_EXACT
from jaxfem.model import Choice, Model, Params, State, nodal_mass

ROTATION_UPDATES = ("explicit", "implicit")
OUTWEIGHED = 1e4  # masses of rigid over soft bodies


class Built(NamedTuple):
    """A scene as `build` has it when its method is chosen."""

    facts: Facts
    model: Model
    params: Params
    state: State


class Rule(NamedTuple):
    """A method that "auto" takes where `holds` says so, and why, in words."""

    method: Method
    holds: Callable[[Built], bool]
    reason: str


def _many_across(built: Built) -> bool:
    """Whether more rows couple several triples than the nodes' preconditioner bears: dolls of many rigid bodies."""
    if not built.facts.rigid:
        return False
    model = built.model
    system = jax.eval_shape(first_system, model, built.params, built.state)
    across: int = sum(rows.bias.size for rows in system.extra.values() if rows.triples.shape[1] > 1)
    return across > min(MOST_EXACT, 2 * model.nodes)


def _outweighed(built: Built) -> bool:
    """Whether a soft body that nothing holds is so light beside a rigid one that only rows resist its motion.

    The coarse space of the nodes' preconditioner does not see rows: it takes such a body for one that flies off.
    """
    model, params = built.model, built.params
    if model.rigid is None or params.rigid is None or model.drifting is None:
        return False
    masses = np.bincount(np.asarray(model.node_body), np.asarray(nodal_mass(model, params.density)))
    loose = masses[np.asarray(model.drifting.loose)[: len(masses)] > 0]
    heavy = np.asarray(params.rigid.mass)[np.asarray(model.rigid.free) > 0]
    return len(heavy) > 0 and bool(heavy.max() > OUTWEIGHED * loose.min())


AUTO = (
    Rule(Condensed(), lambda b: b.facts.soft and not b.facts.coupled, "soft bodies alone are solved on their nodes"),
    Rule(
        Mprgp(),
        lambda b: b.facts.soft and b.facts.tied and _many_across(b),
        "so many rows tie rigid bodies to so few nodes that all rows are solved for",
    ),
    Rule(
        Mprgp(),
        lambda b: b.facts.soft and b.facts.tied and _outweighed(b),
        "a rigid body outweighs a loose soft one so far that all rows are solved for",
    ),
    Rule(
        Condensed(),
        lambda b: b.facts.soft and b.facts.tied,
        "soft bodies are solved on their nodes, joints and contacts beside them",
    ),
    Rule(Direct(), lambda b: not b.facts.soft, "the rows of rigid bodies alone are eliminated"),
    Rule(Mprgp(), lambda b: True, "nothing cheaper serves this scene, so all rows are solved for"),
)
"""In this order; a rule whose method cannot make its plan is passed over."""


def method_asked(solver: Any, rotation_update: str) -> Method | None:
    """The method that `build` was asked for, None for "auto"; SceneError for what is not known."""
    if isinstance(solver, str) and solver != "auto":
        if solver not in METHODS:
            raise SceneError(f"solver is {solver!r}; known: {', '.join(('auto', *METHODS.words()))}")
        solver = METHODS[solver].made()
    if solver == "auto":
        return None
    if not isinstance(solver, Method):
        raise SceneError(
            f"solver is {solver!r}; give a name ({', '.join(('auto', *METHODS.words()))}) or a Method object"
        )
    odd = [name for name, value in vars(solver).items() if not hashable(value)]
    if odd:
        raise SceneError(
            f'solver "{solver.name}" has {odd[0]} = {getattr(solver, odd[0])!r}, by which no compiled program can tell '
            "it from others: give a number, a word, a flag or a tuple of such; arrays are made in `plan` and `prepare`"
        )
    return _turning(solver, rotation_update)


def with_method(
    built: Built, asked: Method | None, rotation_update: str, solver: Any = None
) -> tuple[Model, Params, State]:
    """All three with the method that was `asked` for, as `solver`, or that "auto" takes. SceneError says why one
    cannot."""
    if asked is not None:
        word = solver if isinstance(solver, str) else asked.name
        found = _tried(built, asked, Choice(word, "asked for"))
        if isinstance(found, str):
            raise SceneError(f'solver "{word}" {found}')
        return found
    why = "no method serves this scene"
    for rule in AUTO:
        if rule.holds(built):
            method = _turning(rule.method, rotation_update)
            found = _tried(built, method, Choice("auto", rule.reason))
            if not isinstance(found, str):
                return found
            why = f'"{method.name}" {found}'
    raise SceneError(f'solver "auto": {why}')


def _tried(built: Built, method: Method, choice: Choice) -> tuple[Model, Params, State] | str:
    """The model, params and state with a method, or why it cannot serve the scene."""
    refused = method.refuses(built.facts)
    if refused is not None and not isinstance(refused, str):
        raise SceneError(_wrong(method, "refuses", refused, "words that follow its name, or None"))
    if refused is not None:
        return refused
    if built.facts.nonlinear and not method.nonlinear:
        return (
            f"takes laws that are linear in a step, which {' and '.join(built.facts.nonlinear)} is not: use "
            '"condensed", alone or among joints and contacts of soft bodies'
        )
    try:
        return _planned(built, method, choice)
    except CannotServe as problem:
        return str(problem)


def _turning(method: Method, rotation_update: str) -> Method:
    return ImplicitRotations(method) if rotation_update == "implicit" else method


def _planned(built: Built, method: Method, choice: Choice) -> tuple[Model, Params, State]:
    plan = method.plan(built.model, built.params, built.state)
    _check_arrays(method, "plan", plan)
    model = built.model.replace(method=method, choice=choice, plan=plan)
    model, params = with_own_constants(method, model, built.params)
    memory = method.start(model, params, built.state)
    _check_arrays(method, "start", memory)
    return model, params, built.state.replace(memory=memory)


def _check_arrays(method: Method, hook: str, given: Any) -> None:
    if (odd := odd_leaf(given)) is not None:
        raise SceneError(_wrong(method, hook + odd[0], odd[1], "a tree of arrays, or None"))


def _wrong(method: Method, hook: str, given: Any, wanted: str) -> str:
    return f'solver "{method.name}": `{hook}` gives {described(given)}; it must give {wanted}'
