"""From a declared scene to (model, params, state): host side, where everything is checked and indexed, once."""

from jaxfem.building.build import AccuracyWarning, build
from jaxfem.building.choose import ROTATION_UPDATES

__all__ = ["ROTATION_UPDATES", "AccuracyWarning", "build"]
