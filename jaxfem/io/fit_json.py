"""The numbers of a fit as JSON, and what that JSON looks like: a schema that programs may rely on."""

import dataclasses
from typing import Any

import numpy as np

from jaxfem.fitting.asked import Posterior, Profile, Refinement
from jaxfem.fitting.multistart import End
from jaxfem.fitting.result import FitResult, TakeFit

FORMAT = "jaxfem-fit/1"
NUMBER = {"type": "number"}
NUMBERS = {"type": "array", "items": NUMBER}
TEXTS = {"type": "array", "items": {"type": "string"}}
PAIR = {"type": "array", "items": NUMBER, "minItems": 2, "maxItems": 2}
OPEN_PAIR = {**PAIR, "items": {"type": ["number", "null"]}}
NAMED = {"type": "object", "additionalProperties": NUMBER}
TAKE: dict[str, Any] = {
    "name": {"type": "string"},
    "held_out": {"type": "boolean"},
    "unit": {"enum": ["m", "px"]},
    "markers": TEXTS,
    "samples": {"type": "integer"},
    "release_s": NUMBER,
    "release_interval_s": PAIR,
    "residual_rms": NUMBER,
    "marker_scatter": NUMBER,
    "share_in_95_percent_band": NUMBER,
    "worst": {"type": "object", "required": ["marker", "axis", "residual_rms"]},
    "autocorrelation": NUMBERS,
    "values": NAMED,
    "beside": {
        "type": "array",
        "items": {"type": "object", "required": ["what", "measured", "predicted", "sigma", "unit"]},
    },
}
FIELDS: dict[str, Any] = {
    "format": {"const": FORMAT},
    "status": {"enum": ["converged", "iteration limit", "steps failed", "interrupted"]},
    "values": NAMED,
    "standard_errors": NAMED,
    "intervals_95": {"type": "object", "additionalProperties": OPEN_PAIR},
    "starts": NAMED,
    "bounds": {"type": "object", "additionalProperties": PAIR},
    "units": {"type": "object", "additionalProperties": {"type": "string"}},
    "correlation": {"type": "array", "items": NUMBERS},
    "weakest": {"type": "string"},
    "loss": NUMBER,
    "samples_that_tell_the_same": NUMBER,
    "noise_memory": NUMBERS,
    "noise_sigmas": NAMED,
    "takes": {"type": "array", "minItems": 1, "items": {"type": "object", "required": list(TAKE), "properties": TAKE}},
    "simulations": {"type": "integer"},
    "iterations": {"type": "integer"},
    "engine": {"type": "string"},
    "discretisation": {"type": "array", "items": {"type": "object", "required": ["what", "by", "shift", "estimate"]}},
    "takes_alone": {
        "type": "array",
        "items": {
            "type": "object",
            "required": ["name", "values", "errors", "chance", "between", "mean", "interval"],
            "properties": {"values": NAMED, "errors": NAMED, "chance": NUMBER, "interval": PAIR},
        },
    },
    "profiles": {
        "type": "array",
        "items": {
            "type": "object",
            "required": ["name", "interval_95", "values", "drop"],
            "properties": {"interval_95": OPEN_PAIR, "values": NUMBERS, "drop": NUMBERS},
        },
    },
    "type_b": {
        "type": "array",
        "items": {"type": "object", "required": ["what", "by", "shift"], "properties": {"shift": NAMED}},
    },
    "starts_followed": {
        "type": "array",
        "items": {
            "type": "object",
            "required": ["start", "values", "loss", "drawn", "best"],
            "properties": {"start": NAMED, "values": NAMED, "loss": {"type": ["number", "null"]}},
        },
    },
    "posterior": {
        "type": ["object", "null"],
        "required": ["kind", "intervals_95", "means", "deviations", "independent_draws", "scale_reduction", "draws"],
        "properties": {
            "intervals_95": {"type": "object", "additionalProperties": PAIR},
            "stopped": {"type": "boolean"},
            "draws": {"type": "object", "additionalProperties": NUMBERS},
        },
    },
    "repairs": TEXTS,
    "warnings": TEXTS,
}
SCHEMA: dict[str, Any] = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "title": "What `jaxfem fit` found",
    "type": "object",
    "required": list(FIELDS),
    "properties": FIELDS,
}
"""JSON schema of fitted.json. Values are in SI units; residuals, scatter and sigmas in the take's unit."""


def as_json(result: FitResult) -> dict[str, Any]:
    """The numbers of a result as plain lists and dictionaries, as `SCHEMA` says; the first take's misfit on top too."""
    first = result.takes[0]
    return {
        "format": FORMAT,
        "values": result.values,
        "standard_errors": result.standard_errors,
        "intervals_95": {name: [_finite(end) for end in pair] for name, pair in result.intervals.items()},
        "starts": {name: float(value) for name, value in result.starts.items()},
        "bounds": {name: list(pair) for name, pair in result.bounds.items()},
        "units": {each.name: each.unit for each in result.constants},
        "correlation": result.correlation.tolist(),
        "weakest": result.weakest,
        "loss": result.loss,
        "samples_that_tell_the_same": result.inflation,
        "noise_memory": list(result.memory),
        "noise_sigmas": result.sigmas,
        f"residual_rms_{result.unit}": result.noise,
        "release_s": result.release,
        "release_interval_s": list(result.release_interval),
        "samples": len(first.times),
        "markers": list(first.markers),
        "takes": [take_as_json(take) for take in result.takes],
        "simulations": len(result.history),
        "iterations": result.iterations,
        "status": result.status,
        "engine": result.engine,
        "discretisation": [_refinement(each) for each in result.refinements],
        "takes_alone": [dataclasses.asdict(each) | {"interval": list(each.interval)} for each in result.agreement],
        "profiles": [_profile(each) for each in result.profiles],
        "type_b": [dataclasses.asdict(each) for each in result.contributions],
        "starts_followed": [_end(each) for each in result.ends],
        "posterior": None if result.posterior is None else _posterior(result.posterior),
        "repairs": list(result.repairs),
        "warnings": list(result.warnings),
    }


def _refinement(each: Refinement) -> dict[str, Any]:
    """A refit with a finer step or mesh."""
    return {
        "what": each.what,
        "by": each.by,
        "values": each.values,
        "shift": each.shift,
        "estimate": each.estimate,
        "converged": each.converged,
    }


def _profile(each: Profile) -> dict[str, Any]:
    """A curve, and where it passes 3.84."""
    return {
        "name": each.name,
        "interval_95": [_finite(end) for end in each.interval],
        "values": each.values.tolist(),
        "drop": each.drop.tolist(),
    }


def _end(each: End) -> dict[str, Any]:
    """Where a start led."""
    loss = _finite(each.loss)
    return {"start": each.start, "values": each.values, "loss": loss, "drawn": each.drawn, "best": each.best}


def _posterior(found: Posterior) -> dict[str, Any]:
    """Draws, chain after chain, and what they say."""
    chains, count = found.values.shape[:2]
    digits = {name: [float(f"{v:.7g}") for v in found.values[..., k].ravel()] for k, name in enumerate(found.names)}
    return {
        "kind": found.kind,
        "chains": chains,
        "draws_a_chain": count,
        "intervals_95": {name: list(pair) for name, pair in found.intervals.items()},
        "means": found.means,
        "deviations": found.deviations,
        "independent_draws": found.effective,
        "scale_reduction": found.scale_reduction,
        "accepted": found.accepted,
        "divergent": found.divergent,
        "stopped": found.stopped,
        "draws": digits,
    }


def _finite(end: float) -> float | None:
    """An end of an interval; null where it is open towards that side."""
    return end if np.isfinite(end) else None


def take_as_json(take: TakeFit) -> dict[str, Any]:
    """One recording's misfit."""
    marker, axis, rms = take.worst
    return {
        "name": take.name,
        "held_out": take.held_out,
        "unit": take.unit,
        "markers": list(take.markers),
        "samples": len(take.times),
        "release_s": float(take.release),
        "release_interval_s": [float(each) for each in take.release_interval],
        "residual_rms": take.noise,
        "marker_scatter": take.scatter,
        "share_in_95_percent_band": take.covered,
        "worst": {"marker": marker, "axis": axis, "residual_rms": rms},
        "autocorrelation": np.round(take.autocorrelation, 6).tolist(),
        "values": {name: float(value) for name, value in take.values.items()},
        "beside": [dataclasses.asdict(each) for each in take.beside],
    }
