"""Names of constants in `params`, one for each thing; a method's constants beside those of the bodies."""

import dataclasses
from collections import Counter
from collections.abc import Mapping
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxfem.answers import described
from jaxfem.declared.errors import SceneError
from jaxfem.materials.base import Material
from jaxfem.materials.constants import DENSITY, MASS_DAMPING, Constant, MaterialError
from jaxfem.methods import Method
from jaxfem.model import Model, Params

ELSEWHERE = ("dt", "state", "delay")
"""Names that sweeps and fits have for what is no constant."""


def taken_names() -> set[str]:
    """What no constant of one's own may be called: `params` have something else under that name, or fits and sweeps."""
    fields = {each.name for each in dataclasses.fields(Params)}
    return {*fields, *dir(Params), DENSITY.name, MASS_DAMPING.name, *ELSEWHERE}


def with_own_constants(method: Method, model: Model, params: Params) -> tuple[Model, Params]:
    """Model and params with what the method's `constants` gives; SceneError for names that stand for something else,
    names that two have, and values that cannot be."""
    given: Any = method.constants()
    if not isinstance(given, Mapping) or not all(isinstance(each, Constant) for each in given):
        raise SceneError(
            f'solver "{method.name}": `constants` gives {described(given)}; it must give a mapping of Constant(...) to '
            "its value"
        )
    if not given:
        return model, params
    _check_names(method, [each.name for each in given], model)
    values = {each.name: _value(method, each, value, model) for each, value in given.items()}
    model = model.replace(more_constants=(*model.more_constants, *given))
    return model, params.replace(constants={**params.constants, **values})


def _check_names(method: Method, names: list[str], model: Model) -> None:
    taken = taken_names()
    for name, times in Counter(names).items():
        if times > 1:
            flaw = f"{times} constants called {name!r}: rename all but one"
        elif name in taken:
            flaw = f"a constant called {name!r}, which is something else in params: give it another name"
        elif name in model.constants:
            owners = model.bodies_of(partial(_has, name))
            flaw = (
                f"a constant called {name!r}, which params hold for the material of {owners}: read that value in "
                f'`params.constants["{name}"]`, or give the method\'s own another name'
            )
        else:
            continue
        raise SceneError(f'solver "{method.name}": `constants` gives {flaw}')


def _has(name: str, law: Material) -> bool:
    return any(each.name == name for each in law.constants)


def _value(method: Method, constant: Constant, value: Any, model: Model) -> Any:
    """One number, or one for each body or element."""
    bodies, elements = len(model.bodies), model.elements.count
    try:
        checked = constant.checked(method.name, value, bodies if bodies and np.shape(value) == (bodies,) else elements)
    except MaterialError as problem:
        raise SceneError(f'solver "{method.name}": `constants` gives what it cannot: {problem}') from None
    return jnp.asarray(checked, model.rest.dtype)
