"""Users' programs are checked by mypy against the package's own annotations."""

import os
import pathlib
import subprocess
import sys

import pytest

import jaxfem as jf

PACKAGE = pathlib.Path(jf.__file__).parent
PROGRAM = pathlib.Path(__file__).with_name("program.py")


def errors(program: pathlib.Path) -> dict[int, str]:
    """What `mypy --strict` finds in a program that uses the package imported here: line -> message."""
    pytest.importorskip("mypy", reason="types are checked by mypy: install the extra `dev`")
    checkout = PROGRAM.parents[2]  # whose settings and cache of JAX's types serve here too
    environment = {**os.environ, "MYPYPATH": str(PACKAGE.parent)}
    command = [sys.executable, "-m", "mypy", "--strict", str(program)]
    done = subprocess.run(command, cwd=checkout, env=environment, capture_output=True, text=True)
    assert done.returncode in (0, 1), done.stdout + done.stderr
    found = {}
    for line in done.stdout.splitlines():
        file, *rest = line.split(":", 3)
        if pathlib.Path(file).name == program.name and rest[1] == " error":
            found[int(rest[0])] = rest[2]
    return found


def test_a_users_program_has_types():
    assert errors(PROGRAM) == {}


def test_every_mistake_in_it_is_found(tmp_path):
    """Its ignored lines, without the comments, are errors, and no others are."""
    lines = PROGRAM.read_text().splitlines()
    bare = tmp_path / "bare.py"
    bare.write_text("\n".join(line.split("  # type: ignore")[0] for line in lines) + "\n")
    wanted = {number for number, line in enumerate(lines, 1) if "# type: ignore[" in line}
    assert len(wanted) == 8
    assert set(errors(bare)) == wanted


def test_the_package_says_that_it_is_typed():
    assert (PACKAGE / "py.typed").is_file()
