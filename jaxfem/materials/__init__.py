"""Material laws, one a file; each registers itself under its word."""

from jaxfem.registry import import_folder

import_folder(__name__, __path__)
