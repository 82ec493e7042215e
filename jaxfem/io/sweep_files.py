"""Sweep files in TOML: which scene, which values, what is kept. What `jaxfem sweep` reads."""

import dataclasses
import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxfem.inputs import REQUIRED, inputs_of
from jaxfem.io.scene_files import SceneFile, load_scene
from jaxfem.io.toml_tables import SceneFileError, Table, is_number, read_toml
from jaxfem.sweeping.chunks import AUTO
from jaxfem.sweeping.engines import ENGINES
from jaxfem.sweeping.indices import sobol
from jaxfem.sweeping.merging import ARRAYS, TABLES
from jaxfem.sweeping.outputs import OUTPUTS
from jaxfem.sweeping.samples import Variants, grid, latin_hypercube, random, table
from jaxfem.sweeping.shards import digest
from jaxfem.sweeping.taking import TAKEN, Taken

TOP_KEYS = ("scene", "sweep", "values", "outputs", "output")
SWEEP_KEYS = ("kind", "count", "seed", "table", "engine", "width", "processes", "derivatives")
OUTPUT_KEYS = ("folder", "table", "arrays", "plots")
KINDS = ("grid", "random", "latin_hypercube", "sobol", "table")
DRAWN = ("random", "latin_hypercube", "sobol")
TABLE, COUNT = "table", "count"


@dataclasses.dataclass(frozen=True)
class SweepFile:
    """A sweep as its file says: `scene`, `variants` (name -> (V, ...)), `outputs`, whether there are `indices`, the
    `engine`, `width` of a chunk (None: what suits), `processes` (None: one a core), variables of `derivatives`, the
    `folder`, kinds of `table` and `arrays`, whether there are `plots`, and a `digest` of all that numbers depend on."""

    scene: SceneFile
    variants: Variants
    outputs: dict[str, Taken]
    seed: int
    indices: bool
    engine: str
    width: int | None
    processes: int | None
    derivatives: tuple[str, ...]
    folder: Path
    table: str
    arrays: str
    plots: bool
    digest: str
    source: Path


def load_sweep(path: Any) -> SweepFile:
    """Read a sweep file. Relative paths in it start at its folder.

    Top level: `scene`; [sweep] kind, count, seed, table, engine, width, processes, derivatives; [values] NAME = list of
    values (a grid), or [low, high], or [low, high, "log"]; [outputs] NAME = a word, or { kind, take, ... }; [output]
    folder, table, arrays, plots. FileNotFoundError for a missing file, SceneFileError for what is wrong.
    """
    source = Path(path)
    values = read_toml(source)
    try:
        top = Table(values, "the top level", TOP_KEYS)
        scene_path, settings = source.parent / top.text("scene"), top.table("sweep", SWEEP_KEYS, "[sweep]")
        output = top.table("output", OUTPUT_KEYS, "[output]")
        made: dict[str, Any] = {
            "variants": _variants(settings, top.table("values", None, "[values]"), source.parent),
            "outputs": _outputs(top.table("outputs", None, "[outputs]")),
            "seed": _seed(settings),
            "indices": settings.choice("kind", KINDS) == "sobol",
            "engine": settings.choice("engine", (AUTO, *ENGINES.words()), AUTO),
            "width": settings.integer("width", None),
            "processes": settings.integer("processes", None),
            "derivatives": _derivatives(settings),
            "folder": source.parent / output.text("folder", f"{source.stem}_results"),
            "table": output.choice("table", TABLES, "csv"),
            "arrays": output.choice("arrays", ARRAYS, "npy"),
            "plots": output.flag("plots", True),
        }
    except SceneFileError as problem:
        raise SceneFileError(f"{source}: {problem}") from problem
    scene = load_scene(scene_path)
    how = made["engine"], made["width"], *made["derivatives"]
    # Meshes, motions and heights come from files of their own, of which the scene's text has the names alone.
    read = hashlib.sha256(b"".join(_numbers(scene.scene))).hexdigest()
    words = repr((scene_path.read_text(encoding="utf-8"), read, values.get("outputs"), *how))
    return SweepFile(scene=scene, source=source, digest=digest(words, made["variants"]), **made)


def _numbers(value: Any) -> Iterator[bytes]:
    """All arrays of what was declared, one after another."""
    if dataclasses.is_dataclass(value):
        value = [getattr(value, each.name) for each in dataclasses.fields(value)]
    elif isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, list | tuple):
        for each in value:
            yield from _numbers(each)
    elif isinstance(value, np.ndarray | jax.Array):
        yield np.asarray(value).tobytes()


def _derivatives(settings: Table) -> tuple[str, ...]:
    names = settings.get("derivatives", [])
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise settings.wrong("derivatives", 'a list of names of [values], like ["young"]')
    return tuple(names)


def _seed(settings: Table) -> int:
    value = settings.get("seed", 0)
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise settings.wrong("seed", "a whole number, at least 0")
    return value


def _variants(settings: Table, values: Table, folder: Path) -> Variants:
    kind = settings.choice("kind", KINDS)
    _used(settings, kind, TABLE, kind == TABLE)
    _used(settings, kind, COUNT, kind in DRAWN)
    if kind == TABLE:
        if values.values:
            raise SceneFileError(f'[values] has no use with kind = "{kind}", whose file has them: remove it')
        return table(folder / settings.text(TABLE))
    if not values.values:
        raise SceneFileError('[values] is missing or empty: name what varies, like young = [1e5, 1e6, "log"]')
    for name, given in values.values.items():
        numbers = given[:-1] if isinstance(given, list) and kind != "grid" and given[-1:] == ["log"] else given
        if not (isinstance(numbers, list) and numbers and all(is_number(each) for each in numbers)):
            raise values.wrong(
                name, "a list of finite numbers" if kind == "grid" else 'two numbers, low and high, or with "log"'
            )
    if kind == "grid":
        return grid(values.values)
    draw = {"random": random, "latin_hypercube": latin_hypercube, "sobol": sobol}[kind]
    return draw(values.values, settings.integer(COUNT), _seed(settings))


def _used(settings: Table, kind: str, key: str, used: bool) -> None:
    if key in settings and not used:
        raise SceneFileError(f'{key!r} in {settings.where} has no use with kind = "{kind}": remove it')


def _outputs(given: Table) -> dict[str, Taken]:
    if not given.values:
        raise SceneFileError(
            f"[outputs] is missing or empty: name what is kept; kinds are {', '.join(OUTPUTS.words())}"
        )
    return {name: _output(given, name) for name in given.values}


def _output(given: Table, name: str) -> Taken:
    where, raw = f"{name} of [outputs]", given.values[name]
    raw = {"kind": raw} if isinstance(raw, str) else raw
    word = Table(raw, where, None).choice("kind", OUTPUTS.words())
    made = OUTPUTS[word].made
    fields = inputs_of(made)
    own = Table(raw, where, ("kind", "take", *fields))
    how = own.choice("take", tuple(TAKEN), "last")
    defaults = {each.name: each.default for each in dataclasses.fields(made)}  # type: ignore[arg-type]
    values = {}
    for key, each in fields.items():
        default = REQUIRED if defaults[key] is dataclasses.MISSING else defaults[key]
        values[key] = each.read(own, key, default, None)  # type: ignore[arg-type]
    return Taken(made(**values), how)
