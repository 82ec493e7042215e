"""Nearest rotations against values computed elsewhere, NumPy's SVD and differences; frames and quaternions."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array

from jaxfem.rotation import (
    gram_schmidt_rotation,
    nearest_rotation,
    polar_components,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    quaternion_to_matrix,
    rotation_gap,
    rotation_vector_to_matrix,
)

EPS = {"float64": np.finfo(np.float64).eps, "float32": np.finfo(np.float32).eps}
COUNT = 512  # of one shape, so that the tests share what is compiled
nearest = jax.jit(nearest_rotation)


@jax.jit
def tangent(F: Array, dF: Array) -> tuple[Array, Array]:
    return jax.jvp(nearest_rotation, (F,), (dF,))


@jax.jit
def cotangent(F: Array, weight: Array) -> Array:
    return jax.grad(lambda F: jnp.sum(weight * nearest_rotation(F)))(F)


@jax.jit
def second(F: Array, dF: Array, weight: Array) -> Array:
    """Derivative along dF of the gradient of weight : R, reverse over reverse."""
    return jax.grad(lambda F: jnp.sum(dF * jax.grad(lambda F: jnp.sum(weight * nearest_rotation(F)))(F)))(F)


@pytest.fixture(scope="module")
def cases(reference):
    listed = json.loads((reference / "rotation_cases.json").read_text())["cases"]
    return [case for case in listed if not isinstance(case["F"], str)]


def by_svd(F):
    """Rotation and signed singular values; the sign is put on the smallest one."""
    U, s, Vt = np.linalg.svd(F)
    sign = np.sign(np.linalg.det(U @ Vt))
    U[..., 2] *= sign[..., None]
    s[..., 2] *= sign
    return U @ Vt, s


def assert_proper(R, eps):
    R = np.asarray(R, np.float64)
    assert np.isfinite(R).all()
    np.testing.assert_allclose(np.swapaxes(R, -1, -2) @ R, np.broadcast_to(np.eye(3), R.shape), atol=20 * eps)
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=20 * eps)


def nasty():
    """Generic, inverted, flat, and nearly singular matrices with their gap s2 + s3."""
    rng = np.random.default_rng(5)
    s = np.array(
        [[1.5, 1.0, 0.5], [1.5, 1.0, -0.5], [1.0, 0.6, 0.0], [1.0, 0.03, 0.02], [1.0, 0.5, -0.45], [3, 0.2, -0.1]]
    )
    U, V = np.linalg.qr(rng.standard_normal((2, 6, 3, 3)))[0]
    U, V = (Q * np.linalg.det(Q)[:, None, None] for Q in (U, V))
    return np.resize(U * s[:, None, :] @ np.swapaxes(V, 1, 2), (COUNT, 3, 3)), np.resize(s[:, 1] + s[:, 2], COUNT), rng


@pytest.mark.parametrize("batched", [True, False])
def test_reference_rotations(cases, batched):
    F = np.array([case["F"] for case in cases])
    R = np.asarray(nearest(F)) if batched else np.array([nearest(f) for f in F])
    assert_proper(R, EPS["float64"])
    for case, r in zip(cases, R, strict=True):
        if case["unique"]:
            np.testing.assert_allclose(r, case["R"], rtol=0, atol=case["suggested_tol_R_f64"], err_msg=case["name"])
        else:
            scale = np.abs(case["F"]).max()
            reached, most = np.sum(r * np.array(case["F"])), by_svd(np.array(case["F"]))[1].sum()
            assert reached == pytest.approx(most, abs=1e-14 * scale), case["name"]


def test_reference_derivatives(cases):
    unique = [case for case in cases if case["unique"]]
    F, dF = (np.array([case[key] for case in unique]) for key in ("F", "dF"))
    _, dR = tangent(F, dF)
    for case, got in zip(unique, np.asarray(dR), strict=True):
        relative = 1e-8 * max(1.0, np.abs(case["F"]).max() / case["gap"])
        # Relative to the size of the derivative, so that F = 1e150 is not compared with an absolute zero.
        atol = relative * np.abs(case["dR"]).max()
        np.testing.assert_allclose(got, case["dR"], rtol=0, atol=atol, err_msg=case["name"])


def test_reference_rotations_in_single_precision(cases):
    single = [case for case in cases if np.abs(case["F"]).max() < np.finfo(np.float32).max]  # leaves out 1e150
    F = np.array([case["F"] for case in single], np.float32)
    R = nearest(F)
    assert R.dtype == jnp.float32
    assert_proper(R, EPS["float32"])
    for case, f, r in zip(single, F, R, strict=True):
        _, s = by_svd(f.astype(np.float64))
        assert np.sum(r * f.astype(np.float64)) == pytest.approx(s.sum(), abs=2e-6 * s[0]), case["name"]
        # What rounding F to single precision leaves undetermined is not compared.
        if case["unique"] and case["gap"] > 1e2 * EPS["float32"] * s[0]:
            atol = case["suggested_tol_R_f64"] * EPS["float32"] / EPS["float64"]
            np.testing.assert_allclose(r, case["R"], rtol=0, atol=atol, err_msg=case["name"])


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_every_finite_matrix_gives_finite_values_and_derivatives(cases, dtype):
    rng = np.random.default_rng(3)
    listed = [np.array(case["F"]) for case in cases]
    ternary = rng.integers(-1, 2, (400, 3, 3))
    lines = rng.standard_normal((20, 3, 1)) * rng.standard_normal((20, 1, 3))
    scales = np.array([1e-300, 1e-30, 1e300, np.finfo(dtype).max, np.finfo(dtype).tiny, 0])
    scaled = scales[:, None, None] * np.clip(rng.standard_normal((6, 3, 3)), -1, 1)
    F = np.concatenate([listed, ternary, lines, scaled])
    F = F[np.abs(F).max(axis=(1, 2)) <= np.finfo(dtype).max].astype(dtype)
    assert len(F) <= COUNT
    F = np.resize(F, (COUNT, 3, 3))
    assert_proper(nearest(F), EPS[dtype])
    size = np.abs(F).max(axis=(1, 2), keepdims=True)
    # A derivative of size 1 / |F| cannot be held for a subnormal F; the second one not for |F|^2 that small.
    direction = (rng.standard_normal(F.shape) * np.minimum(np.where(size > 0, size, 1), 1)).astype(dtype)
    assert np.isfinite(tangent(F, direction)[1]).all()
    fair = (size == 0) | (size > 1e-15)
    assert np.isfinite(second(np.where(fair, F, 0), direction, direction)).all()


def test_pseudo_inverse_where_the_spin_is_undefined():
    F = jnp.diag(jnp.array([2.0, 1.0, -1.0]))  # s2 + s3 = 0: the spin about x is undefined
    R, dR = tangent(F, jnp.asarray(np.random.default_rng(4).standard_normal((3, 3))))
    spin = np.asarray(R.T @ dR)
    assert np.abs(spin).max() < 10
    S = R.T @ F
    null = np.linalg.eigh(np.trace(S) * np.eye(3) - S)[1][:, 0]
    w = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
    assert abs(w @ null) < 1e-6 and np.linalg.norm(w) > 0.1
    assert not np.any(tangent(jnp.zeros((3, 3)), jnp.ones((3, 3)))[1])
    np.testing.assert_array_equal(nearest(jnp.zeros((3, 3))), np.eye(3))


def test_nan_stays_in_its_own_matrix():
    F = np.tile(np.eye(3), (COUNT, 1, 1))
    F[1, 1, 2] = np.nan
    F[2] = np.diag([1.5, 1, -0.5])
    R, dR = (np.asarray(a) for a in tangent(F, np.ones_like(F)))
    assert np.isnan(R[1]).all() and np.isnan(dR[1]).any()
    others = np.arange(COUNT) != 1
    assert np.isfinite(R[others]).all() and np.isfinite(dR[others]).all()


def test_forward_reverse_and_differences_agree():
    F, gap, rng = nasty()
    dF, weight = rng.standard_normal((2, *F.shape))
    h = 1e-6 * gap[:, None, None]
    _, forward = tangent(F, dF)
    differences = (nearest(F + h * dF) - nearest(F - h * dF)) / (2 * h)
    bound = 1e-8 / gap**2
    assert (np.abs(forward - differences).max(axis=(1, 2)) < bound).all()
    reverse = np.sum(cotangent(F, weight) * dF, axis=(1, 2))
    np.testing.assert_allclose(reverse, np.sum(weight * forward, axis=(1, 2)), rtol=1e-12, atol=1e-12)


def test_second_derivatives_match_differences():
    F, gap, rng = nasty()
    dF, weight, other = rng.standard_normal((3, *F.shape))
    h = 1e-6 * gap[:, None, None]

    def slope(F):
        return np.sum(tangent(F, dF)[1] * weight, axis=(1, 2))

    differences = (slope(F + h * other) - slope(F - h * other)) / (2 * h[:, 0, 0])
    got = np.sum(second(F, dF, weight) * other, axis=(1, 2))
    np.testing.assert_allclose(got * gap**2, differences * gap**2, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_random_batch_against_svd(dtype):
    F = np.random.default_rng(0).standard_normal((2000, 3, 3)).astype(dtype)
    expected, s = by_svd(F.astype(np.float64))
    error = np.abs(np.asarray(nearest(F), np.float64) - expected).max(axis=(1, 2))
    # In units of eps |F| / gap; NumPy's own error is of that size in float64.
    assert (error * (s[:, 1] + s[:, 2]) / s[:, 0] < (60 if dtype == "float64" else 10) * EPS[dtype]).all()


def test_vmap_and_components_equal_the_batch():
    F = np.random.default_rng(0).standard_normal((2000, 3, 3))
    R = nearest(F)
    np.testing.assert_allclose(jax.jit(jax.vmap(nearest_rotation))(F), R, atol=1e-11)
    np.testing.assert_allclose(jnp.array(polar_components(jnp.moveaxis(F, 0, 2))), np.moveaxis(R, 0, 2), atol=1e-11)
    np.testing.assert_array_equal(nearest(F.reshape(40, 50, 3, 3)), R.reshape(40, 50, 3, 3))


def test_turning_the_matrix_turns_the_rotation():
    F, gap, rng = nasty()
    Q = rotation_vector_to_matrix(rng.standard_normal((COUNT, 3)))
    np.testing.assert_allclose(nearest(Q @ F), Q @ nearest(F), rtol=0, atol=50 * EPS["float64"] / gap.min())
    np.testing.assert_allclose(nearest(F @ Q), nearest(F) @ Q, rtol=0, atol=50 * EPS["float64"] / gap.min())


def test_gap_flags_undetermined_rotations(cases):
    F = np.array([case["F"] for case in cases])
    gap = rotation_gap(F, nearest(F))
    scale = np.abs(F).max(axis=(1, 2))
    np.testing.assert_allclose(gap / scale, [c["gap"] for c in cases] / scale, rtol=1e-13, atol=2e-15)
    assert not np.any(jax.grad(lambda F: rotation_gap(F, jnp.eye(3)))(jnp.asarray(F[6])))


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_gram_schmidt_is_always_a_rotation(cases, dtype):
    rng = np.random.default_rng(2)
    F = np.concatenate(
        [[case["F"] for case in cases], rng.integers(-1, 2, (200, 3, 3)), rng.standard_normal((50, 3, 3))]
    )
    F[-20:, :, 1] = F[-20:, :, 0] * 3 * (1 + 1e-7 * rng.standard_normal((20, 3)))  # nearly collapsed
    F = F[np.abs(F).max(axis=(1, 2)) < np.finfo(dtype).max].astype(dtype)
    R = jax.jit(gram_schmidt_rotation)(F)
    assert R.dtype == dtype
    assert_proper(R, EPS[dtype])
    weight = rng.standard_normal(F.shape).astype(dtype)
    assert np.isfinite(jax.jit(jax.grad(lambda F: jnp.sum(weight * gram_schmidt_rotation(F))))(F)).all()
    np.testing.assert_array_equal(gram_schmidt_rotation(jnp.zeros((3, 3))), np.eye(3))


def test_gram_schmidt_value_and_derivative():
    F, dF = np.random.default_rng(8).standard_normal((2, 3, 3))
    Q, T = np.linalg.qr(F)
    Q = Q * np.sign(np.diag(T))
    Q[:, 2] = np.cross(Q[:, 0], Q[:, 1])
    R, dR = jax.jvp(gram_schmidt_rotation, (F,), (dF,))
    np.testing.assert_allclose(R, Q, atol=1e-14)
    h = 1e-6
    differences = (gram_schmidt_rotation(F + h * dF) - gram_schmidt_rotation(F - h * dF)) / (2 * h)
    np.testing.assert_allclose(dR, differences, rtol=1e-8, atol=1e-8)


def test_quaternions():
    rng = np.random.default_rng(9)
    u, v = rng.standard_normal((2, 5, 3)) * np.array([[1e-9], [0.09], [0.11], [1.0], [3.0]])
    p, q = quaternion_from_rotation_vector(u), quaternion_from_rotation_vector(v)
    np.testing.assert_allclose(np.linalg.norm(p, axis=-1), 1, atol=1e-15)
    for turn, matrix in zip(u, rotation_vector_to_matrix(u), strict=True):
        skew = np.cross(np.eye(3), turn)
        np.testing.assert_allclose(matrix, jax.scipy.linalg.expm(skew), atol=1e-14)
    product = quaternion_to_matrix(quaternion_multiply(p, q))
    np.testing.assert_allclose(product, quaternion_to_matrix(p) @ quaternion_to_matrix(q), atol=1e-14)
    assert_proper(quaternion_to_matrix(1.1 * p), EPS["float64"])
    assert quaternion_from_rotation_vector(jnp.zeros(3, jnp.float32)).dtype == jnp.float32


def test_rotation_vector_is_smooth_at_zero():
    zero = jnp.zeros(3)
    slope = jax.jit(jax.jacfwd(rotation_vector_to_matrix))(zero)
    np.testing.assert_allclose(slope, -np.cross(np.eye(3)[:, None], np.eye(3)[None]), atol=1e-15)
    curved = jax.jit(jax.jacfwd(jax.jacfwd(rotation_vector_to_matrix)))(zero)
    v = np.array([0.3, -0.4, 0.5])
    K = np.cross(np.eye(3), v)
    np.testing.assert_allclose(curved @ v @ v, K @ K, atol=1e-14)


def test_a_batch_takes_the_slow_path_only_where_a_matrix_needs_it():
    """vmap leaves the branch a branch, and lanes get what they get alone."""
    lanes = jnp.asarray(np.random.default_rng(4).normal(size=(3, 5, 3, 3)))
    together = jax.vmap(nearest_rotation)(lanes)
    for lane, alone in zip(together, map(nearest_rotation, lanes), strict=True):
        np.testing.assert_allclose(lane, alone, atol=1e-13)
    assert "cond[" in str(jax.make_jaxpr(jax.vmap(nearest_rotation))(lanes))
