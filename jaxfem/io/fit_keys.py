"""Keys of fit files with an example value and what it means, for the template that `jaxfem new fit` writes."""

Line = tuple[str, str]

FIT: dict[str, Line] = {
    "parameters": ('["young", "damping"]', "constants of the scene's materials, density, delay"),
    "frame": ('"none"', 'recorded in the body\'s frame; "rest" or "all" for a camera\'s own'),
    "compare": ('"displacement"', 'since the release; or "position"'),
    "release": ('"auto"', "found: the body is still at first; or a time in s"),
    "end": ('"settled"', "or a time in s; to the end of the recording without it"),
    "substeps": ("2", "time steps a sample; the scene's step without it"),
    "sigma": ("1e-4", "m, noise of the recording; found without it"),
    "checks": ('"refuse"', 'what cannot be right; or "warn"'),
    "own": ('["delay"]', "of several [[take]]s, what each has for itself"),
}
NOISE: dict[str, Line] = {
    "correlation": ('"effective"', 'noise may remember; or "ar", "white"'),
    "loss": ('"square"', 'or "huber", "student": outliers count less'),
    "groups": ('"all"', 'whose scatter is estimated together; or "take", "marker"'),
    "known": ("false", "true: sigma is the standard deviation itself"),
}
RECORDING: dict[str, Line] = {
    "file": ('"recording.csv"', ""),
    "unit": ('"m"', "where the file does not say"),
    "rate": ("100.0", "1/s, where it counts frames"),
    "camera": ("[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]", "3 x 4, where it holds pixels"),
}
