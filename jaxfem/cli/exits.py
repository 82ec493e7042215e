"""How a command ends: its exit codes, and the way out of a process that was interrupted."""

import contextlib
import os
import sys
from typing import NoReturn

DONE, MISTAKE, FAILED, INTERRUPTED = 0, 2, 3, 130


def leave_at_once(code: int) -> NoReturn:
    """End the process as it is, without taking apart what is in it.

    An interruption amid tracing or compiling leaves objects of JAX half made; Python, which frees them on its usual way
    out, then ends by a segmentation fault, and with its exit code.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # closed, or nobody reads it any more
            stream.flush()
    os._exit(code)
