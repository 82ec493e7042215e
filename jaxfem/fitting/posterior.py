"""Draws from the distribution of the parameters that samples and priors leave, by blackjax (an extra).

In the unknowns z, with S(z) the sum of squares of the fit's own weighted residuals and p(z) its priors' rows, the
density is, the noise's variance s^2 integrated out with n degrees of freedom (Gelman et al. 2013, section 3.2),

    log density = -(n / 2) log(1 + (S(z) - S(z0)) / (n s^2)) - |p(z)|^2 / 2 + constant,

uniform in z where there is no prior; where the noise is known its first term is -S(z) / (2 s^2). Chains walk in
u = L^-1 (z - z0), L L' the covariance of the fit: there the distribution is near a unit one, so that little has to be
tuned. Where noise remembers and was not whitened S is that of independent samples; it is then looked at in
z0 + L_0 u, L_0 L_0' the covariance of such samples (Chandler & Bate 2007), so that the draws spread as the error bars.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.declared.errors import checked_choice
from jaxfem.fitting.asked import Posterior
from jaxfem.fitting.beside.rows import Aside, data_rows
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.evaluation import BROKEN, Evaluator
from jaxfem.fitting.objective import Plan, Problem, residuals
from jaxfem.fitting.result import FitResult
from jaxfem.fitting.rounds import Judged
from jaxfem.pytrees import Pytree, static

Array = jax.Array
KINDS = ("nuts", "walk")
CHUNK = 10
"""Draws of each chain between two times that progress is told."""
FEWEST = 20
"""Draws of each chain that say something."""
WARMUP = 150
FIRST_STEP = 0.7
DOUBLINGS = 5
"""Of a path: 32 steps cross what is near a unit distribution more than once; a warm-up may take thousands else."""
BEST_WALK = 2.38  # over the root of the number of parameters (Roberts, Gelman & Gilks 1997)


class Data(Pytree):
    """All arrays of the density: `problems` of the takes, `maps` that weigh and whiten their residuals, the solution
    `z0` (P,), `shape` and `plain` (P, P), the Cholesky factors L and L_0, the `box` (2, P), `scale` s^2 and `freedom`
    n of it, infinite where it is known, `least` = S(z0) and the priors' at z0; `asides`: data beside the samples."""

    problems: tuple[Problem, ...]
    maps: Any
    z0: Array
    shape: Array
    plain: Array
    box: Array
    scale: Array
    freedom: Array
    least: Array
    asides: tuple[Aside, ...] = ()
    plans: tuple[Plan, ...] = static(default=())
    columns: tuple[tuple[int, ...], ...] = static(default=())


def sample(
    result: FitResult,
    draws: int = 500,
    *,
    chains: int = 4,
    warmup: int = WARMUP,
    kind: str = "nuts",
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
) -> FitResult:
    """The result with its `posterior`: so many `draws` of each of the `chains`, after `warmup` steps that set the
    step's length.

    `kind`: "nuts" (No-U-Turn sampler, Hoffman & Gelman 2014: 3 to 7 simulations with derivatives a draw) or "walk"
    (random walk Metropolis: one simulation a draw, and many more draws for the same information). Weights of robust
    losses and the noise's memory are those found with the solution. `progress(count)` is told how many draws of each
    chain are made. Ctrl-C keeps those made so far. FitError without blackjax, for parameters that samples leave
    open, and for counts that cannot be.
    """
    checked_choice("kind", kind, KINDS, FitError)
    for name, count, least in (("draws", draws, 10), ("chains", chains, 1), ("warmup", warmup, 20)):
        if isinstance(count, bool) or not isinstance(count, int) or count < least:
            raise FitError(f"{name} is {count!r}: give a whole number from {least} up")
    blackjax = blackjax_or_error()
    evaluator, best = result.solved()
    data, density = _data(evaluator, best), _density(evaluator, kind)
    tune, first, run = _programs(blackjax, density, kind, warmup)
    keys = jax.random.split(jax.random.key(seed), 3)
    size, dtype = len(best.z), data.z0.dtype
    tuned = tune(keys[0], jnp.zeros(size, dtype), data)
    state = first(0.5 * jax.random.normal(keys[1], (chains, size), dtype), data)
    found, told = [], []
    for number in range(0, draws, CHUNK):
        own = jax.random.split(jax.random.fold_in(keys[2], number), (CHUNK, chains))
        try:
            state, (u, info) = run(own, state, tuned, data)
            made = np.asarray(u, np.float64), [np.asarray(each, np.float64) for each in info]
        except KeyboardInterrupt:
            if number < FEWEST:
                raise
            break
        found.append(made[0])
        told.append(made[1])
        if progress is not None:
            progress(min(draws, number + CHUNK))
    walked = np.concatenate(found)[:draws].swapaxes(0, 1)  # (C, N, P)
    accepted, divergent = (np.concatenate([each[k] for each in told])[:draws] for k in range(2))
    z = np.asarray(best.z) + walked @ np.asarray(data.shape, np.float64).T
    posterior = _posterior(blackjax, evaluator, z, kind, float(accepted.mean()), int(divergent.sum()))
    posterior = dataclasses.replace(posterior, stopped=z.shape[1] < draws)
    return dataclasses.replace(result, posterior=posterior, warnings=(*result.warnings, *_doubts(posterior)))


def blackjax_or_error() -> Any:
    """The library; FitError where it is not installed."""
    try:
        import blackjax
    except ImportError as problem:
        raise FitError("posteriors need blackjax: pip install 'jaxfem[posterior]'") from problem
    return blackjax


def _data(evaluator: Evaluator, best: Judged) -> Data:
    """The density's arrays; FitError where the covariance is none."""
    dtype = evaluator.pieces[0].problem.model.rest.dtype
    spread = best.uncertainty
    try:
        shape, plain = (np.linalg.cholesky(each) for each in (spread.covariance, spread.plain))
    except np.linalg.LinAlgError:
        shape = plain = np.full((len(best.z), len(best.z)), np.nan)
    if spread.singular or not (np.isfinite(shape).all() and np.isfinite(plain).all()):
        raise FitError(
            f"no posterior: these samples do not determine {', '.join(evaluator.unknowns.names)} together. Hold one of "
            "them, or give it a prior"
        )
    for name, prior in (evaluator.priors.known if evaluator.priors else {}).items():
        if not hasattr(prior, "score"):
            raise FitError(f"the prior of {name}, {prior!r}, has no `score`, its row as a function that JAX can trace")
    flat = best.weighting.residual(evaluator.residual(best.z)[0])
    maps = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), best.weighting.maps(len(evaluator.pieces)))
    return Data(
        tuple(piece.problem for piece in evaluator.pieces),
        maps,
        z0=jnp.asarray(best.z, dtype),
        shape=jnp.asarray(shape, dtype),
        plain=jnp.asarray(plain, dtype),
        box=jnp.asarray(np.array(evaluator.unknowns.box), dtype),
        scale=jnp.asarray(spread.noise**2, dtype),
        freedom=jnp.asarray(spread.degrees, dtype),
        least=jnp.asarray(flat @ flat, dtype),
        asides=tuple(each.aside for each in evaluator.priors.data) if evaluator.priors else (),
        plans=tuple(piece.plan for piece in evaluator.pieces),
        columns=tuple(tuple(piece.columns.tolist()) for piece in evaluator.pieces),
    )


def _density(evaluator: Evaluator, kind: str) -> Callable[[Array, Data], Array]:
    """(u, data) -> log density; its gradient is made forwards, with the simulation, of which nothing has to be kept.
    A walk asks for none."""
    constants = evaluator.unknowns.constants
    priors = dict(evaluator.priors.known) if evaluator.priors else {}
    beside = [(each.columns, each.constants) for each in evaluator.priors.data] if evaluator.priors else []

    def value(u: Array, data: Data) -> Array:
        z, seen = data.z0 + data.shape @ u, data.z0 + data.plain @ u
        total, sound = jnp.zeros((), u.dtype), jnp.ones((), bool)
        for problem, plan, columns, weigh in zip(data.problems, data.plans, data.columns, data.maps, strict=True):
            r, outcome = residuals(seen[np.array(columns, int)], problem, plan)
            total = total + weigh.square(r)
            sound = sound & ~jnp.isin(outcome.status, jnp.array([int(each) for each in BROKEN]))
        gained = (total - data.least) / data.scale
        finite = jnp.where(jnp.isfinite(data.freedom), data.freedom, 1.0)
        told = jnp.where(jnp.isfinite(data.freedom), finite * jnp.log1p(jnp.maximum(gained / finite, -0.99)), gained)
        for number, constant in enumerate(constants):
            if constant.name in priors:
                told = told + priors[constant.name].score(constant.transform.value(seen[number])) ** 2
        for aside, (columns, own) in zip(data.asides, beside, strict=True):
            told = told + jnp.sum(data_rows(seen[columns], aside, own) ** 2)
        inside = jnp.all((z >= data.box[0]) & (z <= data.box[1]) & (seen >= data.box[0]) & (seen <= data.box[1]))
        return jnp.where(inside & sound & jnp.isfinite(told), -told / 2, -jnp.inf)

    def density(u: Array, data: Data) -> Array:
        at = jax.lax.stop_gradient(u)

        def slope(direction: Array) -> tuple[Array, Array]:
            return jax.jvp(lambda v: value(v, data), (at,), (direction,))

        level, gradient = jax.vmap(slope, out_axes=(None, 0))(jnp.eye(u.size, dtype=u.dtype))
        gradient = jnp.where(jnp.isfinite(gradient), gradient, 0)
        return jax.lax.stop_gradient(level) + jax.lax.stop_gradient(gradient) @ (u - at)

    return value if kind == "walk" else density


def _programs(blackjax: Any, density: Callable[[Array, Data], Array], kind: str, warmup: int) -> Any:
    """(tune, first, run): compiled, with the density's arrays as arguments."""

    def kernel(tuned: Any, data: Data) -> Any:
        own = lambda u: density(u, data)  # noqa: E731
        if kind == "walk":
            return blackjax.normal_random_walk(own, tuned)
        return blackjax.nuts(own, max_num_doublings=DOUBLINGS, **tuned)

    @jax.jit
    def tune(key: Array, u: Array, data: Data) -> Any:
        if kind == "walk":
            return BEST_WALK / jnp.sqrt(u.size) * jnp.ones_like(u)
        settings: dict[str, Any] = {"initial_step_size": FIRST_STEP, "is_mass_matrix_diagonal": False}
        settings["max_num_doublings"] = DOUBLINGS
        adapted = blackjax.window_adaptation(blackjax.nuts, lambda v: density(v, data), **settings)
        found = adapted.run(key, u, num_steps=warmup)[0].parameters
        return {name: found[name] for name in ("step_size", "inverse_mass_matrix")}

    @jax.jit
    def first(u: Array, data: Data) -> Any:
        untuned: Any = jnp.ones_like(u[0])
        if kind == "nuts":
            untuned = {"step_size": FIRST_STEP, "inverse_mass_matrix": untuned}
        return jax.vmap(kernel(untuned, data).init)(u)

    @jax.jit
    def run(keys: Array, state: Any, tuned: Any, data: Data) -> Any:
        step = jax.vmap(kernel(tuned, data).step)

        def one(state: Any, own: Array) -> Any:
            state, info = step(own, state)
            lost = info.is_divergent if kind == "nuts" else jnp.zeros_like(info.is_accepted)
            return state, (state.position, (info.acceptance_rate, lost))

        return jax.lax.scan(one, state, keys)

    return tune, first, run


def _posterior(
    blackjax: Any, evaluator: Evaluator, z: np.ndarray, kind: str, accepted: float, divergent: int
) -> Posterior:
    names, constants = evaluator.unknowns.names, evaluator.unknowns.constants
    values = np.stack(
        [np.asarray(each.transform.value(jnp.asarray(z[..., k]))) for k, each in enumerate(constants)], axis=-1
    )
    split = z if z.shape[0] > 1 else z[:, : 2 * (z.shape[1] // 2)].reshape(2, -1, z.shape[2])  # one chain's two halves
    reduction = np.asarray(blackjax.diagnostics.potential_scale_reduction(split))
    effective = np.asarray(blackjax.diagnostics.effective_sample_size(split))
    named = [dict(zip(names, np.atleast_1d(each).tolist(), strict=True)) for each in (reduction, effective)]
    return Posterior(names, values, kind, named[0], named[1], accepted, divergent)


def _doubts(found: Posterior) -> Sequence[str]:
    """Warnings of draws that do not tell the distribution."""
    texts = []
    if found.stopped:
        texts.append(f"posterior: drawing was interrupted after {found.values.shape[1]} draws of each chain")
    worst = max(found.scale_reduction, key=lambda name: found.scale_reduction[name])
    if not found.scale_reduction[worst] < 1.05:
        texts.append(
            f"posterior: the chains do not agree on {worst} (scale reduction {found.scale_reduction[worst]:.3g}, 1.05 "
            "at most is asked): make more draws"
        )
    if found.divergent:
        texts.append(
            f"posterior: {found.divergent} draws ran into a place where the density breaks off (a bound, or a "
            "simulation that broke down): the draws may lack a part of the distribution"
        )
    return texts
