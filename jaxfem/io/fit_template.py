"""A commented fit file that holds every key there is."""

import dataclasses
from collections.abc import Iterator

from jaxfem.fitting.beside import KINDS
from jaxfem.io import fit_files
from jaxfem.io.templates import Line, line, table

FIT: dict[str, Line] = {
    "parameters": (
        '["young", "damping"]',
        "constants of the materials, density, delay, paths like contact.floor.friction",
    ),
    "frame": ('"none"', 'recorded in the body\'s frame; "rest" or "all" for a camera\'s own'),
    "compare": ('"displacement"', 'since the release; or "position"'),
    "release": ('"auto"', "found: the body is still at first; or a time in s"),
    "end": ('"settled"', "or a time in s; to the end of the recording without it"),
    "substeps": ("2", "time steps a sample; the scene's step without it"),
    "sigma": ("1e-4", "m, noise of the recording; found without it"),
    "checks": ('"refuse"', 'what cannot be right; or "warn"'),
    "own": ('["delay"]', "of several [[take]]s, what each has for itself"),
    "multi_start": ("16", "further starts, drawn and followed together; none without it"),
    "seed": ("0", "of the drawn starts"),
    "windows": ("4", "long recordings with contacts are fitted in so many, from the beginning on"),
    "max_memory": ("1.0", "GB, of one simulation with its derivatives"),
    "places": ("1e-3", "m, to which the markers' places are known: found with the rest"),
    "engine": ('"auto"', 'how simulations are made: "lanes" together on CPUs, or "vmap"'),
}
NOISE: dict[str, Line] = {
    "correlation": ('"effective"', 'noise may remember; or "ar", "white"'),
    "loss": ('"square"', 'or "huber", "student": outliers count less'),
    "groups": ('"all"', 'whose scatter is estimated together; or "take", "marker"'),
    "known": ("false", "true: sigma is the standard deviation itself"),
}
FIELD: dict[str, Line] = {
    "constant": ('"young"', "found element by element after the fit"),
    "jump": ("1.2", "factor by which neighbours usually differ"),
    "kind": ('"edges"', 'few large jumps; or "smooth"'),
}
RECORDING: dict[str, Line] = {
    "file": ('"recording.csv"', ""),
    "unit": ('"m"', "where the file does not say"),
    "rate": ("100.0", "1/s, where it counts frames"),
    "camera": ("[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]", "3 x 4, where it holds pixels"),
}


BESIDE: dict[str, dict[str, Line]] = {
    "frequencies": {
        "values": ("[6.2, 7.1]", "Hz"),
        "sigma": ("0.05", "Hz, their standard uncertainty; or one each"),
        "modes": ("[1, 2]", "which they are, from the lowest, 1; the first ones without it"),
        "about": ('"rest"', 'where the loads leave the body; or "start"'),
    },
    "settled": {
        "values": ("{ tip = [nan, nan, -0.006] }", "m, markers' displacements at rest; nan: not measured"),
        "sigma": ("1e-4", "m"),
        "places": ("false", "true: values are places"),
    },
    "support_force": {
        "values": ("[nan, nan, -0.94]", "N, with which the body pulls at its supports at rest"),
        "sigma": ("0.01", "N"),
        "times": ("[0.1]", "s since the release, three values for each; at rest without it"),
        "body": ('"block"', "its support alone"),
        "box": ("[[0, 0, 0], [0, 0.1, 0.3]]", "m, held nodes in here alone"),
    },
    "gauge": {
        "values": ("2.0e3", "in the path's unit: a pressure, say"),
        "sigma": ("20.0", ""),
        "path": ('"load.0"', "of what it reads, which is among the parameters"),
    },
}


def _beside() -> Iterator[str]:
    """What may be measured beside markers, each kind with what its class takes."""
    yield "# or in a [[take]] table [[take.beside]]: what was measured beside the markers"
    for word in KINDS.words():
        keys = ("kind", *(each.name for each in dataclasses.fields(KINDS[word].made)))
        known = {"kind": (f'"{word}"', "beside the markers"), **BESIDE[word]}
        yield from list(table("# [[beside]]", keys, known, ()))[1:]


def fit_template(scene: str = "scene.toml") -> str:
    """A fit of that scene, with all other keys in comments."""
    recording = [f"{key} = {RECORDING[key][0]}" for key in fit_files.RECORDING_KEYS]
    explained = [f"#   {key}: {RECORDING[key][1]}" for key in fit_files.RECORDING_KEYS if RECORDING[key][1]]
    parts = [
        "# A fit with every key that `jaxfem fit` reads; what is in comments may be left out.",
        "",
        line("scene", f'"{scene}"', "the body, its supports, and where the search starts"),
        line("recording", '"recording.csv"', "times, and the places of markers; most formats are known"),
        line(f"# recording = {{ {', '.join(recording)} }}", None, "instead of recording"),
        *explained,
        "# or several: [[take]] tables with name, recording, scene, held_out = true, release, end",
        "",
        "[markers]                       # where each sits on the undeformed body, m",
        "tip = [0.2, 0.05, 0.2]",
        '# corner = { body = "block", at = [0.1, 0, 0] }   # on a rigid body',
        "side = [0.1, 0.1, 0.15]",
        "",
        "# [clamp]                       # markers on what stands still, m: they tell the frame alone",
        "# a = [0.0, 0.0, 0.0]",
        "# b = [0.0, 0.1, 0.0]",
        "# c = [0.0, 0.0, 0.1]",
        *_beside(),
        *table("[fit]", fit_files.PLAIN_KEYS, FIT, ("parameters",)),
        *table("# [fit.noise]", fit_files.NOISE_KEYS, NOISE, ()),
        "# [fit.priors]                  # known before: a mean, or a median to a factor",
        "# young = { median = 2e5, factor = 1.5 }",
        "# [fit.bounds]",
        "# young = [1e3, 1e7]",
        "# [fit.starts]                  # each list one number a starting point",
        "# young = [1e5, 1e6]",
        "# damping = [1e-3, 1e-2]",
        *table("# [fit.field]", fit_files.FIELD_KEYS, FIELD, ()),
        *table("[output]", fit_files.OUTPUT_KEYS, {"folder": ('"fitted"', "beside this file")}, ("folder",)),
    ]
    return "\n".join(parts) + "\n"
