"""The shear and the bulk modulus as unknowns, in place of the two constants that isotropic stiffnesses are made of."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.materials.base import Material
from jaxfem.materials.moduli import bulk_modulus, ratio_and_modulus, shear_modulus
from jaxfem.model import Model, Params, State

Array = jax.Array

SHEAR, BULK = MODULI = ("shear_modulus", "bulk_modulus")
PAIR = frozenset({"young", "poisson"})
"""What they stand for."""


def made_of_moduli(model: Model, params: Params) -> bool:
    """Whether every law of a scene has its stiffness of Young's modulus and Poisson's ratio alone."""
    known = bool(model.laws) and PAIR <= set(params.constants)
    return known and all(asked_of(law, params) == PAIR for law in model.laws)


@dataclasses.dataclass(frozen=True)
class Modulus:
    """The shear or the bulk modulus [Pa], the other one held, where the law has Young's modulus and Poisson's ratio:
    the pair that samples tell apart where the ratio is near 1/2. Several values change in proportion."""

    bulk: bool

    def read(self, params: Params, state: State) -> float:
        """Its mean."""
        return float(np.mean(np.asarray(self._both(params)[int(self.bulk)])))

    def put(self, params: Params, state: State, value: Array) -> tuple[Params, State]:
        """Young's modulus and Poisson's ratio of both moduli."""
        both = list(self._both(params))
        own = both[int(self.bulk)]
        both[int(self.bulk)] = own / jnp.mean(own) * value
        poisson, young = ratio_and_modulus(3 * both[1], 2 * both[0])
        dtype = own.dtype
        return params.replace(young=young.astype(dtype), poisson=poisson.astype(dtype)), state

    def _both(self, params: Params) -> tuple[Array, Array]:
        young, poisson = jnp.asarray(params.young), jnp.asarray(params.poisson)
        return shear_modulus(young, poisson), bulk_modulus(young, poisson)


class _Reads(dict[str, Any]):
    """Values that remember which of them were read."""

    def __init__(self, values: Mapping[str, Any]):
        super().__init__(values)
        self.names: set[str] = set()

    def __getitem__(self, name: str) -> Any:
        self.names.add(name)
        return super().__getitem__(name)


def asked_of(law: Material, params: Params) -> set[str]:
    """Names of the constants that a law's stiffness is made of."""
    values = _Reads({name: jnp.mean(jnp.asarray(value)) for name, value in params.constants.items()})
    law.stiffness(values)
    return values.names
