"""The tests' own care for compiled programs: a worker knows what it holds, and what it may."""

import os
import subprocess
import sys

import programs

from jaxfem.cli.threads import one_blas_thread
from jaxfem.cli.xla_flags import NO_OPTIMISATION, OLDER_EMITTER, ask_for, known


def test_memory_is_counted_in_bytes_and_shared_between_workers(monkeypatch):
    assert 5e7 < programs.memory() < 1e11
    monkeypatch.setenv("PYTEST_XDIST_WORKER_COUNT", "1000000")
    assert programs.most_memory() < 1e6


def test_programs_are_compiled_quickly_unless_the_environment_says_how():
    environment = {"XLA_FLAGS": "--xla_backend_optimization_level=3"}
    programs.compile_quickly(environment)
    level, *others = environment["XLA_FLAGS"].split()
    assert level == "--xla_backend_optimization_level=3"
    wanted = ["--xla_cpu_use_fusion_emitters=false", "--xla_cpu_parallel_codegen_split_count=1"]
    assert others == known(wanted) and others  # versions drop some
    assert environment["OPENBLAS_NUM_THREADS"] == "1"
    given = {"OPENBLAS_NUM_THREADS": "4"}
    one_blas_thread(given)
    assert given == {"OPENBLAS_NUM_THREADS": "4"}  # who says how many gets them


def test_what_the_user_says_of_a_flag_stays():
    given = {"XLA_FLAGS": "--xla_cpu_use_fusion_emitters=true"}
    ask_for(OLDER_EMITTER, environment=given)
    assert given == {"XLA_FLAGS": "--xla_cpu_use_fusion_emitters=true"}
    empty: dict[str, str] = {}
    ask_for(NO_OPTIMISATION, environment=empty)
    assert empty == {"XLA_FLAGS": NO_OPTIMISATION}


def test_flags_that_this_version_does_not_know_are_left_out(tmp_path):
    """It would end the process at one."""
    assert known(["--xla_backend_optimization_level=0", "--xla_no_such_flag=1"]) == [
        "--xla_backend_optimization_level=0"
    ]
    (tmp_path / "some.so").write_bytes(b"\0xla_one\0\x07xla_two\x18")
    (tmp_path / "empty.so").write_bytes(b"")
    assert known(["--xla_one=true", "--xla_two"], tmp_path) == ["--xla_one=true"]


def test_the_command_line_asks_for_one_thread_before_the_library_is_loaded():
    """SciPy's library reads the environment as it is loaded: nothing that the commands import may load it before."""
    code = "from jaxfem.cli import main, threads; import os; assert threads.one_blas_thread(os.environ)"
    subprocess.run([sys.executable, "-c", code], check=True, env={**os.environ, "OPENBLAS_NUM_THREADS": ""})
