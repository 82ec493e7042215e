"""Time schemes, one a file; each registers itself under its name."""

from jaxfem.registry import import_folder
from jaxfem.schemes.backward_euler import BackwardEuler
from jaxfem.schemes.base import SCHEMES, Scheme, Stage, scheme_damping, scheme_of
from jaxfem.schemes.generalized_alpha import GeneralizedAlpha

__all__ = ["SCHEMES", "BackwardEuler", "GeneralizedAlpha", "Scheme", "Stage", "scheme_damping", "scheme_of"]

import_folder(__name__, __path__)
