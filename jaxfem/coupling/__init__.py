"""From declared rigid bodies, joints and contacts to the arrays of a model; host side."""

from jaxfem.coupling.build import with_coupling

__all__ = ["with_coupling"]
