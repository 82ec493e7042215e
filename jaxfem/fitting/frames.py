"""Rigid frames: the rotation and translation that best carry one set of points onto another."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.fitting.errors import FitError
from jaxfem.rotation import nearest_rotation
from jaxfem.tensors import contract

Array = jax.Array


def rigid_fit(points: Any, targets: Any, weights: Any) -> tuple[Array, Array]:
    """The rotation Q (3, 3) and translation t (3,) with the least sum of w |Q p + t - q|^2.

    points p, targets q (k, 3) [m], weights w (k,) >= 0; a point of weight 0 may hold NaN. Differentiable. The rotation
    is the nearest one to the cross-covariance of both sets (Kabsch 1976), and unique unless they lie on one line.
    """
    weights = jnp.asarray(weights)
    used = weights[:, None] > 0
    p, q = jnp.where(used, points, 0.0), jnp.where(used, targets, 0.0)
    share = weights[:, None] / jnp.sum(weights)
    p_mean, q_mean = jnp.sum(share * p, axis=0), jnp.sum(share * q, axis=0)
    rotation = nearest_rotation(contract("ki,kj->ij", share * (q - q_mean), p - p_mean))
    return rotation, q_mean - rotation @ p_mean


def check_frame(places: Any, what: str) -> None:
    """FitError where points (k, 3) leave a rigid frame open: fewer than three, or (nearly) on one line."""
    points = np.asarray(places, dtype=np.float64)
    if len(points) < 3:
        raise FitError(
            f"{what} needs three markers that are seen, not on one line; there are {len(points)}. Record in the body's "
            'frame and use frame = "none", or add markers'
        )
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[1] < 0.02 * spread[0]:
        raise FitError(
            f"{what} cannot be found: the markers lie on one line, so the turn about it stays open. Add a marker off "
            'that line, or record in the body\'s frame and use frame = "none"'
        )
