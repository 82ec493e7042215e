"""A constant that varies through a body: one unknown an element, or a region of them, neighbours being mostly alike.

With u the logarithms of the values, r(u) the residuals of all samples and s their scatter, what is minimised is

    |r(u)|^2 / s^2 + sum over neighbours i, j of  a_ij phi((u_i - u_j) / log jump)

a_ij the area between them over the mean one; phi(d) = d^2 ("smooth": Gaussian), or 2 (sqrt(1 + d^2) - 1) ("edges",
which lets few jumps be large: Charbonnier et al. 1997), met by reweighting. Levenberg-Marquardt steps with forward-mode
columns, some at a time side by side; s from the residuals with as many degrees of freedom as the prior leaves them
(MacKay 1992).
"""

import dataclasses
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.declared.errors import checked_choice
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.evaluation import BROKEN, Piece
from jaxfem.fitting.noise import Noise
from jaxfem.fitting.objective import Outcome, Plan, Problem, compared
from jaxfem.fitting.recovery import fit_takes, usual_scales
from jaxfem.fitting.takes import Take, compiled_piece, prepared
from jaxfem.fitting.unknowns import Unknowns
from jaxfem.model import Params
from jaxfem.solvers import Status

Array = jax.Array
KINDS = ("edges", "smooth")
SIDE_BY_SIDE = 32
"""Columns of the Jacobian made at once."""
SMALL = 2e-3
"""Change of all logarithms below which the search ends."""


@dataclasses.dataclass(frozen=True)
class FieldFit:
    """A constant, `name`, found as a field: `values` (R,) of the regions and `deviations` (R,), standard deviations of
    their logarithms under samples and prior; `regions` (E,) of the elements; `noise`: scatter of the samples, in their
    unit; `mean`: the one value that fits best; `gain`: share of the squared misfit that the field takes away from
    that; `params`: the first scene's with the field in; `status`: "converged" or "iteration limit"."""

    name: str
    unit: str
    values: np.ndarray
    deviations: np.ndarray
    regions: np.ndarray
    noise: float
    mean: float
    gain: float
    iterations: int
    status: str
    params: Params

    @property
    def elements(self) -> np.ndarray:
        """The value of each element (E,)."""
        return np.asarray(self.values[self.regions])


def fit_field(
    takes: Take | Sequence[Take],
    name: str = "young",
    *,
    regions: Any = None,
    jump: float = 1.2,
    kind: str = "edges",
    sigma: float | None = None,
    bounds: tuple[float, float] | None = None,
    iterations: int = 30,
    checks: str = "refuse",
    start: float | None = None,
) -> FieldFit:
    """Recover a positive constant of a material region by region, everything else held as in the scene.

    `regions` (E,): a number for each element, 0 to R - 1; each its own without it. `jump`: the factor by which
    neighbours usually differ; `kind`: see the head of this file. `sigma` [m, or px]: the samples' scatter, found
    without it. The search starts from the one value (within `bounds`) that fits best, or from `start`. FitError for
    what cannot be.
    """
    listed = [takes] if isinstance(takes, Take) else list(takes)
    checked_choice("kind", kind, KINDS, FitError)
    constant = listed[0].model.constants.get(name)
    if constant is None or not constant.transform.proportional:
        known = [each.name for each in listed[0].model.constants.values() if each.transform.proportional]
        raise FitError(f'no field of "{name}": give a positive constant of the scene\'s materials, {", ".join(known)}')
    if any(each.beside for each in listed):
        raise FitError("a field is found from markers alone: leave out what else was measured (beside)")
    if not jump > 1:
        raise FitError(f"jump is {jump!r}: give the factor by which neighbours usually differ, above 1, like 1.2")
    where = _checked_regions(regions, listed[0].model.elements.count)
    if start is None:
        one = {name: bounds} if bounds else None
        start = fit_takes(listed, parameters=[name], own=(), bounds=one, sigma=sigma, checks=checks).values[name]
    made = [prepared(each, checks) for each in listed]
    noise, nothing = Noise(sigma=sigma, known=sigma is not None), Unknowns((), np.zeros(0), np.zeros(0))
    usual = usual_scales(made)
    pieces = [compiled_piece(each, nothing, {}, noise, usual[each.unit]) for each in made]
    search = _Search(pieces, name, where, _laplacian_pairs(listed[0].model, where), np.log(jump), kind, noise.known)
    found = search.run(np.full(int(where.max()) + 1, np.log(start)), iterations)
    scale = float(sigma) if sigma is not None else usual[made[0].unit]
    values = np.exp(found.u)
    field = jnp.asarray(values[where], listed[0].model.rest.dtype)
    return FieldFit(
        name,
        constant.unit,
        values,
        found.deviations,
        where,
        found.scatter * scale,
        float(start),
        found.gain,
        found.iterations,
        found.status,
        made[0].params.replace(**{name: field}),
    )


def _checked_regions(regions: Any, count: int) -> np.ndarray:
    if regions is None:
        return np.arange(count)
    where = np.asarray(regions)
    if where.shape != (count,) or not np.issubdtype(where.dtype, np.integer):
        raise FitError(f"regions have shape {where.shape}: give a whole number for each of the {count} elements")
    if set(np.unique(where)) != set(range(int(where.max()) + 1)):
        raise FitError("regions must be numbered 0, 1, 2, ... without a gap: np.unique(regions, return_inverse=True)")
    return where


def _laplacian_pairs(model: Any, where: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (k, 2) of regions that share faces, and the areas between them over the mean one (k,)."""
    cells, rest = np.asarray(model.elements.cells), np.asarray(model.rest, np.float64)
    faces = np.sort(cells[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3), axis=1)
    owner = np.repeat(where, 4)
    order = np.lexsort(faces.T)
    faces, owner = faces[order], owner[order]
    same = (faces[1:] == faces[:-1]).all(axis=1)
    pairs = np.sort(np.column_stack([owner[:-1], owner[1:]])[same], axis=1)
    a, b, c = (rest[faces[:-1][same][:, k]] for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    apart = pairs[:, 0] != pairs[:, 1]
    found, inverse = np.unique(pairs[apart], axis=0, return_inverse=True)
    total = np.bincount(inverse.ravel(), area[apart], minlength=len(found))
    return found, total / max(total.mean(), 1e-300) if len(found) else total


@partial(jax.jit, static_argnames=("plan", "name"))
def field_residuals(u: Array, problem: Problem, plan: Plan, name: str, where: Array) -> tuple[Array, Outcome]:
    """Weighted residuals (T, M, 3) where the elements' values are exp(u)[where]."""
    params = problem.params.replace(**{name: jnp.exp(u)[where]})
    return compared(params, problem.state, problem, plan)


@partial(jax.jit, static_argnames=("plan", "name"))
def field_columns(u: Array, problem: Problem, plan: Plan, name: str, where: Array) -> Array:
    """Derivatives (R, T, M, 3) of the residuals in u."""

    def column(direction: Array) -> Array:
        pushed: Array = jax.jvp(lambda v: field_residuals(v, problem, plan, name, where)[0], (u,), (direction,))[1]
        return pushed

    found: Array = jax.lax.map(column, jnp.eye(u.size, dtype=u.dtype), batch_size=min(SIDE_BY_SIDE, u.size))
    return found


@dataclasses.dataclass(frozen=True)
class _Found:
    u: np.ndarray
    deviations: np.ndarray
    scatter: float
    gain: float
    iterations: int
    status: str


@dataclasses.dataclass(frozen=True)
class _Search:
    """The search for u; `width`: log jump."""

    pieces: Sequence[Piece]
    name: str
    where: np.ndarray
    neighbours: tuple[np.ndarray, np.ndarray]
    width: float
    kind: str
    known: bool

    def run(self, u: np.ndarray, iterations: int) -> _Found:
        """From u to the best; the noise's variance is found on the way."""
        r = self.residual(u)
        if not np.isfinite(r).all():
            raise FitError("the simulation broke down where the search for a field starts: give another start")
        first, variance, damping, status = float(r @ r), self._variance(r, 0.0), 1e-3, "iteration limit"
        number, inverse = 0, np.eye(u.size)
        while number < iterations:
            number += 1
            j = self.columns(u)
            weights = self._laplacian(u)
            normal, slope = j @ j.T / variance + weights, j @ r / variance + weights @ u
            inverse = np.linalg.pinv(normal, hermitian=True)
            variance = self._variance(r, float(np.trace(inverse @ (j @ j.T))) / variance)
            new, fresh, damping = self._step(u, r, normal, slope, variance, damping)
            moved, u, r = np.abs(new - u).max(), new, fresh
            if moved < SMALL:
                status = "converged"
                break
        deviations = np.sqrt(np.maximum(np.diag(inverse), 0.0))
        gain = 1 - float(r @ r) / first if first > 0 else 0.0
        return _Found(u, deviations, float(np.sqrt(variance)), gain, number, status)

    def _step(
        self, u: np.ndarray, r: np.ndarray, normal: np.ndarray, slope: np.ndarray, variance: float, damping: float
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """A point that is better, its residuals, the next damping; the same point where there is none."""
        now = self._value(u, r, variance)
        for _ in range(8):
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), -slope)
            step *= min(1.0, 1.0 / max(np.abs(step).max(), 1e-300))
            there = self.residual(u + step)
            if np.isfinite(there).all() and self._value(u + step, there, variance) < now:
                return u + step, there, max(damping / 10, 1e-9)
            damping *= 10
        return u, r, damping

    def _value(self, u: np.ndarray, r: np.ndarray, variance: float) -> float:
        pairs, areas = self.neighbours
        d = (u[pairs[:, 0]] - u[pairs[:, 1]]) / self.width
        price = d**2 if self.kind == "smooth" else 2 * (np.sqrt(1 + d**2) - 1)
        return float(r @ r) / variance + float(areas @ price)

    def _laplacian(self, u: np.ndarray) -> np.ndarray:
        """Half the second derivative (R, R) of the prior; of "edges" that of the parabola that touches it."""
        pairs, areas = self.neighbours
        i, j = pairs.T
        d = (u[i] - u[j]) / self.width
        w = areas / self.width**2 / (1.0 if self.kind == "smooth" else np.sqrt(1 + d**2))
        found = np.zeros((u.size, u.size))
        for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            np.add.at(found, (a, b), sign * w)
        return found

    def _variance(self, r: np.ndarray, freedom: float) -> float:
        if self.known:
            return 1.0
        count = sum(int(np.count_nonzero(np.asarray(each.problem.weights))) for each in self.pieces)
        return max(float(r @ r) / max(count - freedom, 0.1 * count), 1e-24)

    def residual(self, u: np.ndarray) -> np.ndarray:
        """Residuals (N,) of all takes; infinite where a simulation broke down."""
        parts = []
        for piece in self.pieces:
            r, outcome = field_residuals(*self._arguments(u, piece))
            bad = Status(int(outcome.status)) in BROKEN
            parts.append(np.full(r.size, np.inf) if bad else np.asarray(r, np.float64).ravel())
        return np.concatenate(parts)

    def columns(self, u: np.ndarray) -> np.ndarray:
        """Their derivatives (R, N)."""
        parts = [field_columns(*self._arguments(u, piece)) for piece in self.pieces]
        return np.concatenate([np.asarray(each, np.float64).reshape(u.size, -1) for each in parts], axis=1)

    def _arguments(self, u: np.ndarray, piece: Piece) -> tuple[Any, ...]:
        dtype = piece.problem.model.rest.dtype
        return jnp.asarray(u, dtype), piece.problem, piece.plan, self.name, jnp.asarray(self.where, jnp.int32)


def as_columns(found: FieldFit, model: Any) -> Mapping[str, np.ndarray]:
    """A table of the field: element, region, place of the element's middle [m], value, standard deviation of its
    logarithm."""
    middle = np.asarray(model.rest, np.float64)[np.asarray(model.elements.cells)].mean(axis=1)
    return {
        "element": np.arange(len(middle)),
        "region": found.regions,
        "x_m": middle[:, 0],
        "y_m": middle[:, 1],
        "z_m": middle[:, 2],
        found.name: found.elements,
        "deviation_of_log": found.deviations[found.regions],
    }
