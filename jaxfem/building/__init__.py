"""From a declared scene to (model, params, state): host side, where everything is checked and indexed, once."""

from jaxfem.building.build import build
from jaxfem.building.choose import ROTATION_UPDATES
from jaxfem.building.overlaps import OverlapWarning
from jaxfem.building.rebuild import rebuild
from jaxfem.building.soft import AccuracyWarning, more_constants
from jaxfem.building.unused import UnusedWarning

__all__ = [
    "ROTATION_UPDATES",
    "AccuracyWarning",
    "OverlapWarning",
    "UnusedWarning",
    "build",
    "more_constants",
    "rebuild",
]
