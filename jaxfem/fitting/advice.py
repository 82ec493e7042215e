"""Warnings of a fit: what would make its values wrong although it converged."""

from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np

from jaxfem.fitting.measurement import Measurement
from jaxfem.fitting.statistics import OPEN_CORRELATION, Uncertainty, ringing_frequency
from jaxfem.fitting.unknowns import Unknowns, is_delay
from jaxfem.materials.constants import Constant
from jaxfem.materials.moduli import ratio_and_modulus
from jaxfem.model import Model, Params, element_stiffness
from jaxfem.schemes import scheme_damping


def advice(
    model: Model,
    params: Params,
    unknowns: Unknowns,
    z: np.ndarray,
    uncertainty: Uncertainty,
    measured: Measurement,
    simulated: np.ndarray,
    dt: float,
    step_failures: int,
) -> tuple[str, ...]:
    """All warnings that apply, most important first. `simulated` (T, M, 3) at the measured times."""
    texts = [
        *_locking(model, params, unknowns),
        *_scheme_damping(model, unknowns, z, measured, simulated, dt),
        *_at_bounds(unknowns, z),
        *_open_unknowns(unknowns, uncertainty),
        *_doubtful(unknowns, z),
    ]
    if step_failures:
        texts.append(
            f"{step_failures} of the simulations, the last among them, had steps that did not converge: loosen the "
            "solver's tolerance or raise its iteration limit, and fit again"
        )
    if model.rest.dtype == jnp.float32:
        texts.append("computed in single precision: values are good to about 1e-3; use float64 for more")
    return tuple(texts)


def _locking(model: Model, params: Params, unknowns: Unknowns) -> list[str]:
    if not model.laws:
        return []
    poisson = float(jnp.max(ratio_and_modulus(*element_stiffness(model, params))[0]))
    if poisson <= 0.45 + 1e-6 or not any(each.whole for each in model.domains):
        return []
    return [
        f"Poisson's ratio is {poisson:.4g} with plain linear tetrahedra, which lock above 0.45: they are too stiff "
        "(about five times near 0.499 on a coarse mesh), and Young's modulus comes out too low by that factor. Take "
        'strain = "smoothed", hold the ratio at 0.45 or below, or refine the mesh and see whether the values stay'
    ]


def _scheme_damping(
    model: Model, unknowns: Unknowns, z: np.ndarray, measured: Measurement, simulated: np.ndarray, dt: float
) -> list[str]:
    """The scheme damps a mode by a ratio of its own (backward Euler omega dt / 2), the material by omega beta / 2."""
    viscous = [each for each in unknowns.constants if each.viscous]
    if model.scheme.order > 1 or not viscous:
        return []
    damping = unknowns.values(z)[viscous[0].name]
    frequency = ringing_frequency(measured.times, simulated)
    if frequency == 0:
        return []
    own, material = float(scheme_damping(model.scheme, 2 * np.pi * frequency, dt)), np.pi * frequency * damping
    alike = own / (np.pi * frequency)  # s; a material's damping that is as strong
    if alike <= 0.5 * damping:
        return []
    return [
        f"at the ringing frequency of {frequency:.3g} Hz the time step of {dt:.3g} s by itself damps with ratio "
        f"{own:.2g} (backward Euler: omega dt / 2), the fitted damping of {damping:.3g} s with {material:.2g}: the "
        f"fitted value holds for this step only, and the material's is nearer to {damping + alike:.3g} s. Take more "
        f"substeps, to a step below {0.1 * (damping + alike) * dt / alike:.1g} s"
    ]


def _at_bounds(unknowns: Unknowns, z: np.ndarray) -> list[str]:
    texts = []
    values = unknowns.values(z)
    for constant, each, low, high in zip(unknowns.constants, z, *unknowns.box, strict=True):
        if at_bound(each, low, high) and not constant.limit:
            end = "lower" if each - low < high - each else "upper"
            texts.append(
                f"{constant.name} ended at its {end} bound, {values[constant.name]:.4g} {constant.unit}".rstrip()
                + ": the data want a value beyond it. Widen the bounds, or ask what the model lacks"
            )
    return texts


def at_bound(z: float, low: float, high: float) -> bool:
    """Whether an unknown ended at an end of its box."""
    return min(z - low, high - z) < 1e-6 * (high - low)


def _open_unknowns(unknowns: Unknowns, uncertainty: Uncertainty) -> list[str]:
    names = unknowns.names
    if uncertainty.singular:
        return [
            f"these samples do not determine {', '.join(names)} together: hold one of them fixed, or record markers "
            "that move otherwise (across the body for poisson, more ringing for damping)"
        ]
    texts, spread = [], np.sqrt(np.diag(uncertainty.covariance))
    for constant, each in zip(unknowns.constants, spread, strict=True):
        if each > constant.transform.open_spread and not constant.limit:  # those: see `limits.py`
            texts.append(
                f"{constant.name} is practically undetermined by these samples: its error bar is as large as itself"
            )
    correlation = uncertainty.correlation
    for i, j in zip(*np.triu_indices(len(names), 1), strict=True):
        if abs(correlation[i, j]) > OPEN_CORRELATION:
            texts.append(
                f"{names[i]} and {names[j]} trade off against each other (correlation {correlation[i, j]:.3f}): only a "
                "combination of them is determined"
            )
    return texts


def _doubtful(unknowns: Unknowns, z: np.ndarray) -> list[str]:
    texts, values = [], unknowns.values(z)
    for each in unknowns.constants:
        if each.doubt is not None and values[each.name] < each.doubt[0]:
            texts.append(f"{each.title} came out as {values[each.name]:.3g}; {each.doubt[1]}")
    return texts


def sample_advice(
    measured: Sequence[Measurement], unknowns: Unknowns, uncertainty: Uncertainty, names: Sequence[str]
) -> tuple[str, ...]:
    """Warnings of what the samples of each take leave open."""
    texts: list[str] = []
    for each, name in zip(measured, names, strict=True):
        where = f"{name}: " if len(names) > 1 else ""
        begins, low, high = each.begins
        if high > low and not any(is_delay(constant) for constant in unknowns.constants):
            texts.append(
                f"{where}the release was found at {begins:g} s and may lie from {low:g} to {high:g} s: error bars know "
                'nothing of that. Fit "delay" too, or give release = TIME'
            )
        if each.left_out:
            listed = ", ".join(each.left_out)
            texts.append(f"{where}{listed}: never seen before the release, so left out of the displacements")
    if smooth(uncertainty):
        texts.append(
            f"the residuals are smooth in time (about {uncertainty.inflation:.0f} samples tell the same): the noise "
            "remembers, or the model leaves out something that the body does. Error bars are those of such noise, and "
            "know nothing of a bias"
        )
    return tuple(texts)


def smooth(uncertainty: Uncertainty) -> bool:
    """Whether residuals are alike from sample to sample; exact data leave rounding errors."""
    return uncertainty.inflation > 3 and uncertainty.noise > 1e-6


def weakest_in_words(unknowns: Unknowns, z: np.ndarray, uncertainty: Uncertainty) -> str:
    """The combination of parameters that is known worst: what changes together within one standard error."""
    direction = uncertainty.weakest
    if len(z) < 2 or uncertainty.singular or not direction.size:
        return ""
    variance = float(direction @ uncertainty.covariance @ direction) / max(float(direction @ direction) ** 2, 1e-300)
    step = direction * np.sqrt(max(variance, 0.0))
    bars = np.sqrt(np.maximum(np.diag(uncertainty.covariance), 1e-300))
    parts = []
    for constant, each, bar, slope in zip(unknowns.constants, step, bars, unknowns.slopes(z), strict=True):
        if abs(each) < 0.2 * bar:
            continue
        share = f"{100 * each:+.2g} %" if constant.transform.proportional else f"{each * slope:+.2g} {constant.unit}"
        parts.append(f"{constant.name} {share}".rstrip())
    if len(parts) < 2:
        return ""
    return f"known worst is a change together, within one standard error: {', '.join(parts)}"


def text_of(
    constants: Sequence[Constant],
    values: Mapping[str, float],
    errors: Mapping[str, float],
    intervals: Mapping[str, tuple[float, float]],
) -> str:
    """One line a parameter: value, error bar, unit, 95 % interval."""
    width = max(9, *(len(each.name) for each in constants))
    lines = []
    for each in constants:
        low, high = intervals[each.name]
        if not (np.isfinite(low) and np.isfinite(high)):  # no number, then: any value on that side tells the same
            words = interval_in_words(low, high, each.unit)
            lines.append(f"  {each.name:<{width}}   {words}   (95 %; the search ended at {values[each.name]:.3g})")
            continue
        bar = f"{values[each.name]:>12.5g} +- {errors[each.name]:<10.2g}{each.unit}".rstrip()
        lines.append(f"  {each.name:<{width}}{bar}   (95 %: {interval_in_words(low, high)})")
    return "\n".join(lines)


def interval_in_words(low: float, high: float, unit: str = "") -> str:
    """An interval, one-sided where an end is infinite."""
    if not (np.isfinite(low) or np.isfinite(high)):
        return "open towards both sides"
    if np.isfinite(low) and np.isfinite(high):
        return f"{low:.5g} to {high:.5g} {unit}".rstrip()
    return f"at least {low:.5g} {unit}".rstrip() if np.isfinite(low) else f"at most {high:.5g} {unit}".rstrip()
