"""jaxfem: a differentiable solver for soft and rigid bodies, in pure JAX."""

from jaxfem import mesh, rotation, solvers
from jaxfem.building import AccuracyWarning, OverlapWarning, UnusedWarning, build, rebuild
from jaxfem.declared import BallJoint, Contact, DistanceJoint, HingeJoint, Motor, RigidBody, SliderJoint, WeldJoint
from jaxfem.declared.loads import NodalForce, PointForce, Pressure, Traction
from jaxfem.declared.scene import Driven, Scene, SceneError, SoftBody
from jaxfem.diagnose import Diagnosis, diagnose
from jaxfem.energies import Energies, energies, with_account
from jaxfem.fitting import (
    FitError,
    FitResult,
    Gaussian,
    LogNormal,
    Noise,
    Recording,
    Take,
    fit,
    fit_takes,
    read_recording,
)
from jaxfem.materials.base import Material, Response
from jaxfem.materials.constants import Constant, MaterialError
from jaxfem.materials.creeping import CreepPlastic
from jaxfem.materials.j2_plastic import J2Plastic
from jaxfem.materials.linear import Linear
from jaxfem.materials.mooney_rivlin import MooneyRivlin
from jaxfem.materials.neo_hookean import NeoHookean
from jaxfem.materials.nonlinear import Nonlinear
from jaxfem.materials.viscoelastic import Viscoelastic
from jaxfem.materials.yeoh import Yeoh
from jaxfem.mesh import MeshError, MeshWarning, TetMesh
from jaxfem.model import Model, Params, State, StepInfo
from jaxfem.motion import Motion
from jaxfem.rigid.dynamics import RigidParams, RigidSet, RigidState
from jaxfem.rigid.shapes import Box, Capsule, Cylinder, HeightField, Plane, SignedDistance, Sphere, TriangleMesh
from jaxfem.schemes import BackwardEuler, GeneralizedAlpha, scheme_damping
from jaxfem.statics import equilibrium
from jaxfem.stepping import StepError, impulses, prepare, rollout, step, with_memory
from jaxfem.sweeping import SweepError, SweepResult, sweep
from jaxfem.vibration import modes

__version__ = "0.1.0"

__all__ = [
    "AccuracyWarning",
    "BackwardEuler",
    "BallJoint",
    "Box",
    "Capsule",
    "Constant",
    "Contact",
    "CreepPlastic",
    "Cylinder",
    "Diagnosis",
    "DistanceJoint",
    "Driven",
    "Energies",
    "FitError",
    "FitResult",
    "Gaussian",
    "GeneralizedAlpha",
    "HeightField",
    "HingeJoint",
    "J2Plastic",
    "Linear",
    "LogNormal",
    "Material",
    "MaterialError",
    "MeshError",
    "MeshWarning",
    "Model",
    "MooneyRivlin",
    "Motion",
    "Motor",
    "NeoHookean",
    "NodalForce",
    "Noise",
    "Nonlinear",
    "OverlapWarning",
    "Params",
    "Plane",
    "PointForce",
    "Pressure",
    "Recording",
    "Response",
    "RigidBody",
    "RigidParams",
    "RigidSet",
    "RigidState",
    "Scene",
    "SceneError",
    "SignedDistance",
    "SliderJoint",
    "SoftBody",
    "Sphere",
    "State",
    "StepError",
    "StepInfo",
    "SweepError",
    "SweepResult",
    "Take",
    "TetMesh",
    "Traction",
    "TriangleMesh",
    "UnusedWarning",
    "Viscoelastic",
    "WeldJoint",
    "Yeoh",
    "__version__",
    "build",
    "diagnose",
    "energies",
    "equilibrium",
    "fit",
    "fit_takes",
    "impulses",
    "mesh",
    "modes",
    "prepare",
    "read_recording",
    "rebuild",
    "rollout",
    "rotation",
    "scheme_damping",
    "solvers",
    "step",
    "sweep",
    "with_account",
    "with_memory",
]
