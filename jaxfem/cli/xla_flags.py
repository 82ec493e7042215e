"""Which of some flags this XLA knows: it ends the process at one that it does not, and versions drop some."""

import mmap
from collections.abc import Iterable
from pathlib import Path

import jaxlib


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
            found.update(flag for flag in wanted if flag not in found and text.find(_name(flag)) >= 0)
    return [flag for flag in wanted if flag in found]


def _name(flag: str) -> bytes:
    return b"\0" + flag.lstrip("-").split("=")[0].encode() + b"\0"
