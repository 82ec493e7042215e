"""The tests' own care for compiled programs: a worker knows what it holds, and what it may."""

import programs


def test_memory_is_counted_in_bytes_and_shared_between_workers(monkeypatch):
    assert 5e7 < programs.memory() < 1e11
    monkeypatch.setenv("PYTEST_XDIST_WORKER_COUNT", "1000000")
    assert programs.most_memory() < 1e6
