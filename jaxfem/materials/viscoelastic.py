"""Linear viscoelasticity: a Prony series of branches that relax, beside the elastic stiffness.

Branch i is a spring of g_i times the relaxed stiffness D in series with a dashpot of relaxation time tau_i. Its spring
has the strain s_i (Taylor, Pister & Goudreau 1970; Simo & Hughes 1998, chapter 10):
    ds_i/dt = de/dt - s_i / tau_i,     stress = D (e + sum g_i s_i).
For a constant strain rate over dt, with x = dt / tau_i, exactly and stable at any dt,
    s_i+ = exp(-x) s_i + p(x) (e+ - e),     p(x) = (1 - exp(-x)) / x,
so that a step stays linear in its strain: stress = D (f e+ + sum g_i exp(-x) s_i - sum g_i p e), f = 1 + sum g_i p.
"""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.materials.base import Material, Pair, Response, Values
from jaxfem.materials.constants import Constant, MaterialError
from jaxfem.materials.linear import DAMPING, POISSON, YOUNG
from jaxfem.materials.moduli import eigenstiffness, ratio_and_modulus

Array = jax.Array

PARTS = ("deviatoric", "all")
SERIES = 1e-2
"""Below this many relaxation times a step's loss is a series: digits cancel in the closed form."""


class Relaxing(NamedTuple):
    """What b branches remember of rows that relax: each domain's last `strain` (k, D), and `springs` (b, k, D)."""

    strain: Array
    springs: Array


class Viscoelastic(Material, word="viscoelastic"):
    """Stress D (e + beta de/dt + sum g_i s_i), D of the *relaxed* `young` [Pa] and `poisson`, beta `damping` [s].

    `branches`: pairs (g_i, tau_i), the share of the relaxed stiffness that branch i adds and its relaxation time [s];
    or how many there are, with `g_1`, `tau_1`, `g_2`, ... each by its name: so scene files, fits and params call them,
    and each takes one number, or one an element. `part`: what relaxes, the "deviatoric" stiffness (the volume answers
    elastically) or "all" of it. Without branches it is the linear law. Raises MaterialError.
    """

    constants = (YOUNG, POISSON, DAMPING)
    options: ClassVar[Mapping[str, Any]] = {"branches": 1, "part": "deviatoric"}
    relaxes = True
    branches: int
    part: str

    def __init__(
        self,
        young: Any = None,
        poisson: Any = None,
        damping: Any = None,
        branches: int | Sequence[tuple[Any, Any]] = 1,
        part: str = "deviatoric",
        **given: Any,
    ):
        if not isinstance(branches, int | np.integer):
            pairs = list(branches) if isinstance(branches, Sequence | np.ndarray) else [branches]
            if any(not isinstance(each, Sequence | np.ndarray) or len(each) != 2 for each in pairs):
                raise MaterialError(
                    f"branches is {branches!r}; give pairs (g, tau), like [(0.1, 0.02), (0.05, 1)], or how many"
                )
            named = [(f"{word}_{k}", v) for k, pair in enumerate(pairs, 1) for word, v in zip(NAMES, pair, strict=True)]
            given, branches = {**dict(named), **given}, len(pairs)
        if isinstance(branches, bool) or branches < 0:
            raise MaterialError(f"branches is {branches!r}; give how many branches relax, 0 or more")
        if part not in PARTS:
            raise MaterialError(f"part is {part!r}; what relaxes is one of {', '.join(map(repr, PARTS))}")
        super().__init__(young=young, poisson=poisson, damping=damping, branches=int(branches), part=part, **given)

    @classmethod
    def constants_of(cls, options: Mapping[str, Any]) -> tuple[Constant, ...]:
        """The elastic ones, then g_i and tau_i of each branch."""
        return (*cls.constants, *(each for k in range(options["branches"]) for each in branch_constants(k + 1)))

    def stiffness(self, values: Values) -> Pair:
        """(3K, 2 mu) [Pa], relaxed."""
        return eigenstiffness(values["young"], values["poisson"])

    def storage_and_loss(
        self, frequencies: Any, modulus: str = "young", values: Values | None = None
    ) -> tuple[Array, Array]:
        """Storage and loss modulus [Pa] at angular `frequencies` [rad/s], in their shape; `damping` counted in.

        `modulus`: "young", "shear" or "bulk"; `values`: of the constants in place of its own, such as
        `params.constants`. With w = omega tau_i the stiffness is D (1 + i omega beta + sum g_i i w / (1 + i w)).
        """
        values = self.values if values is None else values
        turn = 1j * jnp.asarray(frequencies)
        whole = 1 + turn * values["damping"]
        pairs = [(values[f"g_{k}"], values[f"tau_{k}"]) for k in range(1, self.branches + 1)]
        relaxing = whole + sum(g * turn * tau / (1 + turn * tau) for g, tau in pairs)
        bulk, shear = self.stiffness(values)
        bulk, shear = bulk * (relaxing if self.part == "all" else whole), shear * relaxing
        known = {"young": ratio_and_modulus(bulk, shear)[1], "shear": shear / 2, "bulk": bulk / 3}
        if modulus not in known:
            raise MaterialError(f"modulus is {modulus!r}; give one of {', '.join(map(repr, known))}")
        return known[modulus].real, known[modulus].imag

    def internal0(self, strain: Array) -> Relaxing | None:
        """Relaxed at the `strain`: no spring has any."""
        return self._remembered(strain, jnp.zeros_like)

    def internal_at_once(self, values: Values, strain: Array) -> Relaxing | None:
        """Taken to the `strain` at once: every spring has all of it."""
        return self._remembered(strain, jnp.copy)

    def _remembered(self, strain: Array, spring: Any) -> Relaxing | None:
        own = strain[max(len(strain) - 5, 0) if self.part == "deviatoric" else 0 :]
        if self.branches == 0 or (self.part == "deviatoric" and len(strain) == 1):
            return None
        return Relaxing(own, spring(jnp.broadcast_to(own, (self.branches, *own.shape))))

    def response(self, values: Values, internal: Relaxing, dt: Array, rows: slice) -> Response:
        """Linear in the strain `dt` later: see the head of this file."""
        g, x = self._branches(values, dt)
        gain = g * follow(x)
        factor = 1 + jnp.sum(gain, axis=0)
        known = jnp.sum(beside(g * jnp.exp(-x)) * internal.springs, axis=0) - (factor - 1) * internal.strain
        still = jnp.zeros((rows.stop - rows.start - len(known), *known.shape[1:]), known.dtype)
        offset = jnp.concatenate([still, known / factor])
        return Response((factor if self.part == "all" else 1.0, factor), offset)

    def commit(self, values: Values, internal: Relaxing, strain: Array, dt: Array, rows: slice) -> Relaxing:
        """The exact recursion over the step."""
        own = strain[len(strain) - len(internal.strain) :]
        change = own - internal.strain
        _, x = self._branches(values, dt)
        return Relaxing(own, beside(jnp.exp(-x)) * internal.springs + beside(follow(x)) * change)

    def tensors(self, values: Values, internal: Relaxing, strain: Array, rows: slice) -> dict[str, Array]:
        """The strain from which all stiffness, that of the branches too, would give the stress at once."""
        g, _ = self._branches(values)
        total = jnp.sum(beside(g) * (internal.strain - internal.springs), axis=0)
        still = jnp.zeros((len(strain) - len(total), *total.shape[1:]), total.dtype)
        return {"viscous_strain": jnp.concatenate([still, total / (1 + jnp.sum(g, axis=0))])}

    def stored(self, values: Values, internal: Relaxing, weights: Array, rows: slice) -> Array:
        """That of the branches' springs."""
        weights = weights[len(weights) - len(internal.strain) :]
        g, _ = self._branches(values)
        return 0.5 * jnp.sum(beside(g) * weights * internal.springs**2, axis=(0, 1))

    def dissipated(
        self, values: Values, before: Relaxing, after: Relaxing, strain: Array, weights: Array, dt: Array, rows: slice
    ) -> dict[str, Array]:
        """That of the dashpots, g_i D s_i^2 / tau_i over the step, exactly for a constant strain rate."""
        weights = weights[len(weights) - len(before.strain) :]
        change = after.strain - before.strain
        g, x = self._branches(values, dt)
        old, both, new = map(beside, lost_shares(x))
        square = old * before.springs**2 + 2 * both * before.springs * change + new * change**2
        return {"viscous": jnp.sum(beside(g) * weights * square, axis=(0, 1))}

    def _branches(self, values: Values, dt: Any = 0.0) -> tuple[Array, Array]:
        """g_i and `dt` / tau_i of all branches, each (b,) or (b, D)."""
        numbers = range(1, self.branches + 1)
        parts = [values[f"g_{k}"] for k in numbers] + [dt / values[f"tau_{k}"] for k in numbers]
        both = jnp.stack(jnp.broadcast_arrays(*parts))
        return both[: self.branches], both[self.branches :]


NAMES = ("g", "tau")


def branch_constants(number: int) -> tuple[Constant, Constant]:
    """g and tau of the branch of this number, counted from 1."""
    share = Constant(
        f"g_{number}",
        "",
        "must be >= 0; it is the share of the relaxed stiffness that the branch adds, like 0.1",
        label=f"share of branch {number}",
        low=0.0,
        closed=True,
        plausible=(0.0, 1e4),
    )
    time = Constant(
        f"tau_{number}",
        "s",
        "must be > 0 s; it is the time in which the branch relaxes",
        label=f"relaxation time of branch {number}",
        low=0.0,
        plausible=(1e-9, 1e9),
    )
    return share, time


def beside(numbers: Array) -> Array:
    """Numbers of the branches, (b,) or (b, D), beside what they remember, (b, k, D)."""
    return numbers[:, None, None] if numbers.ndim == 1 else numbers[:, None]


def follow(x: Array) -> Array:
    """p(x) = (1 - exp(-x)) / x, to all digits for small x > 0."""
    return -jnp.expm1(-x) / x


def lost_shares(x: Array) -> tuple[Array, Array, Array]:
    """Integral of s^2 over a time x in units of tau, as a form in the first s and the change of strain.

    s = s0 exp(-u) + change (1 - exp(-u)) / x: coefficients of s0^2, of 2 s0 change, and of change^2.
    """
    once, twice = -jnp.expm1(-x), -jnp.expm1(-2 * x)
    far = jnp.where(x > SERIES, x, 1)
    exact = (far + 2 * jnp.expm1(-far) - jnp.expm1(-2 * far) / 2) / far**2
    series = x * (1 / 3 - x * (1 / 4 - x * (7 / 60 - x / 24)))
    return twice / 2, once**2 / (2 * x), jnp.where(x > SERIES, exact, series)
