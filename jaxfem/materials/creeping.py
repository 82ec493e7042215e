"""Creep plasticity: strain beyond yield flows at a rate in proportion to the elastic strain, up to a maximum.

Algorithm 1 of Benevolensky & Voroshilov 2009, after Mueller & Gross 2004, once a step and so linear within it: with
e_el = e - e_p, norms those of the Kelvin-Mandel basis (of the tensors, that is, which do not change with the axes),
    |e_el| > yield:   e_p += s e_el,  s = min(dt creep, 1 - yield/|e_el|);      |e_p| > maximum:   e_p *= maximum/|e_p|
and e_el anew. The paper has s = dt creep. That must not pass 1; and beyond 1 - yield/|e_el| it flows past the surface
of yield, by what depends on the step, and has no derivative in the yield strain: see the option `overshoot`.
"""

from collections.abc import Mapping
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from jaxfem.materials.base import Material, Pair, Response, Values
from jaxfem.materials.constants import Constant
from jaxfem.materials.linear import DAMPING, POISSON, YOUNG
from jaxfem.materials.moduli import eigenstiffness

Array = jax.Array

EDGE = 32.0
"""Roundings of a strain within which a state is at the edge of yield."""
ROUNDING = 1e-5
"""Share by which a plastic strain that was scaled to the maximum may be above it."""

YIELD = Constant(
    "yield_strain",
    "",
    "must be >= 0; it is the norm of the elastic strain above which it flows, like 0.02",
    label="yield strain",
    low=0.0,
    closed=True,
    plausible=(0.0, 10.0),
)
CREEP = Constant(
    "creep",
    "1/s",
    "must be >= 0 1/s; it is the share of the elastic strain that flows in a second",
    label="creep rate",
    low=0.0,
    closed=True,
    plausible=(0.0, 1e9),
)
MAXIMUM = Constant(
    "maximum",
    "",
    "must be >= 0; it is the largest norm of the plastic strain, like 0.5",
    label="largest plastic strain",
    low=0.0,
    closed=True,
    plausible=(0.0, 1e9),
    default=1e3,
)


class CreepPlastic(Material, word="creep_plastic"):
    """Stress D (e - e_p + beta de/dt); where the norm of e - e_p is above `yield_strain`, e_p flows towards e.

    `creep` [1/s]: the share of the elastic strain that flows in a second; `maximum`: the largest norm of e_p. `young`
    [Pa], `poisson`, `damping` [s] as in `Linear`; each one number, or one an element. `volume_preserving`: only the
    deviatoric strain flows, and only it is compared. `overshoot`: flow by the letter of the paper, min(dt creep, 1) of
    the elastic strain, past the surface of yield. Norms are of what a domain takes: all of the strain of an element;
    with "nodal_volume" and "smoothed" strain the two parts flow each by its own. First order in the step.
    """

    constants = (YOUNG, POISSON, DAMPING, YIELD, CREEP, MAXIMUM)
    options: ClassVar[Mapping[str, Any]] = {"volume_preserving": False, "overshoot": False}
    volume_preserving: bool
    overshoot: bool

    def stiffness(self, values: Values) -> Pair:
        """(3K, 2 mu) [Pa]."""
        return eigenstiffness(values["young"], values["poisson"])

    def internal0(self, strain: Array) -> Array | None:
        """No plastic strain (r, D)."""
        return None if self.volume_preserving and len(strain) == 1 else jnp.zeros_like(strain)

    def response(self, values: Values, internal: Array, dt: Array, rows: slice) -> Response:
        """Elastic from the plastic strain."""
        return Response((1.0, 1.0), -internal)

    def rest_strain(self, values: Values, internal: Array, rows: slice) -> Array:
        """The plastic strain."""
        return internal

    def commit(self, values: Values, internal: Array, strain: Array, dt: Array, rows: slice) -> Array:
        """The plastic strain after the step: see the head of this file.

        Where scaling to the maximum would give energy back, nothing flows: a stiff volume beside soft shear could.
        """
        elastic = self._elastic(internal, strain)
        size = norm(elastic)
        beyond = size > values["yield_strain"]
        most = 1.0 if self.overshoot else 1 - values["yield_strain"] / jnp.where(beyond, size, 1)
        share = jnp.where(beyond, jnp.minimum(dt * values["creep"], most), 0)
        flowed = internal + share * elastic
        length = norm(flowed)
        above = length > values["maximum"]
        capped = flowed * jnp.where(above, values["maximum"] / jnp.where(above, length, 1), 1)
        change = capped - internal
        lossy = jnp.sum(self._weighted(values, elastic - change / 2, rows) * change, axis=0) >= 0
        lowered = norm(internal) > (1 + ROUNDING) * values["maximum"]  # the maximum itself, since the last step
        return jnp.where(lossy | lowered, capped, internal)

    def counts(
        self, values: Values, before: Array, after: Array, strain: Array, dt: Array, rows: slice
    ) -> dict[str, Array]:
        """Domains that flowed, and apart from them those at the edge of yield, to rounding: derivatives are one-sided
        there."""
        size = norm(self._elastic(before, strain))
        edge = EDGE * jnp.finfo(size.dtype).eps * (1 + size)
        at_yield = (jnp.abs(size - values["yield_strain"]) <= edge) & (values["yield_strain"] > 0)
        return {"flowing": jnp.sum(jnp.any(after != before, axis=0) & ~at_yield), "at_yield": jnp.sum(at_yield)}

    def tensors(self, values: Values, internal: Array, strain: Array, rows: slice) -> dict[str, Array]:
        """The plastic strain."""
        return {"plastic_strain": internal}

    def dissipated(
        self, values: Values, before: Array, after: Array, strain: Array, weights: Array, dt: Array, rows: slice
    ) -> dict[str, Array]:
        """The elastic energy that flow took, all at the end of the step."""
        change = after - before
        return {"plastic": jnp.sum(weights * (strain - before - change / 2) * change, axis=0)}

    def _elastic(self, internal: Array, strain: Array) -> Array:
        """The elastic strain (r, D) as far as it flows."""
        elastic = strain - internal
        if self.volume_preserving and len(elastic) == 6:
            return elastic.at[0].set(0)
        return elastic

    def _weighted(self, values: Values, elastic: Array, rows: slice) -> Array:
        """The stress (r, D) of an elastic strain."""
        volumetric, deviatoric = self.stiffness(values)
        weights = [volumetric, *[deviatoric] * 5][rows]
        return jnp.stack([w * row for w, row in zip(weights, elastic, strict=True)])


def norm(strain: Array) -> Array:
    """Norm (D,) of a tensor by its coefficients (r, D), with the derivative 0 at 0."""
    square = jnp.sum(strain**2, axis=0)
    some = square > 0
    return jnp.where(some, jnp.sqrt(jnp.where(some, square, 1)), 0)
