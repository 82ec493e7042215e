"""Bars and bias where noise remembers, by pairs.  python benchmarks/coverage_pairs.py [--quick] [--out FOLDER]

The beam of `coverage.py` with its noise of autocorrelation .9, each draw taken with both signs: what is odd in the
noise cancels in a pair's mean error, so that a bias, which is even, shows in a few pairs where hundreds of single draws
leave it in their scatter (Hammersley & Morton 1956). "ar": residuals whitened, generalised least squares; "effective":
least squares. Of all draws the share of 95 % intervals that hold the truth, the bars' mean over the scatter, and the
bias with its own standard error, over the scatter. Figures are saved as they come.
"""

import jax
import numpy as np
from coverage import RHO, TRUE, beam, fitted, judged
from machine import describe
from report import arguments, finish, save
from spread import spread

jax.config.update("jax_enable_x64", True)

PAIRS = {"ar": 60, "effective": 60}


def even(rows):
    """Bias of each constant and its standard error, over the scatter, from errors of draws in pairs (+, -)."""
    off = np.array([each[0] for each in rows])
    scatter = off.std(axis=0, ddof=1)
    means = (off[::2] + off[1::2]) / 2
    error = means.std(axis=0, ddof=1) / np.sqrt(len(means)) if len(means) > 1 else np.full(len(TRUE), np.nan)
    return {
        name: {
            "bias_over_scatter": float(means[:, k].mean() / scatter[k]),
            "its_standard_error": float(error[k] / scatter[k]),
        }
        for k, name in enumerate(TRUE)
    }


def main():
    options = arguments(__doc__, spread=True)
    figures = {"machine": describe(), "rho": RHO, "noise_m": beam().sigma}
    for correlation, pairs in PAIRS.items():
        seeds = range(3 if options.quick else pairs)
        jobs = [(RHO, correlation, seed, sign) for seed in seeds for sign in (1, -1)]
        found, ended = {}, 0
        for number, told in spread(fitted, jobs, options.processes):
            found[number] = told
            while {2 * ended, 2 * ended + 1} <= found.keys():
                ended += 1
                figures[correlation] = told_of([found[each] for each in range(2 * ended)])
                save("coverage_pairs", figures, options.out)
    finish("coverage_pairs", figures, options.out)


def told_of(found):
    """Figures of all draws so far, in pairs."""
    rows, _, memory = zip(*found, strict=True)
    known = [each[0] if each else 0.0 for each in memory]
    return {"draws": len(rows), **judged(rows), "pairs": even(rows), "median_memory": float(np.median(known))}


if __name__ == "__main__":
    main()
