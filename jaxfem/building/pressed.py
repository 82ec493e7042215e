"""Soft bodies that their own weight or speed will press flat against the ground, so that nodes inside need rows too."""

from typing import Any

import numpy as np

from jaxfem.declared.scene import SoftBody
from jaxfem.materials.moduli import ratio_and_modulus

CRUSHED = 0.5
"""Pressure of weight and of speed, as a share of Young's modulus, from which a body's inside reaches the ground."""


def pressed_flat(body: SoftBody, gravity: Any) -> bool:
    """Whether density (g height + speed^2) comes near the stiffness, at the start's numbers; `gravity` (3,) [m/s^2]."""
    values: Any = {name: np.asarray(value, float) for name, value in body.made_of.values.items()}
    young = float(np.min(ratio_and_modulus(*body.made_of.stiffness(values))[1]))
    height = float(np.ptp(body.mesh.points, axis=0).max())
    speed = float(np.max(np.sum(np.atleast_2d(np.asarray(body.velocity, float)) ** 2, axis=1)))
    pressure = float(np.max(body.density)) * (float(np.linalg.norm(np.asarray(gravity, float))) * height + speed)
    return pressure > CRUSHED * young
