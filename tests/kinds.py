"""The package's own kinds alone, whatever test files have defined beside them: what is told of all kinds then depends
on no order of tests."""

import contextlib

from jaxfem.declared.joints import JOINTS
from jaxfem.declared.loads import LOADS
from jaxfem.materials.base import LAWS
from jaxfem.methods import METHODS
from jaxfem.rigid.shapes import SHAPES
from jaxfem.schemes import SCHEMES


@contextlib.contextmanager
def own_alone():
    """Within it no registry knows a kind from outside the package."""
    registries = (LAWS, SCHEMES, METHODS, JOINTS, SHAPES, LOADS)
    before = [dict(each._kinds) for each in registries]
    for each in registries:
        for word, kind in list(each._kinds.items()):
            if not kind.made.__module__.startswith("jaxfem."):
                each.remove(word)
    try:
        yield
    finally:
        for each, kinds in zip(registries, before, strict=True):
            each._kinds = kinds
