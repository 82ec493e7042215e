"""`jaxfem mesh info` and `jaxfem mesh make`: what is in a mesh file and how good it is; a mesh inside a surface
or a CAD model."""

import argparse
import re
from pathlib import Path
from typing import Any

from jaxfem.cli.messages import warning
from jaxfem.io.plots import PlotError, plot_mesh
from jaxfem.mesh import MeshError, TetMesh, from_cad, from_surface, read_surface, report_text, write
from jaxfem.mesh.cad import SUFFIXES

UNITS = {"": 1.0, "m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}


def add(subparsers: Any) -> None:
    """Add the command to the parser."""
    mesh = subparsers.add_parser("mesh", help="make a mesh, or look at one")
    actions = mesh.add_subparsers(title="actions", metavar="ACTION", required=True)
    info = actions.add_parser("info", help="size, quality and groups of a mesh file")
    info.add_argument("file", metavar="FILE", help="a mesh of a volume: .msh, .vtu, .vtk, .node, .inp, .mesh, ...")
    info.add_argument("--scale", type=float, metavar="S", help="length of the file's unit in m (mm: 1e-3)")
    info.add_argument("--merge", action="store_true", help="make nodes one that lie on top of another")
    info.set_defaults(run=run)
    make = actions.add_parser("make", help="fill a surface or a CAD model with tetrahedra")
    make.add_argument(
        "file",
        metavar="SURFACE",
        help="a surface: .stl, .obj, .ply, .off, ...; it may be open and cracked; or a CAD model: .step, .iges",
    )
    make.add_argument("--size", type=length, metavar="L", help="length of edges, like 5mm or 0.005 (m)")
    make.add_argument("--finest", type=length, metavar="L", help="of a CAD model: shorter edges where it is curved")
    make.add_argument("--scale", type=float, metavar="S", help="length of a surface's unit in m (mm: 1e-3)")
    make.add_argument("--out", metavar="MESH", help="the mesh, instead of SURFACE.vtu")
    make.add_argument("--seconds", type=float, default=300.0, metavar="T", help="how long it may take (300)")
    make.add_argument("--no-plots", action="store_true", help="draw no picture")
    make.set_defaults(run=run_make)


def run(args: argparse.Namespace) -> int:
    """Print the report."""
    print(report_text(args.file, scale=args.scale, merge=args.merge))
    return 0


def run_make(args: argparse.Namespace) -> int:
    """Fill the surface or model, write mesh and picture, print the report; 0."""
    source = Path(args.file)
    target = Path(args.out) if args.out else source.with_suffix(".vtu")
    mesh = _made(source, args)
    write(target, mesh)
    made = [target.name]
    if not args.no_plots:
        try:
            made.append(plot_mesh(target.with_suffix(".png"), mesh.points, mesh.surface, mesh.name).name)
        except PlotError as problem:
            warning(f"{problem}; going on without a picture")
    print("\n".join([*mesh.notes, report_text(target, scale=1.0), f"wrote {', '.join(made)} in {target.parent}"]))
    return 0


def _made(source: Path, args: argparse.Namespace) -> TetMesh:
    """A CAD model knows its unit and what of it is curved, a surface does not."""
    if source.suffix.lower() in SUFFIXES:
        if args.scale is not None:
            raise MeshError(f"--scale is not for {source.name}: a CAD model knows its unit")
        return from_cad(source, args.size, finest=args.finest, seconds=args.seconds)
    if args.finest is not None:
        raise MeshError(f"--finest is for CAD models ({', '.join(SUFFIXES)}), and {source.name} is none")
    return from_surface(*read_surface(source, args.scale), args.size, source.stem, seconds=args.seconds)


def length(text: str) -> float:
    """A length in m, of a number and a unit."""
    found = re.fullmatch(r"([0-9.eE+-]+)\s*([a-z]*)", text.strip())
    if found is None or found[2] not in UNITS:
        raise argparse.ArgumentTypeError(f"{text!r} is no length: give a number with m, cm, mm, um or in, like 5mm")
    try:
        value = float(found[1]) * UNITS[found[2]]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no length: give a number and a unit, like 5mm") from None
    return value
