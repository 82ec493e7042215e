"""`jaxfem simulate` takes frames by one program, as many a call as time allows."""

import jax
import numpy as np
import pytest
from test_simulate import rows, scene, simulated

import jaxfem as jf
from jaxfem.cli import running
from jaxfem.io import export, load_scene, read_frames
from jaxfem.io.checkpoints import listed_frames
from jaxfem.io.tracked import Tracked
from jaxfem.stepping import frames as stepping_frames

__all__ = ["scene"]  # a fixture


@pytest.mark.parametrize("scheme", ["backward_euler", "generalized_alpha"])
def test_one_program_takes_chunks_of_any_length(scene, tmp_path, monkeypatch, scheme):
    """The frames are those of a rollout, chunks grow as time allows, and the last frame may be of fewer steps."""
    path, calls, take = scene(every=2), [], running.frames
    path.write_text(path.read_text().replace("[time]", f'[time]\nscheme = "{scheme}"'))
    monkeypatch.setattr(running, "frames", lambda *args, **most: calls.append(args[4:]) or take(*args, **most))
    monkeypatch.setattr(running, "PACE", 1e6)
    compiled = stepping_frames._frames._cache_size()
    assert simulated(path, "--steps", "21", "--no-plots") == 0
    assert calls == [(1, 2), (1, 2), (4, 2), (4, 2), (1, 1)]
    assert stepping_frames._frames._cache_size() == compiled + 1
    states, _ = jf.rollout(*load_scene(path).build(), 0.01, 21)
    frames = read_frames(tmp_path / "out" / "run.pvd")
    assert [round(frame.time / 0.01) for frame in frames] == [*range(0, 21, 2), 21]
    for frame in frames[1:]:
        np.testing.assert_allclose(frame.positions, states.positions[round(frame.time / 0.01) - 1], atol=1e-8)
    # The tables, and the plots drawn from them, have every step.
    energy, point = (np.array(rows(tmp_path / "out" / name)[1:], float) for name in ("energies.csv", "points.csv"))
    np.testing.assert_allclose(energy[:, 0], 0.01 * np.arange(22), atol=1e-9)
    model, params, _ = load_scene(path).build()
    ways = [Tracked(model, load_scene(path).points).at(np.asarray(places)) for places in states.positions]
    np.testing.assert_allclose(point[1:, 1:4], np.array(ways)[:, 0], atol=1e-8)
    there = jax.tree.map(lambda leaf: leaf[4], states)
    np.testing.assert_allclose(energy[5, 1:4], list(jf.energies(model, params, there).kinds.values())[:3], rtol=1e-6)


def test_frames_before_a_failed_one_are_written(scene, tmp_path, monkeypatch, capsys):
    """In the middle of a chunk."""
    take, calls = running.frames, []

    def spoiled(*args, **most):
        states, infos, seen = take(*args, **most)
        calls.append(args[4])
        return states, infos.replace(status=infos.status.at[2].set(1)) if args[4] > 2 else infos, seen

    monkeypatch.setattr(running, "frames", spoiled)
    monkeypatch.setattr(running, "PACE", 1e6)
    assert simulated(scene(), "--no-plots") == 3
    assert calls == [1, 1, 4] and "step 5 of 6 (t = 0.05 s) failed" in capsys.readouterr().err
    assert len(read_frames(tmp_path / "out" / "run.pvd")) == 5


def test_a_checkpoint_knows_no_frame_that_the_index_does_not_list(scene, tmp_path, monkeypatch):
    """Long runs list frames less often: what a kill leaves can be gone on with at any moment."""
    monkeypatch.setattr(export, "SHORT", 2)
    save, kept = running.save_checkpoint, []

    def checked(path, state, done, dt, frames, mark):
        kept.append((len(listed_frames(tmp_path / "out" / "run.pvd")), frames))
        save(path, state, done, dt, frames, mark)

    monkeypatch.setattr(running, "save_checkpoint", checked)
    assert simulated(scene(), "--steps", "8", "--no-plots") == 0
    assert all(listed == frames for listed, frames in kept) and kept[-1] == (9, 9) and len(kept) < 9


def test_a_frame_that_takes_long_is_taken_in_parts(scene, tmp_path, monkeypatch):
    """So that an interruption is heard, and a call's arrays stay small: frames and tables are the same."""
    calls, take = [], running.frames
    path = scene(every=5)
    assert simulated(path, "--no-plots", "--out", str(tmp_path / "whole")) == 0
    monkeypatch.setattr(running, "frames", lambda *args, **most: calls.append(args[4:]) or take(*args, **most))
    monkeypatch.setattr(running, "PACE", 0)
    monkeypatch.setattr(running, "FIRST", 2)
    assert simulated(path, "--no-plots", "--out", str(tmp_path / "parts")) == 0
    assert calls == [(1, 2), (1, 2), (1, 1), (1, 1)]  # to the frames after five and six steps
    for name in ("energies.csv", "points.csv"):
        whole, parts = (np.array(rows(tmp_path / where / name)[1:], float) for where in ("whole", "parts"))
        np.testing.assert_allclose(parts, whole, rtol=1e-6, atol=1e-9)
    times = [frame.time for frame in read_frames(tmp_path / "parts" / "run.pvd")]
    np.testing.assert_allclose(times, [0, 0.05, 0.06], atol=1e-9)
