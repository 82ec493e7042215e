"""`jaxfem recording info`: what is in a recording of markers, and what is wrong with it."""

import argparse
from typing import Any

from jaxfem.fitting import read_recording
from jaxfem.fitting.recording_info import recording_text


def add(subparsers: Any) -> None:
    """Add the command to the parser."""
    recording = subparsers.add_parser("recording", help="look at a recording of markers")
    actions = recording.add_subparsers(title="actions", metavar="ACTION", required=True)
    info = actions.add_parser("info", help="format, markers, rate, gaps, still parts and units of a recording")
    info.add_argument("file", metavar="FILE", help="Motive, Nexus, Qualisys, TRC, C3D, Anipose, DeepLabCut or any CSV")
    info.add_argument("--unit", metavar="U", help="unit of lengths where the file says none: mm, cm, in, ...")
    info.add_argument("--rate", type=float, metavar="HZ", help="rows a second where the file only numbers frames")
    info.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the report."""
    print(f"{args.file}: {recording_text(read_recording(args.file, unit=args.unit, rate=args.rate))}")
    return 0
