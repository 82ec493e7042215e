"""What is shipped: the source archive holds the examples, and its version is the package's own."""

import pathlib
import shutil
import subprocess
import sys
import tarfile

import pytest

import jaxfem as jf
from jaxfem.cli.main import main

CHECKOUT = pathlib.Path(jf.__file__).parents[1]
SHIPPED = ("examples/real_beam.toml", "jaxfem/py.typed", "docs/architecture.md", "tests/golden.json", "LICENSE")


def test_the_command_says_the_version(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert stop.value.code == 0 and capsys.readouterr().out == f"jaxfem {jf.__version__}\n"


def test_the_source_archive_is_complete(tmp_path):
    pytest.importorskip("setuptools", reason="the archive is made by setuptools")
    if not (CHECKOUT / "pyproject.toml").is_file():
        pytest.skip("the package is installed, not a checkout")
    copy = tmp_path / "copy"
    hidden = shutil.ignore_patterns(".*", "*.egg-info", "__pycache__", "build", "dist", "venv", "shared")
    shutil.copytree(CHECKOUT, copy, ignore=hidden)
    make = "from setuptools import build_meta; print(build_meta.build_sdist('.'))"
    done = subprocess.run([sys.executable, "-c", make], cwd=copy, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    name = f"jaxfem-{jf.__version__}"
    with tarfile.open(copy / f"{name}.tar.gz") as archive:
        held = set(archive.getnames())
    assert {f"{name}/{each}" for each in SHIPPED} <= held
    modules = {path.relative_to(CHECKOUT) for path in (CHECKOUT / "jaxfem").rglob("*.py")}
    assert {f"{name}/{each.as_posix()}" for each in modules} <= held
