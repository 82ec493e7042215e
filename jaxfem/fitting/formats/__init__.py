"""Recordings as other programs write them: each format a file that registers itself, found by a file's content."""

from jaxfem.fitting.formats.base import FORMATS, Format, Request
from jaxfem.registry import import_folder

import_folder(__name__, __path__)

__all__ = ["FORMATS", "Format", "Request"]
