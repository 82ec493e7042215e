"""Lines for people, on standard error."""

import sys


def error(text: object) -> None:
    """`jaxfem: error: text`."""
    print(f"jaxfem: error: {text}", file=sys.stderr)


def warning(text: object) -> None:
    """`jaxfem: warning: text`."""
    print(f"jaxfem: warning: {text}", file=sys.stderr)
