"""What a user declares beside soft bodies: rigid bodies, joints, contacts. Host data, checked when it is made."""

from jaxfem.declared.contacts import Contact
from jaxfem.declared.errors import SceneError
from jaxfem.declared.joints import BallJoint, DistanceJoint, HingeJoint, Joint, Motor, SliderJoint, WeldJoint
from jaxfem.declared.rigid import RigidBody

__all__ = [
    "BallJoint",
    "Contact",
    "DistanceJoint",
    "HingeJoint",
    "Joint",
    "Motor",
    "RigidBody",
    "SceneError",
    "SliderJoint",
    "WeldJoint",
]
