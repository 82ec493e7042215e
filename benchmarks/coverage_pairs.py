"""Bars and bias where noise remembers, by pairs.  python benchmarks/coverage_pairs.py [--quick] [--out FOLDER]

The beam of `coverage.py` with its noise of autocorrelation .9, each draw taken with both signs: what is odd in the
noise cancels in a pair's mean error, so that a bias, which is even, shows in a few pairs where hundreds of single draws
leave it in their scatter (Hammersley & Morton 1956). "ar": residuals whitened, generalised least squares; "effective":
least squares. Of all draws the share of 95 % intervals that hold the truth, the bars' mean over the scatter, and the
bias with its own standard error, over the scatter. Figures are saved as they come.
"""

import jax
import numpy as np
from coverage import RHO, TRUE, Beam, drawn, judged
from machine import describe
from report import arguments, finish, save

jax.config.update("jax_enable_x64", True)

PAIRS = {"ar": 60, "effective": 20}


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
    options = arguments(__doc__)
    beam, figures = Beam(), {"machine": describe(), "rho": RHO}
    figures["noise_m"] = beam.sigma
    for correlation, pairs in PAIRS.items():
        rows, memory = [], []
        for seed in range(3 if options.quick else pairs):
            noise = beam.sigma * drawn(RHO, beam.clean.shape, seed)
            for sign in (1, -1):
                found = beam.fit(sign * noise, correlation)
                off = [found.values[name] - true for name, true in TRUE.items()]
                bars = [found.standard_errors[name] for name in TRUE]
                held = [found.intervals[name][0] <= true <= found.intervals[name][1] for name, true in TRUE.items()]
                rows.append((off, bars, held))
                memory.append(found.memory[0] if found.memory else 0.0)
            figures[correlation] = {
                "draws": len(rows),
                **judged(rows),
                "pairs": even(rows),
                "median_memory": float(np.median(memory)),
            }
            save("coverage_pairs", figures, options.out)
    finish("coverage_pairs", figures, options.out)


if __name__ == "__main__":
    main()
