"""Projected Gauss-Seidel on the table of box problems, and its statuses."""

import box_problems
import numpy as np
import pytest

from jaxfem.solvers import Status, mprgp, pgs


@pytest.mark.parametrize("dtype, tol", [(np.float32, 1e-4), (np.float64, 1e-9)])
@pytest.mark.parametrize("name", box_problems.TABLE)
def test_table(name, dtype, tol):
    problem = box_problems.BoxProblem(*(v.astype(dtype) for v in box_problems.TABLE[name]))
    x, info = pgs(*problem, tol=tol, max_iterations=200_000)
    assert info.status == Status.CONVERGED and x.dtype == dtype
    assert box_problems.kkt_residual(problem, x) <= 2 * tol
    if dtype is np.float64:
        np.testing.assert_allclose(x, mprgp(*problem, tol=1e-10)[0], atol=1e-5 * np.abs(x).max())


def test_statuses():
    A, b, lower, upper = box_problems.TABLE["box"]
    assert pgs(A, b, lower, upper, max_iterations=2)[1].status == Status.ITERATION_LIMIT
    assert pgs(A, b, upper, lower)[1].status == Status.INFEASIBLE_BOUNDS
    assert pgs(A, np.nan * b, lower, upper)[1].status == Status.NOT_FINITE
    assert pgs(-A, b, lower, upper)[1].status == Status.NOT_POSITIVE_DEFINITE
    with pytest.raises(ValueError, match="it must be"):
        pgs(A[:3], b)
