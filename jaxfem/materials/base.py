"""What a material law is: its constants, its stiffness and damping, and, where it has a memory, what it remembers."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.answers import FLAG, described, flaw_of, odd_pair, still_says
from jaxfem.materials.constants import Constant, MaterialError
from jaxfem.ranges import Range
from jaxfem.registry import Registry

Array = jax.Array
Values = Mapping[str, Array]
Pair = tuple[Array, Array]

LAWS: Registry["Material"] = Registry("material")
"""Every law by its word, as scene files name it; a law enters itself when its class is defined."""


class Response(NamedTuple):
    """How a material with a memory answers in one step: stress D f (e + offset) + D beta de/dt, linear in the strain.

    `factor`: f of the volumetric and the deviatoric stiffness, each () or (D,); `offset` (r, D): known strain.
    """

    factor: tuple[Any, Any]
    offset: Array


MEMORY = ("internal_at_once", "response", "commit", "counts", "tensors", "rest_strain")
"""What only laws with a memory are asked."""


class Material:
    """A law with the values of its constants, as a user declares it: `Law(constant=value, ...)`; its own base class.

    A subclass gives its word, `class MyLaw(Material, word="my_law")`, and its `constants`; where it comes in variants,
    `options`: name -> default, each a bool, number or string, given like constants and read as attributes. In a model
    the law is static: two are equal where class and options are, and the values go to `params`.
    In kernels `values` holds one number, or one an element (E,), for each constant; with a memory, one a domain (D,).
    Strain has r rows in the constant eigenbasis of isotropy, of which `rows` says which of the six: 0 is volumetric.
    """

    word: ClassVar[str] = ""
    constants: ClassVar[tuple[Constant, ...]] = ()
    options: ClassVar[Mapping[str, Any]] = {}
    linear: ClassVar[bool] = True
    """Whether its stress in a step is linear in the strain; the others are subclasses of `Nonlinear`."""
    relaxes: ClassVar[bool] = False
    """Whether the stress of a strain that is held comes to that of the stiffness alone; statics then takes the law."""
    values: Mapping[str, Any]

    def __init_subclass__(cls, word: str = "", **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if not still_says(cls, "relaxes", "response", "commit"):
            cls.relaxes = False
        if not word:
            return  # a class that others share code through
        if cls.stiffness is Material.stiffness:
            raise TypeError(f'the material law "{word}" ({cls.__name__}) has no `stiffness`: define it')
        law = f'the material law "{word}" ({cls.__name__})'
        _check_declared(law, cls.constants, cls.options)
        if flaw := flaw_of(cls, {"linear": FLAG, "relaxes": FLAG}):
            raise TypeError(f"{law} has {flaw}")
        late = next((name for name in MEMORY if getattr(cls, name) is not getattr(Material, name)), None)
        if late is not None and cls.internal0 is Material.internal0:
            raise TypeError(f"{law} has `{late}` and no memory, so that it is never asked: define `internal0`")
        names = [each.name for each in cls.constants]
        twice = (
            {name for name in names if names.count(name) > 1} | {*names} & {*cls.options} | {"values"} & {*cls.options}
        )
        if twice:
            raise TypeError(f'the material law "{word}" has two things called {min(twice)!r}: rename one')
        LAWS.add(word, cls)
        cls.word = word

    def __init__(self, **given: Any):
        options = {name: given.get(name, default) for name, default in self.options.items()}
        for name, value in options.items():
            if not _alike(value, self.options[name]):
                _, kind = _OPTIONS[type(self.options[name])]
                raise MaterialError(f"{name} of {type(self).__name__} is {value!r}: give {kind}")
        constants = self.constants_of(options)
        _check_declared(f"{type(self).__name__}, by its `constants_of`,", constants, {})
        names = [each.name for each in constants]
        for name in given:
            if name not in names and name not in self.options:
                known = ", ".join([*names, *self.options])
                raise MaterialError(f"{type(self).__name__} has no constant {name!r}; it has {known}")
        for each in constants:
            if given.get(each.name) is None and each.default is None:
                unit = f" in {each.unit}" if each.unit else ""
                raise MaterialError(f"{type(self).__name__} needs {each.name}, its {each.title}{unit}")
        values = {each.name: given.get(each.name) for each in constants}
        defaults = {each.name: each.default for each in constants}
        self._set({name: defaults[name] if value is None else value for name, value in values.items()}, given)
        self._check_combined()

    def _check_combined(self) -> None:
        """Refuse numbers made of several constants that cannot be; what is no number is refused by name elsewhere."""
        try:
            known: Any = {name: np.asarray(value, float) for name, value in self.values.items()}
            found = self.combined(known)
        except (TypeError, ValueError):
            return
        if (odd := odd_pair(found, Range)) is not None:
            raise TypeError(
                f"`combined`{odd[0]} of {type(self).__name__} gives {described(odd[1])}: it must give a mapping of "
                "words to a value and its Range"
            )
        for name, (value, allowed) in found.items():
            if np.any(np.isfinite(value) & np.asarray(allowed.wrong(value))):
                raise MaterialError(f"{name} {allowed.text}")

    def _set(self, values: Mapping[str, Any], options: Mapping[str, Any]) -> None:
        object.__setattr__(self, "values", values)
        for name, default in self.options.items():
            object.__setattr__(self, name, options.get(name, default))
        own = tuple(self.constants_of({name: getattr(self, name) for name in self.options}))
        if own != type(self).constants:
            object.__setattr__(self, "constants", own)

    @classmethod
    def constants_of(cls, options: Mapping[str, Any]) -> tuple[Constant, ...]:
        """The constants of the variant with these `options`, all of them; a law whose variants differ says which."""
        return cls.constants

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"a material does not change: make another {type(self).__name__}")

    @property
    def law(self) -> Self:
        """The same law and options without values: what the model holds."""
        found = {
            name for each in type(self).__mro__ for name, way in vars(each).items() if isinstance(way, cached_property)
        }
        if lost := {*vars(self)} - {"values", "constants", *self.options} - found:
            raise MaterialError(
                f"{type(self).__name__} has the attribute {min(lost)}, which no program would see: declare it in "
                "`constants`, or in `options` where it is a flag, a number or a word that tells variants apart"
            )
        bare = object.__new__(type(self))
        bare._set({}, vars(self))
        return bare

    def _key(self) -> tuple[Any, ...]:
        return type(self), tuple(getattr(self, name) for name in self.options)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Material) or self._key() != other._key() or self.values.keys() != other.values.keys():
            return False
        return all(np.array_equal(value, other.values[name]) for name, value in self.values.items())

    def __hash__(self) -> int:
        return hash(self._key())

    def __repr__(self) -> str:
        chosen = {name: getattr(self, name) for name in self.options} | dict(self.values)
        return f"{type(self).__name__}({', '.join(f'{name}={value!r}' for name, value in chosen.items())})"

    def stiffness(self, values: Values) -> Pair:
        """The two distinct eigenvalues of the isotropic stiffness, volumetric 3K and deviatoric 2 mu [Pa]."""
        raise NotImplementedError(f"{type(self).__name__} does not say its stiffness")

    def damping(self, values: Values) -> Any:
        """Time beta [s] of the viscous stress D beta de/dt beside the elastic one: the constant that is `viscous`."""
        return next((values[each.name] for each in self.constants if each.viscous), 0.0)

    def combined(self, values: Values) -> Mapping[str, tuple[Any, Range]]:
        """Numbers made of several constants that have a range of their own, by what messages call them."""
        return {}

    def doubts(self) -> Sequence[str]:
        """What to warn of in its values that are admissible one by one, each a sentence that follows a body's name."""
        return ()

    def internal0(self, strain: Array) -> Any:
        """What is remembered where the `strain` is (r, D), as at the start: a pytree of arrays, or None, no memory."""
        return None

    def internal_at_once(self, values: Values, strain: Array) -> Any:
        """What is remembered where the `strain` (r, D) was taken to at once, where that differs from `internal0`."""
        return self.internal0(strain)

    @cached_property
    def remembers(self) -> bool:
        """Whether the law has a memory."""
        return self.internal0(jnp.zeros((6, 1))) is not None

    def response(self, values: Values, internal: Any, dt: Array, rows: slice) -> Response:
        """The stress `dt` [s] after what is remembered as a function of the strain there; laws with a memory only.

        That is where the scheme takes stresses: the end of the step, or a place within it; () or one a domain (D,).
        """
        raise NotImplementedError(f"{type(self).__name__} has a memory but no response")

    def commit(self, values: Values, internal: Any, strain: Array, dt: Array, rows: slice) -> Any:
        """What is remembered after a step of `dt` that ended at `strain` (r, D); laws with a memory only."""
        raise NotImplementedError(f"{type(self).__name__} has a memory but does not commit to it")

    def counts(
        self, values: Values, before: Any, after: Any, strain: Array, dt: Array, rows: slice
    ) -> Mapping[str, Array]:
        """How many domains a step of `dt` did something to, by its word, () each: `info.counts` adds them up.

        `before` and `after` are remembered at its ends, it ended at `strain`. Such as states at the edge of yield,
        where derivatives are one-sided. Laws with a memory only.
        """
        return {}

    def tensors(self, values: Values, internal: Any, strain: Array, rows: slice) -> Mapping[str, Array]:
        """Strains (r, D) that frames show of what is remembered at `strain`, by name; laws with a memory only."""
        return {}

    def stored(self, values: Values, internal: Any, weights: Array, rows: slice) -> Array | None:
        """Energy density (D,) [J/m^3] that is stored beside that of the strain from rest, None: none.

        `weights` (r, D): the stiffness of each row; laws with a memory only.
        """
        return None

    def dissipated(
        self, values: Values, before: Any, after: Any, strain: Array, weights: Array, dt: Array, rows: slice
    ) -> Mapping[str, Array]:
        """Energy densities (D,) [J/m^3] lost in a step of `dt` that ended at `strain`, by their kind, like "plastic".

        `before` and `after` are remembered at its ends; `weights` as in `stored`; laws with a memory only.
        """
        return {}

    def rest_strain(self, values: Values, internal: Any, rows: slice) -> Array | None:
        """The strain (r, D) at which no energy is stored, None: zero; laws with a memory only."""
        return None


def _check_declared(law: str, constants: Any, options: Any) -> None:
    """TypeError for constants and options that are none."""
    if not isinstance(constants, tuple | list) or not all(isinstance(each, Constant) for each in constants):
        raise TypeError(f"{law} has constants = {constants!r}: give a tuple of Constant(...)")
    if not isinstance(options, Mapping):
        raise TypeError(f"{law} has options = {options!r}: give a dictionary of names and defaults")
    for name, default in options.items():
        if not isinstance(default, bool | int | float | str):
            raise TypeError(f"{law} has the option {name} = {default!r}: give a flag, a number or a text")


_OPTIONS: Mapping[type, tuple[tuple[type, ...], str]] = {
    bool: ((bool, np.bool_), "True or False"),
    int: ((int, np.integer), "a whole number"),
    float: ((int, float, np.number), "a number"),
    str: ((str,), "a word"),
}
"""By the type of an option's default: what its values may be, and words for them."""


def _alike(value: Any, default: Any) -> bool:
    """Whether an option's value is of its default's kind; a whole number serves for a number too."""
    if type(default) not in _OPTIONS:
        return True
    known, _ = _OPTIONS[type(default)]
    return isinstance(value, known) and (isinstance(value, bool | np.bool_) == isinstance(default, bool))
