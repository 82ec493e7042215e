"""Recordings: read, written, refused with file and line; the release is found."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.fitting import FitError, Recording, read_recording, write_recording
from jaxfem.fitting.measurement import measurement
from jaxfem.fitting.release import find_release, found_release, settled_row
from jaxfem.fitting.unknowns import with_values

HEADER = "time_s,tip_x_m,tip_y_m,tip_z_m\n"


def motion(still: int, rows: int = 150, noise: float = 0.0, seed: int = 0) -> Recording:
    """A decaying cosine released after `still` rows, in mm."""
    t = np.maximum(np.arange(rows) - still, 0) * 0.01
    z = -1e-2 * (1 - np.exp(-4 * t) * np.cos(50 * t))
    positions = np.zeros((rows, 2, 3))
    positions[:, :, 2] = z[:, None] * [1.0, 0.3]
    positions += noise * np.random.default_rng(seed).normal(size=positions.shape)
    return Recording(np.arange(rows) * 0.01, positions, ("a", "b"))


def test_round_trip_with_missing_samples(tmp_path):
    recording = motion(5, 20, noise=1e-4)
    recording.positions[3, 1] = np.nan
    write_recording(tmp_path / "r.csv", recording)
    again = read_recording(tmp_path / "r.csv")
    assert again.names == ("a", "b") and not again.seen[3, 1] and again.seen.sum() == 39
    np.testing.assert_allclose(again.positions, recording.positions, rtol=1e-8)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("time_s\n0\n1\n", "holds no marker"),
        ("tip_x_m,tip_y_m,tip_z_m\n0,0,0\n", 'no column "time_s"'),
        ("time_s,tip_x_m,tip_z_m\n0,0,0\n1,0,0\n", '"tip" lacks the column tip_y_m'),
        ("time_s,tip_speed\n0,0\n1,0\n", 'column "tip_speed" is not one of'),
        (HEADER + "0,0,0,0\n", "1 rows of samples"),
        (HEADER + "0,0,0,0\n0.1,0,oops,0\n", "line 3, column \"tip_y_m\": 'oops'"),
        (HEADER + "0,0,0,0\n0.1,0,0\n", "line 3: 3 cells"),
        (HEADER + "0,0,0,0\n0.1,0,0,0\n0.1,0,1,0\n", "times must increase"),
        (HEADER + "0,0,0,0\n,0,0,0\n", "needs its time"),
    ],
)
def test_bad_files_are_refused_by_place(tmp_path, text, message):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(FitError, match=message) as caught:
        read_recording(path)
    assert "bad.csv" in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FitError, match=r"nowhere\.csv"):
        read_recording(tmp_path / "nowhere.csv")


@pytest.mark.parametrize("noise", [0.0, 5e-5, 3e-4])
def test_the_release_is_found(noise):
    assert found_release(motion(40, noise=noise)).row == 40
    assert found_release(motion(0, noise=noise)).row == 0


def test_the_end_of_the_ringing_is_found():
    # 4 / s of decay: within 5 % of the excursion after a second
    assert 90 < settled_row(motion(40)) < 150


def test_the_interval_of_the_release_holds_it_as_noise_grows():
    """A swing of 18 mm: sure of the row in little noise, of a few in more, asked for in as much as the swing."""
    for noise, width in ((1e-4, 0), (1e-3, 2), (3e-3, 8)):
        found = [find_release(motion(20, noise=noise, seed=seed)) for seed in range(60)]
        assert np.mean([each.low <= 20 <= each.high for each in found]) > 0.88
        assert np.median([each.high - each.low for each in found]) <= width
    with pytest.raises(FitError, match="release"):
        found_release(motion(20, noise=2e-2))


def test_lost_samples_hide_no_release():
    """Lost ones elsewhere change nothing; lost ones of all markers at the release widen the interval."""
    recording = motion(20, noise=1e-4)
    recording.positions[5:9, 0] = np.nan
    recording.positions[30:34] = np.nan
    assert find_release(recording).row == 20
    recording.positions[19:22] = np.nan
    found = find_release(recording)
    assert found.low <= 20 <= found.high + 3


def test_noise_does_not_hide_that_it_settled():
    # what rings on below the noise is settled: 3 mm of a decay by 4 / s from 10 mm is reached at row 70
    for noise, first in ((0.0, 90), (3e-4, 75), (1e-3, 55)):
        assert first < settled_row(motion(40, noise=noise)) < 130


def test_still_markers_have_no_release():
    still = Recording(np.arange(9.0), np.ones((9, 1, 3)), ("a",))
    with pytest.raises(FitError, match="do not move"):
        found_release(still)


def test_the_real_releases(data):
    for name, row in (("gravity", 65), ("load52", 43), ("load101", 51)):
        assert abs(found_release(read_recording(data / "real_beam" / f"{name}.csv")).row - row) <= 1


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"frame": "camera"}, "frame is 'camera'; known: none"),
        ({"compare": "velocity"}, "compare is"),
        ({"release": "now"}, 'give "auto"'),
        ({"release": 9.0}, "outside the recording"),
        ({"end": 0.1}, "not after the release"),
        ({"frame": "rest"}, "three markers"),
    ],
)
def test_impossible_settings_are_refused(settings, message):
    usual = {"frame": "none", "compare": "displacement", "release": "auto", "end": None}
    with pytest.raises(FitError, match=message):
        measurement(motion(40), np.zeros((2, 3)), **{**usual, **settings})


def test_a_subset_refuses_unknown_names():
    with pytest.raises(FitError, match='no marker "tip" that is ever seen; its markers: a, b'):
        motion(5).subset(("tip",))


def test_fitted_values_replace_zeros_of_several_bodies():
    """Proportions are kept; where all are zero there are none, and the value goes to each."""
    values = {"young": [1e5, 3e5], "poisson": [0.3, 0.3], "density": [1e3, 1e3], "damping": [0.0, 0.0]}
    constants = {name: jnp.array(each) for name, each in values.items()}
    params = jf.Params(constants, gravity=jnp.zeros(3))
    changed = with_values(params, {"damping": 2e-3, "young": 4e5})
    np.testing.assert_allclose(changed.damping, [2e-3, 2e-3])
    np.testing.assert_allclose(changed.young, [2e5, 6e5])
