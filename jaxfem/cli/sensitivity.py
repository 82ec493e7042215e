"""`jaxfem sensitivity`: which recording, marker, axis and part of the time tells most about which parameter."""

import argparse
from typing import Any

import jax

from jaxfem.cli.fit import takes_of
from jaxfem.fitting.sensitivity import sensitivity
from jaxfem.io.fit_files import load_fit


def add(subparsers: Any) -> None:
    """Add the command to the parser."""
    parser = subparsers.add_parser(
        "sensitivity",
        help="which recording, marker and window tells most",
        description="Of a fit file, at its scenes' own values: the error bars to be expected, and shares of what each "
        "recording, marker, axis and quarter of the time tells about each parameter. No search is made.",
    )
    parser.add_argument("file", metavar="FIT.toml", help="the fit: scene, recording, markers, what to fit")
    parser.add_argument("--recording", metavar="CSV", help="the recording, instead of the one in the file")
    parser.add_argument("--sigma", type=float, default=1e-4, metavar="M", help="scatter of the samples, m (1e-4)")
    parser.set_defaults(run=run, quick=True)


def run(args: argparse.Namespace) -> int:
    """Print a line and a table a parameter; 0."""
    file = load_fit(args.file)
    if file.scene.precision == "float64":
        jax.config.update("jax_enable_x64", True)
    asked = {key: file.settings[key] for key in ("parameters", "own", "priors", "places")}
    sigma = file.settings["noise"].sigma or args.sigma
    print(f"{file.source.name}: samples that scatter by {1e3 * sigma:g} mm tell")
    held = () if args.recording else file.settings.get("held_out", ())
    takes = [each for each in takes_of(file, args.recording) if each.name not in held]
    for each in sensitivity(takes, sigma, **asked):
        print(each.line())
        for what, shares in (("takes", each.takes), ("markers", each.markers), ("axes", each.axes)):
            print(f"    {what}: " + ", ".join(f"{name} {100 * share:.0f} %" for name, share in shares.items()))
        print("    time: " + ", ".join(f"{name} {100 * share:.0f} %" for name, share in each.windows.items()))
    return 0
