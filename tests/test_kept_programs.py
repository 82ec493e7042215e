"""The tests' own care for compiled programs: old ones go, and a worker knows what it holds."""

import os
import time

import programs


def test_old_programs_go_and_others_stay(tmp_path):
    names = ["jit_old-0-cache", "jit_new-1-cache", "notes.txt"]
    for name in names:
        (tmp_path / name).touch()
    long_ago = time.time() - 86400 * (programs.DAYS + 1)
    for name in ("jit_old-0-cache", "notes.txt"):
        os.utime(tmp_path / name, (long_ago, long_ago))
    programs.clear_out(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == names[1:]


def test_memory_is_counted_in_bytes_and_shared_between_workers(monkeypatch):
    assert 5e7 < programs.memory() < 1e11
    monkeypatch.setenv("PYTEST_XDIST_WORKER_COUNT", "1000000")
    assert programs.most_memory() < 1e6
