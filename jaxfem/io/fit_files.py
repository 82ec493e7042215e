"""Fit files in TOML: which scene, which recording, where the markers sit, and how to fit. What `jaxfem fit` reads."""

import dataclasses
import difflib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxfem.fitting.engines import AUTO, ENGINES
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.fields import KINDS
from jaxfem.fitting.measurement import COMPARISONS, FRAMES
from jaxfem.fitting.moduli import MODULI
from jaxfem.fitting.noise import CORRELATIONS, LOSSES, Noise
from jaxfem.fitting.priors import Gaussian, LogNormal
from jaxfem.fitting.recovery import CHECKS
from jaxfem.fitting.silicones import FACTOR, silicone
from jaxfem.fitting.unknowns import known_constants, usual_names
from jaxfem.io.fit_beside import beside_of
from jaxfem.io.scene_files import SceneFile, load_scene
from jaxfem.io.toml_tables import SceneFileError, Table, is_number, read_toml, suggestion

TOP_KEYS = ("scene", "recording", "take", "markers", "clamp", "beside", "fit", "output")
SEARCH_KEYS = ("multi_start", "seed", "windows", "max_memory", "places", "engine")
PLAIN_KEYS = ("parameters", "frame", "compare", "release", "end", "substeps", "sigma", "checks", "own", *SEARCH_KEYS)
TABLES = ("noise", "priors", "bounds", "starts", "field")
FIT_KEYS = (*PLAIN_KEYS, *TABLES)
NOISE_KEYS = ("correlation", "loss", "groups", "known")
FIELD_KEYS = ("constant", "jump", "kind")
TAKE_KEYS = ("name", "recording", "scene", "held_out", "release", "end", "beside")
RECORDING_KEYS = ("file", "unit", "rate", "camera")
OUTPUT_KEYS = ("folder",)


@dataclasses.dataclass(frozen=True)
class FitFile:
    """A fit as its file says: `scene`, path of the `recording` (None: to be named on the command line) and how it is
    read (`reading`: unit, rate, camera), `places` of the
    markers on the body [m], `substeps` a sample (None: the scene's time step), `settings` of `jaxfem.fit_takes`,
    `cutting` of each `Take` (frame, compare, release, end, clamp, beside), `folder`; `takes`: those of
    [[take]] tables, if any; `field`: constant, jump and kind of [fit.field], None without."""

    scene: SceneFile
    recording: Path | None
    reading: dict[str, Any]
    places: dict[str, Any]
    substeps: int | None
    settings: dict[str, Any]
    cutting: dict[str, Any]
    folder: Path
    source: Path
    takes: tuple["TakeEntry", ...] = ()
    field: dict[str, Any] | None = None


@dataclasses.dataclass(frozen=True)
class TakeEntry:
    """One [[take]]: its `name`, `scene`, `recording` and how that is read, whether it is `held_out`, `cutting`."""

    name: str
    scene: SceneFile
    recording: Path
    reading: dict[str, Any]
    held_out: bool
    cutting: dict[str, Any]


def load_fit(path: Any) -> FitFile:
    """Read a fit file. Relative paths in it start at its folder.

    Top level: `scene`, `recording`, a path or { file, unit, rate, camera } for what the file leaves open; [markers]
    NAME = [x, y, z] (m, on the undeformed body) or { body, at } on a rigid one; [clamp] NAME = [x, y, z] of markers
    that tell the frame alone; [[beside]] kind, values, sigma and more, of what else was measured; [fit] parameters,
    frame, compare, release, end, substeps, sigma, checks, own, multi_start, seed, windows, max_memory, places,
    engine, [fit.noise] correlation, loss, groups, known, [fit.priors] NAME = { mean, deviation }, { median, factor } or
    { silicone }, [fit.bounds] NAME = [low, high], [fit.starts] NAME = [value, ...],
    [fit.field] constant, jump, kind; instead of `recording` several [[take]] tables: name, recording, scene, held_out,
    release, end, and its own [[take.beside]]; [output] folder.
    FileNotFoundError for a missing file; SceneFileError for everything that is wrong.
    """
    source = Path(path)
    values = read_toml(source)
    try:
        top = Table(values, "the top level", TOP_KEYS)
        scene_path = source.parent / top.text("scene")
        table = top.table("fit", FIT_KEYS, "[fit]")
        recording, reading = _recording(top)
        output = top.table("output", OUTPUT_KEYS, "[output]")
        places, substeps = _places(top), table.integer("substeps", None)
    except SceneFileError as problem:
        raise SceneFileError(f"{source}: {problem}") from problem
    scene = load_scene(scene_path)
    try:
        settings, cutting = _settings(table, scene), _cutting(table)
        cutting |= {"clamp": _clamp(top), "beside": beside_of(top, "")}
        if cutting["beside"] and "take" in top:
            raise SceneFileError("[[beside]] stands beside [[take]] tables: give each take its own [[take.beside]]")
        takes = _takes(top, source.parent, scene, cutting)
        field = _field(table)
        settings["held_out"] = tuple(each.name for each in takes if each.held_out)
    except SceneFileError as problem:
        raise SceneFileError(f"{source}: {problem}") from problem
    return FitFile(
        scene=scene,
        recording=None if recording is None else source.parent / recording,
        reading=reading,
        places=places,
        substeps=substeps,
        settings=settings,
        cutting=cutting,
        takes=takes,
        field=field,
        folder=source.parent / output.text("folder", f"{source.stem}_fit"),
        source=source,
    )


def _recording(top: Table) -> tuple[str | None, dict[str, Any]]:
    """The recording's path, and what is said of how to read it."""
    if not isinstance(top.get("recording", None), dict):
        return top.text("recording", None), {}
    table = top.table("recording", RECORDING_KEYS, "[recording]")
    reading = {
        "unit": table.text("unit", None),
        "rate": table.number("rate", None, unit="1/s", positive=True),
        "camera": table.grid("camera", None, what="numbers, three rows of four"),
    }
    return table.text("file"), reading


def _places(top: Table) -> dict[str, Any]:
    markers = top.table("markers", None, "[markers]")
    if not markers.values:
        raise SceneFileError("[markers] is missing or empty: give each marker's place, like tip = [0.1, 0.015, 0.03]")
    return {name: _place(markers, name) for name in markers.values}


def _place(markers: Table, name: str) -> Any:
    """A place, or the name of a rigid body and a place on it."""
    if not isinstance(markers.get(name), dict):
        return markers.vector(name, unit="m")
    table = markers.table(name, ("body", "at"), f"[markers] {name}")
    return table.text("body"), table.vector("at", unit="m")


def _clamp(top: Table) -> dict[str, Any] | None:
    clamp = top.table("clamp", None, "[clamp]")
    return {name: clamp.vector(name, unit="m") for name in clamp.values} or None


def _settings(table: Table, scene: SceneFile) -> dict[str, Any]:
    parameters = _parameters(table, scene)
    settings: dict[str, Any] = {
        "parameters": parameters,
        "noise": _noise(table),
        "priors": _priors(_of_fitted(table, "priors", parameters)),
        "own": table.get("own", ["delay"]),
        "checks": table.choice("checks", CHECKS, "refuse"),
        "multi_start": table.count("multi_start", 0),
        "seed": table.count("seed", 0),
        "windows": table.integer("windows", 1),
        "max_memory": table.number("max_memory", None, unit="GB", positive=True),
        "places": table.number("places", None, unit="m", positive=True),
        "engine": table.choice("engine", (AUTO, *ENGINES), AUTO),
    }
    bounds = _of_fitted(table, "bounds", parameters)
    settings["bounds"] = {name: bounds.vector(name, length=2) for name in bounds.values}
    settings["starts"] = _starts(_of_fitted(table, "starts", parameters))
    return settings


def _of_fitted(table: Table, key: str, parameters: Sequence[str]) -> Table:
    """The table [fit.KEY], which may speak of what is fitted: parameters, those that each take has for itself, and
    shifts of markers."""
    found = table.table(key, None, f"[fit.{key}]")
    own = tuple(f"{name}_" for name in parameters if name in table.get("own", ["delay"]))
    for name in found.values:
        if name not in parameters and not name.startswith(("marker.", *own)):
            near = difflib.get_close_matches(name, parameters, 1)
            hint = f"did you mean {near[0]!r}?" if near else "add it to parameters, or leave it out here"
            raise SceneFileError(f"{name!r} in [fit.{key}] is not fitted (parameters: {', '.join(parameters)}): {hint}")
    return found


def _field(table: Table) -> dict[str, Any] | None:
    """The constant that is found element by element, where one is."""
    if "field" not in table:
        return None
    own = table.table("field", FIELD_KEYS, "[fit.field]")
    jump = own.number("jump", 1.2)
    if not jump > 1:
        raise own.wrong("jump", "the factor by which neighbours usually differ, above 1, like 1.2")
    return {"constant": own.text("constant"), "jump": jump, "kind": own.choice("kind", KINDS, KINDS[0])}


def _cutting(table: Table) -> dict[str, Any]:
    """How a recording is cut and compared."""
    return {
        "frame": table.choice("frame", FRAMES, "none"),
        "compare": table.choice("compare", COMPARISONS, "displacement"),
        "release": _time(table, "release", "auto", "auto"),
        "end": _time(table, "end", None, "settled"),
    }


def _noise(table: Table) -> Noise:
    sigma = table.number("sigma", None, unit="m", positive=True)
    own = table.table("noise", NOISE_KEYS, "[fit.noise]")
    try:
        return Noise(
            sigma=sigma,
            known=own.flag("known", False),
            groups=own.get("groups", "all"),
            correlation=own.choice("correlation", CORRELATIONS, "effective"),
            loss=own.choice("loss", tuple(LOSSES), "square"),
        )
    except FitError as problem:
        raise SceneFileError(f"[fit.noise]: {problem}") from problem


def _priors(table: Table) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name in table.values:
        own = table.table(name, ("mean", "deviation", "median", "factor", "silicone"), f"[fit.priors] {name}")
        try:
            if "silicone" in own:
                found[name] = silicone(own.text("silicone"), name, own.number("factor", FACTOR))
            elif "median" in own:
                found[name] = LogNormal(own.number("median"), own.number("factor"))
            else:
                found[name] = Gaussian(own.number("mean"), own.number("deviation"))
        except FitError as problem:
            raise SceneFileError(f"[fit.priors] {name}: {problem}") from problem
    return found


def _takes(top: Table, folder: Path, scene: SceneFile, cutting: dict[str, Any]) -> tuple[TakeEntry, ...]:
    """The [[take]] tables; none where there is one recording."""
    found = []
    for number, values in enumerate(top.tables("take", "take")):
        table = Table(values, f"[[take]] {number + 1}", TAKE_KEYS)
        path, reading = _recording(table)
        if path is None:
            raise SceneFileError(f'[[take]] {number + 1} names no recording: add recording = "FILE.csv"')
        own = table.text("scene", None)
        changed = {key: value for key, value in _cutting(table).items() if key in table}
        changed["beside"] = beside_of(table, "take.")
        found.append(
            TakeEntry(
                name=table.text("name", Path(path).stem),
                scene=scene if own is None else load_scene(folder / own),
                recording=folder / path,
                reading=reading,
                held_out=table.flag("held_out", False),
                cutting={**cutting, **changed},
            )
        )
    if found and "recording" in top:
        raise SceneFileError("recording is given beside [[take]] tables: leave it out, or make it a take")
    return tuple(found)


def _parameters(table: Table, scene: SceneFile) -> tuple[str, ...]:
    constants = scene.constants
    names = table.get("parameters", list(usual_names(constants)))
    if not (isinstance(names, list) and names and all(isinstance(name, str) for name in names)):
        raise table.wrong("parameters", 'a list of names, like ["young", "damping"]')
    known = known_constants(constants)
    for name in names:  # paths are looked up where the scene is built
        if name not in known and "." not in name and name not in MODULI:
            raise SceneFileError(f"unknown parameter {name!r} in [fit]{suggestion(name, known)}")
    return tuple(names)


def _time(table: Table, key: str, default: Any, word: str) -> Any:
    value = table.get(key, default)
    if key in table and not (is_number(value) or value == word):
        raise table.wrong(key, f'a time in s, or "{word}"')
    return float(value) if is_number(value) else value


def _starts(table: Table) -> list[dict[str, float]] | None:
    """One dictionary a starting point: the lists of all parameters side by side."""
    lists = {}
    for name, value in table.values.items():
        lists[name] = value if isinstance(value, list) else [value]
        if not (lists[name] and all(is_number(each) for each in lists[name])):
            raise table.wrong(name, "a number, or a list of numbers, one for each starting point")
    lengths = {len(each) for each in lists.values()}
    if len(lengths) > 1:
        raise SceneFileError(f"the lists of {table.where} differ in length: give each one number a starting point")
    if not lists:
        return None
    return [dict(zip(lists, point, strict=True)) for point in zip(*lists.values(), strict=True)]
