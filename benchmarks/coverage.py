"""Do error bars hold?  python benchmarks/coverage.py [--quick] [--processes N] [--out FOLDER]

A small soft beam is held straight for 20 rows, let go and rings for 50; five markers at 100 rows a second. One
simulation, then noise on every coordinate, 0.5 % of the largest motion, drawn anew 1000 times: white, and with an
autocorrelation of .9 from row to row. Each draw is fitted (E, nu and damping) from values 1.5 times off, by least
squares ("effective") and, for the noise that remembers, by generalised least squares ("ar"). Of the draws: the share of
95 % intervals that hold the truth, the bars' mean over the estimates' scatter, and the mean error over that scatter; of
1000 draws that mean alone scatters by .03.
"""

import csv
import functools

import jax
import numpy as np
from machine import describe
from report import arguments, finish, save
from spread import spread

jax.config.update("jax_enable_x64", True)

import jaxfem as jf  # noqa: E402
from jaxfem.fitting import Noise, Search, attach, marker_positions  # noqa: E402

DT, STILL, ROWS, SHARE, RHO = 1e-2, 20, 50, 0.005, 0.9
TRUE = {"young": 2.6e5, "poisson": 0.35, "damping": 4e-3}
START = {"young": 3.9e5, "poisson": 0.25, "damping": 6e-3}
PLACES = {
    "tip": (0.1, 0.015, 0.036),
    "left": (0.1, -0.006, 0.024),
    "right": (0.1, 0.036, 0.006),
    "middle": (0.05, 0.015, 0.036),
    "side": (0.02, 0.036, 0.015),
}


class Beam:
    """The beam, its clean recording, and fits of it."""

    def __init__(self):
        body = jf.SoftBody(jf.mesh.box((0.1, 0.03, 0.03), (3, 1, 1)), density=1070.0, fixed="x-", **TRUE)
        scene = jf.Scene([body], gravity=(0.0, -4.0, -9.0))
        self.model, self.params, self.state = jf.build(scene, scheme="generalized_alpha")
        self.markers = attach(self.model, PLACES)
        states, _ = jf.rollout(self.model, self.params, self.state, DT, ROWS)
        first = marker_positions(self.markers, self.state.positions)[None]
        moving = np.concatenate([first, marker_positions(self.markers, states.positions)])
        self.clean = np.concatenate([np.repeat(first, STILL, axis=0), moving])
        self.sigma = SHARE * float(np.abs(moving - first).max())

    def fit(self, noise, correlation):
        recording = jf.Recording(DT * np.arange(len(self.clean)), self.clean + noise, tuple(PLACES))
        return jf.fit(
            self.model,
            self.params.replace(**START),
            self.state,
            recording,
            self.markers,
            parameters=tuple(TRUE),
            dt=DT,
            release=STILL * DT,
            noise=Noise(correlation=correlation),
            search=Search(candidates=1, polish=20, tol=1e-5),
            bounds={"young": (0.6 * TRUE["young"], 2.0 * TRUE["young"])},
        )


def drawn(rho, shape, seed):
    """Noise (T, M, 3) of unit variance, stationary, with autocorrelation rho^lag."""
    noise = np.random.default_rng(seed).normal(size=shape)
    for k in range(1, len(noise)):
        noise[k] = rho * noise[k - 1] + np.sqrt(1 - rho**2) * noise[k]
    return noise


def judged(rows):
    """Figures of each constant from (errors, standard errors, held) of all draws, each (n, 3) in transformed units."""
    off, bars, held = (np.array(each) for each in zip(*rows, strict=True))
    scatter = off.std(axis=0, ddof=1)
    return {
        name: {
            "coverage": float(held[:, k].mean()),
            "bars_over_scatter": float(bars[:, k].mean() / scatter[k]),
            "bias_over_scatter": float(off[:, k].mean() / scatter[k]),
            "scatter": float(scatter[k] / TRUE[name]),
        }
        for k, name in enumerate(TRUE)
    }


@functools.cache
def beam():
    """The one of this process."""
    return Beam()


def fitted(rho, correlation, seed, sign=1):
    """Errors, standard errors and what the intervals hold, of one draw; the fit's iterations and its noise's memory."""
    found = beam().fit(sign * beam().sigma * drawn(rho, beam().clean.shape, seed), correlation)
    off = [found.values[name] - true for name, true in TRUE.items()]
    bars = [found.standard_errors[name] for name in TRUE]
    held = [found.intervals[name][0] <= true <= found.intervals[name][1] for name, true in TRUE.items()]
    return (off, bars, held), found.iterations, list(found.memory[:1])


def main():
    options = arguments(__doc__, spread=True)
    draws = 20 if options.quick else 1000
    figures = {"machine": describe(), "draws": draws, "noise_m": beam().sigma, "rho": RHO}
    table = []
    for kind, rho, correlation in (("white", 0.0, "effective"), ("ar", RHO, "effective"), ("ar", RHO, "ar")):
        found = dict(spread(fitted, [(rho, correlation, seed) for seed in range(draws)], options.processes))
        rows, iterations, memory = zip(*(found[seed] for seed in range(draws)), strict=True)
        for seed, (off, bars, held) in enumerate(rows):
            table.append([kind, correlation, seed, *off, *bars, *map(int, held), *memory[seed]])
        key = f"{kind}_noise_{correlation}"
        figures[key] = {**judged(rows), "median_iterations": float(np.median(iterations))}
        print(key, figures[key], flush=True)
        save("coverage", figures, options.out)
    if options.out:
        with (options.out / "coverage.csv").open("w", newline="") as file:
            words = [f"{name}_{what}" for what in ("error", "bar", "held") for name in TRUE]
            csv.writer(file).writerows([["noise", "bars", "seed", *words, "memory"], *table])
    finish("coverage", figures, options.out)


if __name__ == "__main__":
    main()
