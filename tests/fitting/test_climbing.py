"""Least squares from one point: where it ends, and how many simulations it asks for on the way."""

import itertools
import types

import numpy as np
import pytest
from scipy.optimize import least_squares

from jaxfem.fitting.climbing import levenberg_marquardt

TIMES = np.linspace(0, 3, 40)


class Bowl:
    """An evaluator of residuals (T,) that are a plain function of z (P,), with a diary of what was asked."""

    def __init__(self, function, count):
        self.function, self.samples, self.whole = function, 1, False
        self.near = self.last = self.priors = None
        constant = types.SimpleNamespace(transform=types.SimpleNamespace(longest=1.0))
        box = np.full(count, -9.0), np.full(count, 9.0)
        self.unknowns = types.SimpleNamespace(box=box, constants=[constant] * count)
        self.asked = []

    def loss(self, r):
        return float(np.sum(np.concatenate(r) ** 2)) if isinstance(r, list) else float(np.sum(r**2))

    def residual(self, z):
        self.asked.append((z.copy(), False))
        return [self.function(z)], []

    def linear(self, z):
        self.asked.append((z.copy(), True))
        columns = [(self.function(z + h) - self.function(z - h)) / 2e-6 for h in 1e-6 * np.eye(z.size)]
        return [self.function(z)], [np.array(columns)], []

    @property
    def derivatives(self):
        return sum(made for _, made in self.asked)


def _ringing(truth, misfit):
    """Residuals of a damped oscillation: log frequency, log damping, log amplitude; a drift that no value makes."""

    def motion(z):
        return np.exp(z[2] - np.exp(z[1]) * TIMES) * np.cos(np.exp(z[0]) * TIMES)

    return lambda z: motion(z) - motion(np.array(truth)) - misfit * TIMES**2


@pytest.mark.parametrize(("misfit", "simulations", "derivatives"), [(0.0, 18, 5), (0.02, 16, 9), (0.06, 22, 12)])
def test_it_ends_where_scipy_does_and_in_as_many_simulations_as_ever(misfit, simulations, derivatives):
    """The larger what the model leaves out, the less do corrected derivatives know of the last of the way. (Before they
    were given up near the end: 33 and 39 simulations of the last two.)"""
    residual = _ringing([1.0, -1.0, 0.3], misfit)
    bowl = Bowl(residual, 3)
    end, loss = levenberg_marquardt(bowl, np.array([1.2, -0.4, 0.0]), 40, tol=1e-10)
    best = least_squares(residual, np.array([1.2, -0.4, 0.0]), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert np.allclose(end, best.x, atol=1e-4) and loss <= 2 * best.cost * (1 + 1e-8) + 1e-12
    assert (len(bowl.asked), bowl.derivatives) == (simulations, derivatives)


def test_a_step_that_leads_up_is_followed_by_one_of_half_its_length_at_most():
    """However small the damping has become on the way: tenfold from there on would try the same step many times."""
    bowl = Bowl(lambda z: np.arctan(8 * z), 1)  # flat far out: Gauss-Newton's step goes to the other side, and farther
    start = np.array([0.25])
    levenberg_marquardt(bowl, start, 1)
    tried = [abs(z - start)[0] for z, made in bowl.asked if not made]
    assert len(tried) >= 2 and all(after <= 0.5 * before for before, after in itertools.pairwise(tried))


def test_no_point_is_simulated_twice_near_the_end():
    bowl = Bowl(_ringing([1.0, -1.0, 0.3], 0.06), 3)
    levenberg_marquardt(bowl, np.array([1.05, -0.9, 0.3]), 40, tol=1e-10)
    last = [z for z, _ in bowl.asked[-3:]]
    assert len({z.tobytes() for z in last}) == 3
