"""Settings of the test process: double precision (the package never sets it), shapes checked, compiled programs kept,
outside data located."""

import gc
import importlib.util
import os
import pathlib

os.environ.setdefault("MPLBACKEND", "Agg")

import jax
import long
import programs
import pytest

programs.compile_quickly()  # XLA reads its flags when the first program is compiled
jax.config.update("jax_enable_x64", True)

if all(importlib.util.find_spec(name) for name in ("jaxtyping", "beartype")):  # of the extra `test`
    import contracts

    contracts.install()

SHARED = pathlib.Path(__file__).resolve().parents[1].parent / "shared"


def pytest_configure(config):
    """Before any program is compiled, in the first process and in each worker."""
    cache = getattr(config, "cache", None)  # absent where pytest runs without its cache
    programs.keep(pathlib.Path(cache.mkdir("jax")) if cache else None, first=not hasattr(config, "workerinput"))
    # Tracing makes millions of objects that live on: looking through them for rubbish took a sixteenth of all time.
    gc.freeze()
    gc.set_threshold(100_000, 20, 50)


def pytest_addoption(parser):
    """Those that take longest are run where they are asked for."""
    parser.addoption("--exhaustive", action="store_true", help="the tests that take longest, too (see tests/long.py)")


def pytest_collection_modifyitems(config, items):
    """Those that were measured to take long are slow, too; the longest wait until they are asked for, alone or all."""
    seconds = long.listed()
    for item in items:
        if item.nodeid in seconds:
            item.add_marker(pytest.mark.slow)
    alone = any("::" in str(argument) for argument in config.args)
    if not (alone or config.getoption("exhaustive")):
        names = long.longest(item.nodeid for item in items)
        config.hook.pytest_deselected(items=[item for item in items if item.nodeid in names])
        items[:] = [item for item in items if item.nodeid not in names]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """`-n` alone steals work: a file's tests stay together, which share programs, until a worker has nothing left."""
    from xdist.scheduler.worksteal import WorkStealingScheduling

    if config.getvalue("dist") == "load":
        return WorkStealingScheduling(config, log)


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
    """Compiled programs pile up to gigabytes a worker: those in memory go once they take more than a worker's share."""
    yield
    if programs.memory() > programs.most_memory():
        programs.forget()
