"""`jaxfem new`: commented scene, fit and sweep files that hold every key there is."""

import argparse
from pathlib import Path
from typing import Any

from jaxfem.io.fit_template import fit_template
from jaxfem.io.scene_files import SceneFileError
from jaxfem.io.sweep_template import sweep_template
from jaxfem.io.templates import scene_template

MADE = {"scene": scene_template, "fit": fit_template, "sweep": sweep_template}


def add(subparsers: Any) -> None:
    """Add the command to the parser."""
    parser = subparsers.add_parser(
        "new",
        help="write a commented scene, fit or sweep file",
        description="Write a commented file with all keys that are known. The scene runs as it is.",
    )
    parser.add_argument("kind", choices=MADE, help="what it is for: jaxfem simulate, jaxfem fit, or jaxfem sweep")
    parser.add_argument("file", nargs="?", metavar="FILE.toml", help="where it goes (default: KIND.toml)")
    parser.add_argument("--force", action="store_true", help="replace a file that is there")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the file; 0."""
    path = Path(args.file or f"{args.kind}.toml")
    if path.exists() and not args.force:
        raise SceneFileError(f"{path} is there already: give another name, or --force to replace it")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(MADE[args.kind](), encoding="utf-8")
    command = {"scene": "simulate"}.get(args.kind, args.kind)
    print(f"wrote {path}: change it, and run `jaxfem {command} {path}`")
    return 0
