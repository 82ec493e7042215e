"""`python -m jaxfem`: the `jaxfem` command."""

import sys

from jaxfem.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
