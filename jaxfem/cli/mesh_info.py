"""`jaxfem mesh info`: what is in a mesh file, and how good it is."""

import argparse
from typing import Any

from jaxfem.mesh import report_text


def add(subparsers: Any) -> None:
    """Add the command to the parser."""
    mesh = subparsers.add_parser("mesh", help="look at a mesh file")
    actions = mesh.add_subparsers(title="actions", metavar="ACTION", required=True)
    info = actions.add_parser("info", help="size, quality and groups of a mesh file")
    info.add_argument("file", metavar="FILE", help="a mesh of a volume: .msh, .vtu, .vtk, .node, .inp, .mesh, ...")
    info.add_argument("--scale", type=float, metavar="S", help="length of the file's unit in m (mm: 1e-3)")
    info.add_argument("--merge", action="store_true", help="make nodes one that lie on top of another")
    info.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the report."""
    print(report_text(args.file, scale=args.scale, merge=args.merge))
    return 0
