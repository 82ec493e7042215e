"""A commented sweep file that holds every key there is."""

from jaxfem.inputs import inputs_of
from jaxfem.io import sweep_files
from jaxfem.io.templates import Line, line, table
from jaxfem.sweeping.engines import ENGINES
from jaxfem.sweeping.outputs import OUTPUTS
from jaxfem.sweeping.taking import TAKEN

SWEEP: dict[str, Line] = {
    "kind": ('"latin_hypercube"', "or grid, random, table; sobol for sensitivity indices (then count is a power of 2)"),
    "count": ("8", "variants; not of a grid or a table"),
    "seed": ("0", "the same gives the same"),
    "table": ('"values.csv"', 'of kind = "table": names in its first line, a row a variant'),
    "engine": ('"auto"', ""),
    "width": ("32", "variants a shard; what suits without it"),
    "processes": ("2", "one a core without it"),
    "derivatives": ('["young"]', "of the outputs in these, beside them"),
}
OUTPUT: dict[str, Line] = {
    "folder": ('"swept"', "beside this file; NAME_results without it"),
    "table": ('"csv"', 'or "parquet"'),
    "arrays": ('"npy"', 'or "zarr": of outputs with more than 12 numbers'),
    "plots": ("true", ""),
}
EXAMPLES = {"point": "[0.2, 0.05, 0.2]", "count": "3"}


def sweep_template(scene: str = "scene.toml") -> str:
    """A sweep of that scene, with all other keys in comments."""
    settings = dict(SWEEP)
    settings["engine"] = '"auto"', f"or {', '.join(ENGINES.words())}"
    parts = [
        "# A sweep with every key that `jaxfem sweep` reads; what is in comments may be left out.",
        "",
        line("scene", f'"{scene}"', "what runs; its values where nothing varies"),
        *table("[sweep]", sweep_files.SWEEP_KEYS, settings, ("kind", "count", "seed")),
        "",
        "[values]                        # names as Python reaches a number in params",
        line("young", '[1e5, 1e6, "log"]', "low, high, even shares of each decade; of a grid the values themselves"),
        line('"gravity[2]"', "[-12.0, -8.0]", "an entry"),
        line("# 'young[\"block\"]'", "[1e5, 1e6]", "of one body"),
        line("# dt", "[0.002, 0.005]", "s; also joints, contacts, rigid, loads, motions, state"),
        line('# "contact.floor.friction"', "[0.1, 0.5]", "and other paths of fits"),
        "",
        "[outputs]",
        *_outputs(),
        *table("[output]", sweep_files.OUTPUT_KEYS, OUTPUT, ("folder",)),
    ]
    return "\n".join(parts) + "\n"


def _outputs() -> list[str]:
    taken = f"take: {', '.join(TAKEN)} of the saved frames"
    lines = []
    for word in OUTPUTS.words():
        fields = "".join(f", {key} = {EXAMPLES[key]}" for key in inputs_of(OUTPUTS[word].made))
        on, name = "" if word in ("point", "energies") else "# ", "tip" if word == "point" else word
        take = ', take = "max"' if word == "energies" else ', take = "all"' if word in ("positions", "rigid") else ""
        lines.append(line(f"{on}{name}", f'{{ kind = "{word}"{fields}{take} }}', taken if word == "energies" else ""))
    return lines
