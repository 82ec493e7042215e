"""Importing the package and its command line is light: what only some programs need is imported by these alone."""

import subprocess
import sys

HEAVY = {"scipy", "meshio", "optax", "matplotlib", "tqdm"}


def test_nothing_heavy_is_imported_beyond_what_jax_brings():
    code = (
        "import sys, jax, jax.numpy; before = set(sys.modules); import jaxfem, jaxfem.cli.main; "
        f"print(*{HEAVY} & (set(sys.modules) - before))"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.split() == []
