"""Joints as a user declares them, one kind a file; `base` says what each of them offers."""

from jaxfem.declared.joints.ball import BallJoint
from jaxfem.declared.joints.base import JOINTS, Attachments, Joint, Part, frame_along
from jaxfem.declared.joints.distance import DistanceJoint
from jaxfem.declared.joints.hinge import HingeJoint
from jaxfem.declared.joints.motor import Motor
from jaxfem.declared.joints.slider import SliderJoint
from jaxfem.declared.joints.weld import WeldJoint
from jaxfem.registry import import_folder

__all__ = [
    "JOINTS",
    "Attachments",
    "BallJoint",
    "DistanceJoint",
    "HingeJoint",
    "Joint",
    "Motor",
    "Part",
    "SliderJoint",
    "WeldJoint",
    "frame_along",
]

import_folder(__name__, __path__)
