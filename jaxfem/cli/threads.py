"""Threads of the linear algebra beneath: one, for matrices as small as a step's.

JAX factorises small dense matrices by SciPy's OpenBLAS, which hands even 33 x 33 ones to a thread a core and has them
wait for each other by spinning: on a busy machine that took 15 ms where one thread takes .04. Preconditioners have an
inverse of their own (`solvers/dense.py`); the direct route, groups and modes do not.
"""

import os
import sys
from collections.abc import MutableMapping

SWITCH = "OPENBLAS_NUM_THREADS"  # read when the library is loaded


def one_blas_thread(environment: MutableMapping[str, str] = os.environ) -> bool:
    """Have OpenBLAS take one thread, unless the user says how many; whether that comes in time."""
    environment.setdefault(SWITCH, "1")
    return "scipy.linalg" not in sys.modules
