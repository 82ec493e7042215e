"""What a time scheme is: where a step takes strains and rates, and how velocities become the next state.

A scheme only changes the coefficients of C and c of the rows, the velocities that loads are added to, and the
recombination: strain and rate are taken at  x_a = base + ahead + reach v  and  v_a = before + follow v,  v the
end-of-step velocity, and impulses count `weight` instead of dt. Rows are linearised at `base`.

A new scheme is a subclass of `Scheme` with a `name`: that alone makes it known to `build` and to scene files.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.answers import FLAG, WHOLE, described, flaw_of, still_says
from jaxfem.batching import one_program
from jaxfem.pytrees import Pytree
from jaxfem.registry import Registry

Array = jax.Array


class Stage(Pytree):
    """Where a step's rows are made, see above; `start` (n, 3): velocities before loads act. None stands for zeros.

    Strain and rate are taken the share `follow` of the step after its start: so late materials with a memory are asked.
    `reach`, `follow` and `weight` are one number each, or (n, 1) where bodies take the step by different schemes.
    """

    base: Array
    ahead: Array | None
    before: Array | None
    start: Array
    reach: Array
    follow: Any
    weight: Array

    def numbers(self, nodes: Array) -> tuple[Any, Any, Any]:
        """`reach`, `follow` and `weight` for rows on `nodes` (...): numbers, or arrays (...)."""
        reach, follow, weight = (v[nodes, 0] if jnp.ndim(v) else v for v in (self.reach, self.follow, self.weight))
        return reach, follow, weight

    def moved_to(self, velocities: Array) -> "Stage":
        """The stage with its rows linearised where end-of-step `velocities` (n, 3) lead; the forces there are exact."""
        place = self.base + self.reach * velocities
        place = place if self.ahead is None else place + self.ahead
        before = jnp.zeros_like(velocities) if self.before is None else self.before
        return self.replace(base=place, ahead=-self.reach * velocities, before=before)

    def where(self, chosen: Array, other: "Stage") -> "Stage":
        """This stage for the nodes `chosen` (n,), the `other` one for the rest."""
        zeros = jnp.zeros_like(self.base)
        pair = [
            s.replace(
                ahead=zeros if s.ahead is None else s.ahead,
                before=zeros if s.before is None else s.before,
            )
            for s in (self, other)
        ]
        found: Stage = jax.tree.map(lambda one, two: jnp.where(chosen[:, None], one, two), *pair)
        return found


class Moving(Protocol):
    """What a scheme sees of a state: `positions`, `velocities` (n, 3), and the `accelerations` that some carry."""

    @property
    def positions(self) -> Array:
        """Of the nodes (n, 3) [m]."""

    @property
    def velocities(self) -> Array:
        """Of the nodes (n, 3) [m/s]."""

    @property
    def accelerations(self) -> Array | None:
        """Of the nodes (n, 3) [m/s^2], None for schemes that carry none."""


class Scheme(Pytree):
    """A time scheme: its type is part of the program, its numbers (fields) are values that change without compiling.

    `name`: its word in `build` and scene files. `order`: of its error in dt. `rigid`: whether it serves scenes with
    rigid bodies, which themselves always move by the rule of backward Euler. `restarts`: whether a step in which
    something strikes has to be one of backward Euler for the bodies struck, whose accelerations then start anew.
    `straight`: whether positions move along the new velocities; then free bodies keep their angular momentum (see
    `system/momentum.py`). `lanes`: whether `stage` and `advance` also take nodes (n, 3, lanes), with `free` (n, 1, 1)
    and `dt` (lanes,), as sweeps on processors have them. `euler`: whether they are those of backward Euler itself,
    which rigid bodies and methods with a step of their own follow. Who defines either anew says these two anew.
    """

    name: ClassVar[str]
    order: ClassVar[int]
    rigid: ClassVar[bool] = False
    restarts: ClassVar[bool] = True
    straight: ClassVar[bool] = False
    lanes: ClassVar[bool] = False
    euler: ClassVar[bool] = False

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        for flag in ("lanes", "euler"):
            if not still_says(cls, flag, "stage", "advance"):
                setattr(cls, flag, False)
        if (name := cls.__dict__.get("name")) is None or hasattr(name, "__get__"):  # a base of others
            return
        for needed in ("stage", "advance"):
            if getattr(cls, needed) is getattr(Scheme, needed):
                raise TypeError(f'the time scheme "{cls.name}" ({cls.__name__}) has no `{needed}`: define it')
        if not hasattr(cls, "order"):
            raise TypeError(f'the time scheme "{cls.name}" ({cls.__name__}) does not say its `order`: give an integer')
        if flaw := flaw_of(
            cls, {"order": WHOLE, **dict.fromkeys(("rigid", "restarts", "straight", "lanes", "euler"), FLAG)}
        ):
            raise TypeError(f'the time scheme "{cls.name}" ({cls.__name__}) has {flaw}')
        SCHEMES.add(cls.name, cls)

    def check(self) -> None:
        """ValueError where one of its numbers makes no sense; called on the host, by `build`."""

    def begin(self, state: Moving, acceleration: Callable[[], Array]) -> Array | None:
        """The accelerations (n, 3) that a first step starts from, or None; `acceleration()`: those of the forces."""
        return None

    def stage(self, state: Moving, prescribed: Array, free: Array, dt: Array) -> Stage:
        """Where a step's rows are made. Nodes with `free` (n, 1) false move evenly with `prescribed` (n, 3)."""
        raise NotImplementedError

    def advance(self, state: Moving, velocities: Array, free: Array, dt: Array) -> tuple[Array, Array | None]:
        """Positions (n, 3) and accelerations (or None) at the end of a step, from its `velocities` (n, 3)."""
        raise NotImplementedError

    def slope(self, turn: Array) -> Array:
        """u = (z - 1) / turn, complex, for the eigenvalue z of a step dt on an undamped mode with `turn` = omega dt."""
        raise NotImplementedError(f'the time scheme "{self.name}" does not tell its damping: define `slope`')


SCHEMES: Registry["Scheme"] = Registry("time scheme")
"""All time schemes by name."""


def scheme_of(given: str | Scheme, dtype: Any, *numbers: Any, **options: Any) -> Scheme:
    """The scheme that a name or an object stands for, with numbers of its own of `dtype`: some given in its order, or
    by name as `options` (those that are not None).

    ValueError names what is not known or makes no sense.
    """
    options = {name: value for name, value in options.items() if value is not None}
    if isinstance(given, str):
        if given not in SCHEMES:
            raise ValueError(f"scheme is {given!r}; known: {', '.join(SCHEMES.words())}")
        kind = SCHEMES[given].made
    elif isinstance(given, Scheme):
        kind = type(given)
    else:
        raise ValueError(f"scheme is {given!r}; give a name ({', '.join(SCHEMES.words())}) or a Scheme object")
    own = [field.name for field in dataclasses.fields(kind)]
    takes = f"takes {', '.join(own)}" if own else "takes no numbers"
    if len(numbers) > len(own):
        raise ValueError(f'{len(numbers)} numbers are given for the scheme "{kind.name}", which {takes}')
    options = {**dict(zip(own, numbers, strict=False)), **options}
    for name in options:
        if name not in own:
            raise ValueError(f'{name} = {options[name]!r} is no number of the scheme "{kind.name}", which {takes}')
    scheme = kind(**options) if isinstance(given, str) else given.replace(**options)
    _check_numbers(scheme)
    scheme.check()
    found: Scheme = jax.tree.map(lambda value: jnp.asarray(value, dtype), scheme)
    return found


def _check_numbers(scheme: Scheme) -> None:
    """ValueError for fields that would become numbers and are none: a flag would be 1.0 in compiled code."""
    for field in dataclasses.fields(scheme):
        value = getattr(scheme, field.name)
        number = isinstance(value, int | float | np.number | np.ndarray | jax.Array) and not isinstance(value, bool)
        if not field.metadata.get("static") and not (number and jnp.issubdtype(jnp.result_type(value), jnp.number)):
            flag = isinstance(field.default, bool | str)
            advice = f"declare a flag or a word so, {field.name}: Any = static(default={field.default!r})"
            raise ValueError(
                f'{field.name} = {value!r} of the scheme "{scheme.name}" is no number: '
                f"{advice if flag else 'give a number'}"
            )


def scheme_damping(scheme: str | Scheme, frequencies: Any, dt: Any, *numbers: Any, **named: Any) -> Array:
    """Damping ratio that the time scheme itself gives to undamped modes of `frequencies` [rad/s] at steps `dt` [s].

    scheme: a name, "backward_euler" or "generalized_alpha", or an object; further `numbers` are the scheme's, in its
    order or `named`, like rho_inf=0.8, in place of its own. The shape of `frequencies` comes back; 0 for rigid motions.
    ValueError for an unknown scheme or impossible numbers.
    From the step's eigenvalue z = exp(s dt): ratio = -Re s / |s|.
    """
    known = jnp.asarray(frequencies)
    known = known if jnp.issubdtype(known.dtype, jnp.floating) else known.astype(float)
    scheme = scheme_of(scheme, known.dtype, *numbers, **named)
    _check_damping(known, dt)
    turn = known * dt
    slope = scheme.slope(turn)
    is_complex = isinstance(slope, jax.Array | np.ndarray) and jnp.issubdtype(slope.dtype, jnp.complexfloating)
    if not is_complex or slope.shape != turn.shape:
        wanted = f"a complex array of shape {turn.shape}, as the turns are that it is asked for"
        raise ValueError(f'`slope` of the scheme "{scheme.name}" gives {described(slope)}: it must give {wanted}')
    return _ratio(turn, jnp.asarray(slope))


@one_program
def _ratio(turn: Array, slope: Array) -> Array:
    """Of z = 1 + turn u, u the `slope`; log |z| without the digits that |z| = 1 + small would lose."""
    decay = 0.5 * jnp.log1p(turn * (2 * slope.real + turn * jnp.abs(slope) ** 2))
    angle = jnp.arctan2(turn * slope.imag, 1 + turn * slope.real)
    moving = turn > 0
    return jnp.where(moving, -decay / jnp.hypot(decay, jnp.where(moving, angle, 1)), 0)


def _check_damping(frequencies: Any, dt: Any) -> None:
    """Refuse numbers that make no sense, where they are known; within a compiled function they are not looked at."""
    if isinstance(frequencies, jax.core.Tracer) or isinstance(dt, jax.core.Tracer):
        return
    if not bool(jnp.all(frequencies >= 0)):
        raise ValueError("frequencies must be 0 or more, in rad/s")
    if not dt > 0:
        raise ValueError(f"dt is {dt}; it must be positive, in s")
