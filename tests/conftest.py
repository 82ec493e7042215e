"""Settings of the test process: double precision (the package never sets it), shapes checked, outside data located."""

import importlib.util
import os
import pathlib

os.environ.setdefault("MPLBACKEND", "Agg")

import jax
import pytest

jax.config.update("jax_enable_x64", True)

if all(importlib.util.find_spec(name) for name in ("jaxtyping", "beartype")):  # of the extra `test`
    import contracts

    contracts.install()

SHARED = pathlib.Path(__file__).resolve().parents[1].parent / "shared"


def _folder(name: str) -> pathlib.Path:
    folder = SHARED / name
    if not folder.is_dir():
        pytest.skip(f"the folder of outside values {name!r} is not beside this checkout")
    return folder


@pytest.fixture(scope="session")
def reference() -> pathlib.Path:
    """Folder of reference values computed with other libraries; the test is skipped where it is absent."""
    return _folder("reference")


@pytest.fixture(scope="session")
def data() -> pathlib.Path:
    """Folder of measured data and meshes; the test is skipped where it is absent."""
    return _folder("data")


@pytest.fixture(autouse=True, scope="module")
def _forget_programs():
    """Compiled programs pile up to gigabytes a worker; few are shared between test files."""
    yield
    jax.clear_caches()
