"""Compiled programs kept between runs of the command line: JAX's persistent cache, in the user's cache folder."""

import os
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

import jax

from jaxfem.cli.messages import warning

SWITCH = "JAXFEM_CACHE"  # environment: a folder of one's own, or "off"
FOLDER = "jax_compilation_cache_dir"  # JAX's own setting; JAX_COMPILATION_CACHE_DIR sets it too
OFF = ("off", "0", "no", "false")
LARGEST = 1 << 30  # bytes; a program takes 1 kB to some MB


def keep_programs(wanted: bool = True) -> Path | None:
    """Have JAX keep each program that it compiles, and look there first; returns the folder, None where it is off.

    Off where it is not `wanted` or JAXFEM_CACHE says "off". A cache that the user has set up for JAX itself
    (JAX_COMPILATION_CACHE_DIR) is left as it is. A folder that cannot be written is told once, and done without.
    """
    chosen = os.environ.get(SWITCH, "")
    if not wanted or chosen.lower() in OFF:
        jax.config.update("jax_enable_compilation_cache", False)
        return None
    if getattr(jax.config, FOLDER) is not None:
        return None
    try:
        folder = Path(chosen).expanduser() if chosen else cache_folder(os.environ, sys.platform) / "programs"
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
        trim(folder, LARGEST)
    except (OSError, RuntimeError) as problem:  # RuntimeError: no home folder
        warning(f"compiled programs are not kept: {problem}. Name another folder with {SWITCH}, or {SWITCH}=off")
        return None
    jax.config.update(FOLDER, str(folder))
    # Hundreds of small programs take seconds together: keep them all.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    return folder


def cache_folder(environ: Mapping[str, str], platform: str) -> Path:
    """The folder `jaxfem` where this platform keeps what can be made anew; RuntimeError without a home folder."""
    if platform == "win32":
        return Path(environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local") / "jaxfem" / "Cache"
    if platform == "darwin":
        return Path.home() / "Library" / "Caches" / "jaxfem"
    # A relative XDG_CACHE_HOME is to be ignored, says the XDG base directory specification.
    given = Path(environ.get("XDG_CACHE_HOME", ""))
    return (given if given.is_absolute() else Path.home() / ".cache") / "jaxfem"


def trim(folder: Path, largest: int) -> None:
    """Delete the programs used longest ago until the rest takes at most `largest` bytes.

    JAX's own limit (`jax_compilation_cache_max_size`) needs a further package, and locks the folder at each look.
    """
    kept = []
    for path in folder.glob("*-cache"):
        try:
            found = path.stat()
        except FileNotFoundError:  # another run was faster
            continue
        kept.append((max(found.st_mtime, found.st_atime), found.st_size, path))
    total = sum(size for _, size, _ in kept)
    for _, size, path in sorted(kept, key=lambda each: each[0]):
        if total <= largest:
            return
        path.unlink(missing_ok=True)
        total -= size
