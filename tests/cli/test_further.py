"""What is asked for beyond a fit may fail or be interrupted: the fit stays, and the exit code tells."""

import dataclasses
import signal
import subprocess
import sys
import time

import pytest

from jaxfem.cli import exits, main
from jaxfem.cli.exits import DONE, FAILED, INTERRUPTED
from jaxfem.cli.further import gone_on
from jaxfem.cli.progress import Pace, Progress, Ticker
from jaxfem.fitting import FitError
from jaxfem.io.examples import beam_scene


@dataclasses.dataclass(frozen=True)
class Found:
    """As much of a result as is looked at."""

    words: tuple = ()
    warnings: tuple = ()
    posterior: object = None


def added(word):
    return lambda found, ticker: dataclasses.replace(found, words=(*found.words, word))


def raised(problem):
    def step(found, ticker):
        raise problem

    return step


def test_a_step_that_fails_is_told_and_the_others_go_on(capsys):
    found, code = gone_on(Found(), [("one", added("one")), ("bad", raised(FitError("why"))), ("two", added("two"))])
    assert found.words == ("one", "two") and code == FAILED
    assert found.warnings == ("bad failed: why",)
    assert "jaxfem: error: bad: why; the fit itself is written" in capsys.readouterr().err
    assert gone_on(Found(), [("one", added("one"))]) == (Found(("one",)), DONE)


def test_an_interruption_ends_the_steps_and_keeps_what_there_is(capsys):
    steps = [("one", added("one")), ("long", raised(KeyboardInterrupt())), ("two", added("two"))]
    found, code = gone_on(Found(), steps)
    assert found.words == ("one",) and code == INTERRUPTED and "interrupted" in found.warnings[0]
    assert "without long, two" in capsys.readouterr().err


def test_long_work_is_told_in_a_file_now_and_then(capsys, monkeypatch):
    monkeypatch.setattr(Pace, "due", lambda self: True)
    with Ticker("posterior") as ticker:
        ticker.count("draw", 10, 500)
    with Progress(4) as bar:
        bar.advance(1, "t = 0.1 s")
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["posterior ...", "draw 10 of 500", " 25 %  step 1 of 4  t = 0.1 s "]


def test_an_interrupted_process_leaves_at_once(monkeypatch):
    class Left(BaseException):
        pass

    def leave(code):
        raise Left(code)

    monkeypatch.setattr(exits.os, "_exit", leave)
    monkeypatch.setattr(main, "_run", lambda *given: INTERRUPTED)
    monkeypatch.setattr(main, "one_blas_thread", lambda: None)
    monkeypatch.setattr(main, "keep_programs", lambda wanted: None)
    assert main.main(["new", "scene"]) == INTERRUPTED  # a caller's process goes on
    monkeypatch.setattr(sys, "argv", ["jaxfem", "new", "scene"])
    with pytest.raises(Left, match="130"):
        main.main()


@pytest.mark.slow
def test_compiling_can_be_interrupted(tmp_path):
    """What is half made cannot be freed: the usual way out of Python is a segmentation fault."""
    (tmp_path / "beam.toml").write_text(beam_scene(2e5, damping=3e-3, cells=(4, 2, 2), tets_per_cell=6, steps=400))
    words = [sys.executable, "-m", "jaxfem.cli.main", "--no-cache", "simulate", "beam.toml", "--no-plots"]
    run = subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    time.sleep(6.0)
    run.send_signal(signal.SIGINT)
    told = run.communicate(timeout=120)[1]
    assert run.returncode in (DONE, INTERRUPTED) and "Segmentation" not in told
