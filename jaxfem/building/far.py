"""Bodies so far from the origin that the precision does not tell their places: a warning from `build`."""

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxfem.declared.errors import AccuracyWarning
from jaxfem.declared.scene import SoftBody

COARSE = 1e-3
"""Of a body's size: how finely its places must be known, for contact and strain to mean something."""


def warn_of_far(bodies: Sequence[Any], names: Sequence[str], dtype: Any) -> None:
    """Warn of each body whose coordinates are rounded by more than a thousandth of its size; host side."""
    for body, name in zip(bodies, names, strict=True):
        soft = isinstance(body, SoftBody)
        points = np.asarray(body.mesh.points if soft else body.shape.extent())
        if not len(points):
            continue
        size = float(np.ptp(points, axis=0).max())
        far = float(np.abs(points if soft else np.asarray(body.position, float)).max())
        known = float(np.finfo(dtype).eps) * far
        if known > COARSE * size:
            warnings.warn(
                f'"{name}" is {size:.3g} m large and {far:.3g} m from the origin, where places are rounded to '
                f"{known:.1g} m: contact and strain are no better. Move the scene to the origin, or compute in double "
                "precision",
                AccuracyWarning,
                stacklevel=4,
            )
