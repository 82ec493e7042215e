"""The tests' own care for compiled programs: a worker knows what it holds, and what it may."""

import programs


def test_memory_is_counted_in_bytes_and_shared_between_workers(monkeypatch):
    assert 5e7 < programs.memory() < 1e11
    monkeypatch.setenv("PYTEST_XDIST_WORKER_COUNT", "1000000")
    assert programs.most_memory() < 1e6


def test_programs_are_compiled_quickly_unless_the_environment_says_how():
    environment = {"XLA_FLAGS": "--xla_backend_optimization_level=3"}
    programs.compile_quickly(environment)
    assert environment["XLA_FLAGS"] == "--xla_backend_optimization_level=3 --xla_cpu_use_fusion_emitters=false"
