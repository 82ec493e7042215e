"""How the variants of a chunk are computed: one file an engine, found by itself."""

from jaxfem.registry import import_folder
from jaxfem.sweeping.engines.base import ENGINES, Engine, Task

import_folder(__name__, __path__)

__all__ = ["ENGINES", "Engine", "Task"]
