"""Local volume corotated FEM (Wang, Xu & Hasegawa): groups of elements with one rotation each, tied where they meet."""

from jaxfem.methods.groupwise.method import Groupwise, binding_limit, interface_gap

__all__ = ["Groupwise", "binding_limit", "interface_gap"]
