"""Joints that do not hold where their bodies start: a warning from `build`, with how far they are open."""

import warnings
from collections.abc import Sequence
from typing import Any

from jaxfem.answers import described, is_number
from jaxfem.declared.errors import AccuracyWarning, SceneError
from jaxfem.declared.joints import Joint


def warn_of_open(joints: Sequence[Joint]) -> None:
    """Warn of each rigid joint that is open at the start: closing it throws what it holds; host side."""
    for joint in joints:
        found: Any = joint.open_by()
        if not (isinstance(found, tuple) and len(found) == 2 and is_number(found[0]) and isinstance(found[1], str)):
            raise SceneError(
                f'`open_by` of "{joint.label}", a {type(joint).__name__}, gives {described(found)}; it must give a '
                "number and its unit"
            )
        gap, unit = found
        if gap > 0:
            warnings.warn(
                f'joint "{joint.label}" is open by {gap:.3g} {unit} at the start: the first steps close it, at any '
                "speed that takes, and what it holds may keep that speed. Start where it holds, give the length or "
                "limits that it has there, or drive it there by a motor",
                AccuracyWarning,
                stacklevel=3,
            )
