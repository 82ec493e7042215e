"""jaxfem: a differentiable solver for soft bodies, in pure JAX."""

from jaxfem import mesh, rotation, solvers
from jaxfem.building import AccuracyWarning, build
from jaxfem.energies import Energies, energies
from jaxfem.fitting import FitError, FitResult, Recording, fit, read_recording
from jaxfem.loads import NodalForce, PointForce, Pressure, Traction
from jaxfem.mesh import TetMesh
from jaxfem.model import Model, Params, State, StepInfo
from jaxfem.motion import Motion
from jaxfem.scene import Driven, Scene, SceneError, SoftBody
from jaxfem.statics import equilibrium
from jaxfem.stepping import StepError, prepare, rollout, step
from jaxfem.vibration import modes

__all__ = [
    "AccuracyWarning",
    "Driven",
    "Energies",
    "FitError",
    "FitResult",
    "Model",
    "Motion",
    "NodalForce",
    "Params",
    "PointForce",
    "Pressure",
    "Recording",
    "Scene",
    "SceneError",
    "SoftBody",
    "State",
    "StepError",
    "StepInfo",
    "TetMesh",
    "Traction",
    "build",
    "energies",
    "equilibrium",
    "fit",
    "mesh",
    "modes",
    "prepare",
    "read_recording",
    "rollout",
    "rotation",
    "solvers",
    "step",
]
