"""Meshers in a process of their own, with a time limit: a crash, or a mesh that takes for ever, is that process's."""

import subprocess
import sys
from pathlib import Path
from typing import Any

from .checks import MeshError


def run_apart(program: str, words: list[Any], made: Path, seconds: float, doing: str) -> str | None:
    """Run Python's `program` with `words` in the folder of `made`, the file that it writes, which goes with it.

    Returns None where that is there, else the last line that it said. MeshError after `seconds`; `doing`: what it did.
    """
    call = [sys.executable, "-c", program, *map(str, words)]
    try:  # in that folder, since meshers leave files of their own where they run
        ran = subprocess.run(call, capture_output=True, text=True, timeout=seconds, cwd=made.parent)
    except subprocess.TimeoutExpired:
        raise MeshError(f"{doing} took longer than {seconds:g} s: give a larger size, or more seconds") from None
    if ran.returncode == 0 and made.is_file():
        return None
    return (ran.stderr.strip().splitlines() or [f"it ended with code {ran.returncode}"])[-1]
