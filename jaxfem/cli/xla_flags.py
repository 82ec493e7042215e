"""Flags of XLA, asked for where this one knows them: it ends the process at others, and versions drop some."""

import mmap
import os
from collections.abc import Iterable, MutableMapping
from pathlib import Path

import jaxlib

OLDER_EMITTER = "--xla_cpu_use_fusion_emitters=false"
"""The older of the two emitters of loops on a CPU: half the memory and half to three quarters of the time to compile,
for steps that take from as long to half longer."""
NO_OPTIMISATION = "--xla_backend_optimization_level=0"
"""Where programs are so small that slow ones do not matter: a quarter of the time to compile, with the former."""


def ask_for(*flags: str, environment: MutableMapping[str, str] = os.environ) -> None:
    """Add to XLA_FLAGS those of the flags that this XLA knows and the user does not name.

    To be called before JAX compiles anything.
    """
    given = environment.get("XLA_FLAGS", "")
    wanted = known(flag for flag in flags if _name(flag) not in given)
    environment["XLA_FLAGS"] = " ".join([given, *wanted]).strip()


def known(flags: Iterable[str], libraries: Path | None = None) -> list[str]:
    """Of `flags`, like "--xla_cpu_use_fusion_emitters=false", those whose names stand in jaxlib's libraries.

    As texts of their own: the names of settings that had a flag once stand there too, in the description of a message.
    """
    wanted = list(flags)
    found: set[str] = set()
    for library in sorted((libraries or Path(jaxlib.__file__).parent).glob("**/*.so*")):
        if not library.stat().st_size:
            continue
        with library.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as text:
            found.update(flag for flag in wanted if flag not in found and text.find(_alone(flag)) >= 0)
    return [flag for flag in wanted if flag in found]


def _name(flag: str) -> str:
    return flag.lstrip("-").split("=")[0]


def _alone(flag: str) -> bytes:
    """Its name as a text of its own in a library."""
    return b"\0" + _name(flag).encode() + b"\0"
