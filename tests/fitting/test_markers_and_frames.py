"""Markers ride rigidly on their elements; rigid frames are recovered; both have derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.fitting import FitError, attach, marker_positions
from jaxfem.fitting.frames import check_frame, rigid_fit

PLACES = {"inside": (0.03, 0.01, 0.02), "proud": (0.1, 0.015, 0.036), "side": (0.05, -0.006, 0.02)}


@pytest.fixture(scope="module")
def mesh():
    return jf.mesh.box((0.1, 0.03, 0.03), cells=(4, 2, 2))


@pytest.fixture(scope="module")
def turn():
    rotation = jf.rotation.rotation_vector_to_matrix(jnp.array([0.7, -1.1, 2.0]))
    return np.asarray(rotation), np.array([0.3, -0.2, 1.0])


def test_at_rest_markers_are_where_they_were_put(mesh):
    markers = attach(mesh, PLACES)
    np.testing.assert_allclose(marker_positions(markers, mesh.points), list(PLACES.values()), atol=1e-15)
    assert np.abs(markers.offsets[0]).max() == 0 and np.linalg.norm(markers.offsets[1]) == pytest.approx(6e-3)


def test_offset_markers_move_rigidly_and_do_not_stretch(mesh, turn):
    rotation, shift = turn
    markers = attach(mesh, PLACES)
    moved = marker_positions(markers, mesh.points @ rotation.T + shift)
    np.testing.assert_allclose(moved, np.array(list(PLACES.values())) @ rotation.T + shift, atol=1e-14)
    stretched = marker_positions(markers, mesh.points * np.array([1.5, 1.0, 0.7]))
    np.testing.assert_allclose(stretched[1], (0.15, 0.015, 0.03 * 0.7 + 0.006), atol=1e-14)


def test_leading_axes_are_frames(mesh):
    markers = attach(mesh, PLACES)
    frames = jnp.stack([mesh.points, 1.1 * mesh.points])
    separate = marker_positions(markers, frames[1])
    np.testing.assert_allclose(marker_positions(markers, frames)[1], separate, atol=1e-16)


def test_marker_derivatives_agree_with_each_other_and_with_differences(mesh):
    markers = attach(mesh, PLACES)
    random = np.random.default_rng(0)
    x = jnp.asarray(mesh.points + 2e-3 * random.normal(size=mesh.points.shape))
    direction, weight = random.normal(size=x.shape), random.normal(size=(3, 3))
    place = jax.jit(lambda p: marker_positions(markers, p))
    forward = jax.jvp(place, (x,), (jnp.asarray(direction),))[1]
    backward = jax.vjp(place, x)[1](jnp.asarray(weight))[0]
    assert jnp.vdot(weight, forward) == pytest.approx(float(jnp.vdot(backward, direction)), rel=1e-10)
    h = 1e-7
    differences = (place(x + h * direction) - place(x - h * direction)) / (2 * h)
    np.testing.assert_allclose(forward, differences, rtol=1e-6, atol=1e-6)


def test_rigid_fit_finds_the_frame_and_ignores_what_is_missing(turn):
    rotation, shift = turn
    points = np.random.default_rng(1).normal(size=(7, 3))
    targets = points @ rotation.T + shift
    targets[2] = np.nan
    found, translation = rigid_fit(points, targets, np.array([1, 2, 0, 1, 0.5, 1, 1.0]))
    np.testing.assert_allclose(found, rotation, atol=1e-13)
    np.testing.assert_allclose(translation, shift, atol=1e-13)


def test_rigid_fit_derivatives_agree():
    random = np.random.default_rng(2)
    points, targets, weights = random.normal(size=(5, 3)), random.normal(size=(5, 3)), random.uniform(0.5, 2, 5)
    direction = random.normal(size=(5, 3))

    def frame(q):
        return jnp.concatenate([part.ravel() for part in rigid_fit(points, q, weights)])

    forward = jax.jvp(frame, (jnp.asarray(targets),), (jnp.asarray(direction),))[1]
    reverse = jax.jacrev(frame)(jnp.asarray(targets)).reshape(12, -1) @ direction.ravel()
    h = 1e-6
    differences = (frame(targets + h * direction) - frame(targets - h * direction)) / (2 * h)
    np.testing.assert_allclose(forward, reverse, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(forward, differences, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize(
    ("places", "message"),
    [
        ({}, "no marker"),
        ({"a": (1.0, 2.0)}, '"a".*three finite numbers'),
        ({"a": (50.0, 15.0, 30.0)}, '"a" lies .* give places in m'),
    ],
)
def test_impossible_markers_are_refused(mesh, places, message):
    with pytest.raises(FitError, match=message):
        attach(mesh, places)


def test_a_frame_needs_three_markers_off_a_line():
    with pytest.raises(FitError, match="three markers"):
        check_frame(np.eye(3)[:2], "the frame")
    with pytest.raises(FitError, match="on one line"):
        check_frame(np.outer(np.arange(4.0), [1, 2, 3]), "the frame")
