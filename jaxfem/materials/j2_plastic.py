"""J2 plasticity with isotropic and kinematic hardening: metals, and what engineers expect of "plastic".

Return mapping (Simo & Hughes 1998, chapter 3) in the deviatoric rows of the eigenbasis, which are orthonormal, so that
von Mises' surface is a ball there. With e_p and a from the step before,
    xi = 2 mu (e - e_p) - 2/3 H_k e_p,          f = |xi| - sqrt(2/3) (yield + H_i a),
    g = max(f, 0) / (2 mu + 2/3 (H_i + H_k)),   e_p += g xi/|xi|,   a += sqrt(2/3) g.
The step's stress is the slope of  mu |e - e_p|^2 - (2 mu + 2/3 (H_i + H_k))/2 g^2,  which is convex: its second
derivative is the consistent tangent.
"""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.materials.base import Pair, Values
from jaxfem.materials.constants import Constant
from jaxfem.materials.linear import DAMPING, POISSON, YOUNG
from jaxfem.materials.moduli import eigenstiffness, shear_modulus
from jaxfem.materials.rotated import RotatedLaw

Array = jax.Array
Memory = dict[str, Array]

EDGE = 64.0
"""Roundings of a strain within which a state is at the edge of yield."""

YIELD_STRESS = Constant(
    "yield_stress",
    "Pa",
    "must be > 0 Pa (mild steel: 2.5e8); it is the stress of a pulled bar at which it yields",
    label="yield stress",
    low=0.0,
    plausible=(1e0, 1e13),
)
ISOTROPIC = Constant(
    "isotropic_hardening",
    "Pa",
    "must be >= 0 Pa; it is the slope of the yield stress over the plastic strain of a pulled bar",
    label="isotropic hardening",
    low=0.0,
    closed=True,
    default=0.0,
)
KINEMATIC = Constant(
    "kinematic_hardening",
    "Pa",
    "must be >= 0 Pa; it is the slope of the back stress over the plastic strain of a pulled bar",
    label="kinematic hardening",
    low=0.0,
    closed=True,
    default=0.0,
)


class J2Plastic(RotatedLaw, word="j2_plastic"):
    """Von Mises plasticity: elastic up to `yield_stress` [Pa], then hardening.

    `isotropic_hardening` (the surface grows) and `kinematic_hardening` (it moves with the plastic strain): the slopes
    of a pulled bar's stress over its plastic strain [Pa].

    `young` [Pa], `poisson`, `damping` [s] as in `Linear`; each one number, or one an element. Only the deviatoric
    strain flows. It remembers `plastic` strain (5, D) and its length `hardening` (D,), that of a pulled bar.
    """

    constants = (YOUNG, POISSON, DAMPING, YIELD_STRESS, ISOTROPIC, KINEMATIC)

    def stiffness(self, values: Values) -> Pair:
        """(3K, 2 mu) [Pa]."""
        return eigenstiffness(values["young"], values["poisson"])

    def internal0(self, strain: Array) -> Memory | None:
        """No plastic strain; none is kept where the volume alone is taken."""
        if len(strain) == 1:
            return None
        return {"plastic": jnp.zeros_like(strain[-5:]), "hardening": jnp.zeros_like(strain[0])}

    def sheared(self, values: Values, strain: Array, internal: Memory, dt: Any) -> Array:
        """The energy whose slope is the stress after the return."""
        _, excess, stiffness = self._trial(values, strain, internal)
        elastic = strain - internal["plastic"]
        mu = shear_modulus(values["young"], values["poisson"])
        return mu * jnp.sum(elastic**2, axis=0) - 0.5 * beyond_yield(excess) ** 2 / stiffness

    def commit(self, values: Values, internal: Memory, strain: Array, dt: Array, rows: slice) -> Memory:
        """The return to the surface of yield."""
        direction, excess, stiffness = self._trial(values, strain[-5:], internal)
        flow = beyond_yield(excess) / stiffness
        return {
            "plastic": internal["plastic"] + flow * direction,
            "hardening": internal["hardening"] + ROOT * flow,
        }

    def counts(
        self, values: Values, before: Memory, after: Memory, strain: Array, dt: Array, rows: slice
    ) -> Mapping[str, Array]:
        """Domains that flowed, and apart from them those at the edge of yield, to rounding: derivatives are one-sided
        there."""
        _, excess, _ = self._trial(values, strain[-5:], before)
        edge = EDGE * jnp.finfo(excess.dtype).eps * 2 * shear_modulus(values["young"], values["poisson"])
        return {"flowing": jnp.sum(excess > edge), "at_yield": jnp.sum(jnp.abs(excess) <= edge)}

    def tensors(self, values: Values, internal: Memory, strain: Array, rows: slice) -> dict[str, Array]:
        """The plastic strain."""
        own = internal["plastic"]
        return {"plastic_strain": own if len(strain) == 5 else jnp.concatenate([jnp.zeros_like(own[:1]), own])}

    def stored(self, values: Values, internal: Memory, weights: Array, rows: slice) -> Array:
        """Energy of hardening."""
        moved = values["kinematic_hardening"] / 3 * jnp.sum(internal["plastic"] ** 2, axis=0)
        grown: Array = 0.5 * values["isotropic_hardening"] * internal["hardening"] ** 2
        return moved + grown

    def dissipated(
        self, values: Values, before: Memory, after: Memory, strain: Array, weights: Array, dt: Array, rows: slice
    ) -> dict[str, Array]:
        """The elastic energy that flow took, less what hardening stores of it."""
        change = after["plastic"] - before["plastic"]
        taken = jnp.sum(weights[-5:] * (strain[-5:] - before["plastic"] - change / 2) * change, axis=0)
        kept = self.stored(values, after, weights, rows) - self.stored(values, before, weights, rows)
        return {"plastic": taken - kept}

    def _trial(self, values: Values, strain: Array, internal: Memory) -> tuple[Array, Array, Array]:
        """Direction of flow (5, D), stress beyond the surface of yield f (D,), and 2 mu + 2/3 (H_i + H_k)."""
        mu = shear_modulus(values["young"], values["poisson"])
        grown, moved = values["isotropic_hardening"], values["kinematic_hardening"]
        plastic = internal["plastic"]
        relative = 2 * mu * (strain - plastic) - 2 / 3 * moved * plastic
        surface = ROOT * (values["yield_stress"] + grown * internal["hardening"])
        square = jnp.sum(relative**2, axis=0)
        beyond = square > (0.5 * surface) ** 2  # far from where the norm has no derivative
        size = jnp.sqrt(jnp.where(beyond, square, surface**2))
        excess = jnp.where(beyond, size - surface, -surface)
        return relative / size, excess, 2 * mu + 2 / 3 * (grown + moved)


def beyond_yield(excess: Array) -> Array:
    """The positive part of the excess; at the edge itself its derivative is that of within, no mean of both sides."""
    return jnp.where(excess > 0, excess, 0)


ROOT = (2 / 3) ** 0.5
