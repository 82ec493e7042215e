"""What a solver says about its answer: a status that survives jit, and a message that names a remedy.

A status inside compiled code is one integer. Its lowest byte is a `Status`; where a step has a cause to name, the rest
is a number that stands for a sentence about it (see `caused`). `Status(code)` is the status of either.
"""

import enum
import zlib
from typing import Any

import numpy as np
from jax import Array

from jaxfem.answers import described
from jaxfem.pytrees import Pytree


class Status(enum.IntEnum):
    """Outcome of a solve, an integer inside compiled code. Zero is success; see `describe` for the remedies.

    `Status(code)` takes codes that name a cause too; any that is no status is UNKNOWN.
    """

    CONVERGED = 0
    ITERATION_LIMIT = 1
    NOT_FINITE = 2
    NOT_POSITIVE_DEFINITE = 3
    INFEASIBLE_BOUNDS = 4
    NO_DESCENT = 5
    INNER_SOLVE_FAILED = 6
    INVALID_VALUE = 7
    CONTRADICTORY_JOINTS = 8
    OPEN_JOINTS = 9
    TURNED_TOO_FAR = 10
    GAVE_WAY = 11
    UNRESOLVED = 12
    UNRESOLVED_SPIN = 13
    UNKNOWN = 255

    @classmethod
    def _missing_(cls, value: object) -> "Status | None":
        if not isinstance(value, int):
            return None
        return cls(value % BYTE) if value >= BYTE else cls.UNKNOWN


BYTE = 256
_MOST_CAUSES = 2**22  # codes stay within 32 bits
_CAUSES: dict[int, str] = {}


_MESSAGES = {
    Status.CONVERGED: "converged",
    Status.ITERATION_LIMIT: (
        "stopped at the iteration limit before reaching the tolerance: raise max_iterations, loosen tol (single "
        "precision cannot go far below 1e-6), or give a better preconditioner or start"
    ),
    Status.NOT_FINITE: (
        "met a value that is not finite: look for NaN or infinity in the operator, the right-hand side and the start, "
        "or take a smaller time step"
    ),
    Status.NOT_POSITIVE_DEFINITE: (
        "met a direction of no or negative curvature: the operator or the preconditioner is not symmetric positive "
        "definite; check its symmetry, add a small positive diagonal, or compute in double precision"
    ),
    Status.INFEASIBLE_BOUNDS: "no point satisfies the bounds (lower > upper somewhere, or a NaN): correct the bounds",
    Status.NO_DESCENT: (
        "no step along the search direction reduced the residual: take a smaller time step, start closer to the "
        "solution, or loosen tol if the residual is already at rounding level"
    ),
    Status.INNER_SOLVE_FAILED: (
        "a linear solve inside an iteration failed: raise its iteration limit, use a stronger preconditioner, or take "
        "a smaller time step"
    ),
    Status.INVALID_VALUE: "was given a value that cannot be",
    Status.CONTRADICTORY_JOINTS: "contradictory joints",
    Status.OPEN_JOINTS: "left joints open",
    Status.TURNED_TOO_FAR: "turned too far for a step of straight lines",
    Status.GAVE_WAY: "gave way under a load",
    Status.UNRESOLVED: "did not resolve elastic strains",
    Status.UNRESOLVED_SPIN: "did not resolve a spin",
    Status.UNKNOWN: "gave a status that is none of jaxfem.solvers.Status",
}


class SolveInfo(Pytree):
    """How a solve ended; every solver returns one. Under vmap each field has the lanes' leading axis.

    status: integer, a `Status`.  iterations: loop trips, each one product with the operator.
    residual: norm relative to the right-hand side's (the solver's docstring says which norm).
    weakly_active: number of rows at a bound with (numerically) no force against it; there the derivative is one-sided.
    """

    status: Array
    iterations: Array
    residual: Array
    weakly_active: Array


def caused(status: Status, cause: str) -> int:
    """The code of a status with a sentence on what caused it, which `describe` then tells; the same in each process."""
    number = zlib.crc32(cause.encode()) % _MOST_CAUSES + 1
    while _CAUSES.setdefault(number, cause) != cause:  # two sentences of one number: the next one that is free
        number += 1
    return int(status) + BYTE * number


def describe(status: Any) -> str:
    """Readable text of a status, on the host. status: an integer, a `SolveInfo`'s `status`, or an array of lanes'.

    Also of integers that are no status; TypeError for what is no number.
    """
    codes = np.atleast_1d(np.asarray(status)).ravel()
    if codes.dtype.kind not in "biuf":
        raise TypeError(f"describe got {described(status)}; give a status, an integer, or an array of them")
    if codes.size == 1:
        return _message(int(codes[0]))
    kinds, counts = np.unique(codes, return_counts=True)
    return "; ".join(f"{n} of {codes.size}: {_message(int(k))}" for k, n in zip(kinds, counts, strict=True))


def _message(code: int) -> str:
    status = Status(code)
    cause = _CAUSES.get(code // BYTE)
    if status is Status.UNKNOWN:
        cause = f"{code}; let the method or solver give one of those"
    return _MESSAGES[status] + (f": {cause}" if cause else "")
