"""Box-constrained quadratic programs that every solver of such problems is run on, and the proof of a solution."""

from typing import NamedTuple

import numpy as np


class BoxProblem(NamedTuple):
    """min 1/2 x'Ax - b'x over lower <= x <= upper."""

    A: np.ndarray
    b: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


def spd(n, condition, rng):
    """Dense SPD matrix of the given condition number: two reflections mix the eigenvectors."""
    A = np.diag(np.geomspace(1.0, condition, n))
    for _ in range(2):
        v = rng.standard_normal(n)
        v /= np.linalg.norm(v)
        A = A - 2 * np.outer(v, v @ A)
        A = A - 2 * np.outer(A @ v, v)
    return 0.5 * (A + A.T)


def random_box(n, condition, seed):
    """About a third of the entries at a bound; some sides infinite, some entries fixed by equal bounds."""
    rng = np.random.default_rng(seed)
    A = spd(n, condition, rng)
    lower, upper = rng.uniform(-0.9, -0.1, n), rng.uniform(0.1, 0.9, n)
    lower[::7], upper[3::7] = -np.inf, np.inf
    upper[5::11] = lower[5::11] = 0.25
    return BoxProblem(A, A @ rng.uniform(-1, 1, n), lower, upper)


def one_sided(n, condition, seed):
    """A contact problem: x >= 0 only."""
    rng = np.random.default_rng(seed)
    A = spd(n, condition, rng)
    return BoxProblem(A, A @ rng.standard_normal(n), np.zeros(n), np.full(n, np.inf))


def badly_scaled(n, seed):
    """Six orders of magnitude between the units of the unknowns."""
    problem = random_box(n, 100.0, seed)
    units = 10.0 ** np.random.default_rng(seed).uniform(-3, 3, n)
    return BoxProblem(
        units[:, None] * problem.A * units, units * problem.b, problem.lower / units, problem.upper / units
    )


def obstacle(side):
    """A membrane pressed onto a bump: the five-point Laplacian, whose active set travels far from the start."""
    T = 2 * np.eye(side) - np.eye(side, k=1) - np.eye(side, k=-1)
    A = np.kron(T, np.eye(side)) + np.kron(np.eye(side), T)
    s = np.linspace(0, 1, side)
    bump = (-0.05 - 0.05 * np.sin(8 * s)[:, None] * np.cos(6 * s)).ravel()
    return BoxProblem(A, np.full(side**2, -3.0 / side**2), bump, np.full(side**2, np.inf))


def stack(n):
    """A column of blocks resting on one another: long chains of contact forces."""
    A = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    A[0, 0] = 1.0
    b = 0.01 * np.random.default_rng(5).standard_normal(n)
    b[[0, -1]] += 1.0
    return BoxProblem(A + 1e-4 * np.eye(n), b, np.zeros(n), np.full(n, np.inf))


TABLE = {
    "box": random_box(60, 1e3, 0),
    "one-sided": one_sided(60, 1e3, 1),
    "badly scaled": badly_scaled(60, 2),
    "obstacle": obstacle(12),
    "stack": stack(40),
}


def from_file(path):
    """A reference problem with its solution: BoxProblem and the file's contents."""
    file = dict(np.load(path))
    n = int(file["n"])
    A = np.zeros((n, n))
    A[file["ai"], file["aj"]] = file["av"]
    return BoxProblem(A + np.triu(A, 1).T, file["b"], file["l"], file["h"]), file


def kkt_residual(problem, x):
    """Norm of the Jacobi-scaled projected gradient relative to b's, in double precision; infinite outside the box."""
    A, b, lower, upper = (np.asarray(v, np.float64) for v in problem)
    x = np.asarray(x, np.float64)
    if not np.all((lower <= x) & (x <= upper)):
        return np.inf
    g = A @ x - b
    g = np.where(x <= lower, np.minimum(g, 0), np.where(x >= upper, np.maximum(g, 0), g))
    scale = np.diag(A) ** -0.5
    return np.linalg.norm(scale * np.where(lower == upper, 0, g)) / np.linalg.norm(scale * b)
