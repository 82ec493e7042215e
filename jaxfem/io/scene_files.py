"""Scenes in TOML files: what `jaxfem simulate` reads. Everything is checked here, and refused by name."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxfem.building import ROTATION_UPDATES, build, more_constants
from jaxfem.declared.scene import Scene
from jaxfem.elements.mass import MASSES, MassKind
from jaxfem.io.fields import FIELDS
from jaxfem.io.scene_bodies import body_keys, read_body
from jaxfem.io.scene_coupling import CONTACT_KEYS, RIGID_KEYS, SceneSources, read_contact, read_joint, read_rigid
from jaxfem.io.toml_tables import SceneFileError, Table, read_toml
from jaxfem.materials.constants import DENSITY, Constant
from jaxfem.methods import METHODS, Method
from jaxfem.model import Model, Params, State
from jaxfem.schemes import SCHEMES, Scheme
from jaxfem.stepping.checks import MOST_HALVINGS

__all__ = ["SceneFile", "SceneFileError", "load_scene"]

TOP_KEYS = ("gravity", "time", "solver", "body", "rigid", "joint", "contact", "output", "compare")
TIME_KEYS = ("step", "duration", "steps", "save_every", "halvings", "scheme", "mass", "rotation_update")
SOLVER_KEYS = ("method", "tolerance", "max_iterations", "precision")
OUTPUT_KEYS = ("folder", "points", "tensors", "fields")
COMPARE_KEYS = ("methods", "step_factors", "tolerances", "finer")
"""Of [compare], which `jaxfem compare` reads; all else that reads the scene leaves them alone."""
PRECISIONS = ("float64", "float32")


@dataclasses.dataclass(frozen=True)
class SceneFile:
    """A scene and how to run it, as its file says.

    `dt` [s], `steps`, `every`: steps a saved frame; `halvings`: how often a step that fails is halved (0: not at all);
    `solver`, `scheme`, `mass`, `rotation_update`, `tolerance`, `max_iterations` as for `jaxfem.build`; `precision`:
    "float64" or "float32"; `folder`: where results go; `points`: name -> (x, y, z) [m] of a material point of the
    undeformed bodies whose path is recorded; `tensors`: whether frames hold stress and strain as tensors; `fields`:
    names of what frames hold, None for all; `source`: the file.
    """

    scene: Scene
    dt: float
    steps: int
    every: int
    halvings: int
    solver: str | Method
    scheme: Scheme
    mass: MassKind
    rotation_update: str
    tolerance: float | None
    max_iterations: int
    precision: str
    folder: Path
    points: dict[str, tuple[float, float, float]]
    tensors: bool
    fields: tuple[str, ...] | None
    source: Path

    @property
    def duration(self) -> float:
        """Simulated time [s]."""
        return self.dt * self.steps

    @property
    def constants(self) -> tuple[Constant, ...]:
        """The constants of the soft bodies' materials, then density."""
        own = [each for body in self.scene.soft for each in body.made_of.constants]
        return (*dict.fromkeys(own), *more_constants(self.scene.soft), DENSITY)

    def build(self) -> tuple[Model, Params, State]:
        """Model, params and state in the file's precision; errors and warnings as for `jaxfem.build`."""
        return build(
            self.scene,
            solver=self.solver,
            scheme=self.scheme,
            mass=self.mass,
            rotation_update=self.rotation_update,
            dtype=self.precision,
            tolerance=self.tolerance,
            max_iterations=self.max_iterations,
        )


def load_scene(path: Any, also: Sequence[str] = (), finer: bool = False) -> SceneFile:
    """Read a scene file. Relative paths in it start at its folder.

    `also`: further top-level keys that the caller reads by itself. `finer`: meshes of soft bodies refined, each element
    in eight. FileNotFoundError for a missing scene or mesh file;
    SceneFileError, SceneError, MaterialError or MeshError for what is wrong in them.
    """
    source = Path(path)
    values = read_toml(source)
    try:
        return _scene_file(Table(values, "the top level", (*TOP_KEYS, *also)), source, finer)
    except SceneFileError as problem:
        raise SceneFileError(f"{source}: {problem}") from problem


def _scene_file(top: Table, source: Path, finer: bool = False) -> SceneFile:
    time, scheme = _time(top)
    solver, method = _solver(top)
    output = top.table("output", OUTPUT_KEYS, "[output]")
    top.table("compare", COMPARE_KEYS, "[compare]")
    dt = time.number("step", unit="s", positive=True)
    points = output.table("points", None, "points of [output]")
    tolerance = solver.number("tolerance", None, positive=True)
    if tolerance is not None and tolerance >= 1:
        raise solver.wrong("tolerance", "a relative residual between 0 and 1, like 1e-8")
    settings: dict[str, Any] = {
        "dt": dt,
        "steps": _steps(time, dt),
        "every": time.integer("save_every", 1),
        "halvings": _halvings(time),
        "scheme": scheme,
        "mass": time.choice("mass", MASSES, "lumped"),
        "rotation_update": time.choice("rotation_update", ROTATION_UPDATES, "explicit"),
        "solver": method,
        "tolerance": tolerance,
        "max_iterations": solver.integer("max_iterations", 20_000),
        "precision": solver.choice("precision", PRECISIONS, "float64"),
        "folder": source.parent / output.text("folder", f"{source.stem}_results"),
        "points": {name: points.vector(name, unit="m") for name in points.values},
        "tensors": output.flag("tensors", False),
        "fields": _fields(output),
    }
    gravity = top.vector("gravity", (0.0, 0.0, -9.81), "m/s^2")
    return SceneFile(scene=_scene(top, source.parent, gravity, finer), source=source, **settings)


def _time(top: Table) -> tuple[Table, Scheme]:
    """The [time] table, and the scheme that it names with the numbers that it gives for it."""
    word = top.table("time", None, "[time]").choice("scheme", SCHEMES.words(), "backward_euler")
    fields = dataclasses.fields(SCHEMES[word].made)
    numbers = [field.name for field in fields]
    for name in numbers:
        if name in TIME_KEYS:
            raise SceneFileError(f'the scheme "{word}" calls a number {name!r}, a key of every [time] table: rename it')
    time = top.table("time", (*TIME_KEYS, *numbers), "[time]")
    given = {field.name: _scheme_value(time, field) for field in fields if field.name in time}
    return time, SCHEMES[word].made(**given)


def _scheme_value(time: Table, field: dataclasses.Field[Any]) -> Any:
    """A number of a scheme; where it is static, what its default is: a flag or a word."""
    if isinstance(field.default, bool):
        return time.flag(field.name)
    return time.text(field.name) if isinstance(field.default, str) else time.number(field.name)


def method_settings(word: str) -> dict[str, Any]:
    """Settings of the method `word` that files can give, each with its default: numbers, words and flags."""
    if word not in METHODS:
        return {}
    plain = (int, float, str, bool, type(None))
    fields = dataclasses.fields(METHODS[word].made)
    return {each.name: each.default for each in fields if each.init and isinstance(each.default, plain)}


def _solver(top: Table) -> tuple[Table, str | Method]:
    """The [solver] table, and the method that it names: its word, or with settings of its own the object."""
    word = top.table("solver", None, "[solver]").choice("method", ("auto", *METHODS.words()), "auto")
    settings = method_settings(word)
    for name in settings:
        if name in SOLVER_KEYS:
            raise SceneFileError(f'the method "{word}" calls a setting {name!r}, a key of every [solver]: rename it')
    solver = top.table("solver", (*SOLVER_KEYS, *settings), "[solver]")
    return solver, read_method(solver, word)


def read_method(table: Table, word: str) -> str | Method:
    """The method `word`: as it is, or with the settings of its own that the table gives the object."""
    settings = method_settings(word)
    given = {name: table.get(name) for name in settings if name in table}
    for name, value in given.items():
        if isinstance(value, dict | list):
            raise table.wrong(name, "a number, a word, or true or false")
        if isinstance(settings[name], bool) != isinstance(value, bool):
            raise table.wrong(name, "true or false" if isinstance(settings[name], bool) else "a number or a word")
    return METHODS[word].made(**given) if given else word


def _scene(top: Table, folder: Path, gravity: Any, finer: bool = False) -> Scene:
    bodies = _listed(top, "body")
    soft = [read_body(Table(values, where, body_keys(values, where)), folder, finer) for values, where in bodies]
    sources = SceneSources(folder, soft)
    rigid = [read_rigid(Table(values, where, RIGID_KEYS), sources) for values, where in _listed(top, "rigid")]
    if not soft and not rigid:
        raise SceneFileError(
            "the scene holds no body: add a table [[body]] with mesh, young, poisson and density, or a [[rigid]] one"
        )
    joints = [read_joint(values, where, sources) for values, where in _listed(top, "joint")]
    contacts = [read_contact(Table(values, where, CONTACT_KEYS), sources) for values, where in _listed(top, "contact")]
    return Scene([*soft, *rigid], gravity, joints, contacts)


def _listed(top: Table, key: str) -> list[tuple[dict[str, Any], str]]:
    """Each table of [[KEY]] with its name for messages."""
    named = []
    for number, values in enumerate(top.tables(key, key), 1):
        name = values.get("name")
        named.append((values, f"[[{key}]] {number}" + (f' "{name}"' if isinstance(name, str) else "")))
    return named


def _fields(output: Table) -> tuple[str, ...] | None:
    names = output.get("fields", None)
    if names is None:
        return None
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise output.wrong("fields", f"a list of names, of {', '.join(FIELDS)}")
    return tuple(dict.fromkeys(names))


def _halvings(time: Table) -> int:
    count: int = time.integer("halvings") if "halvings" in time else 0
    if count > MOST_HALVINGS:
        raise time.wrong("halvings", f"a whole number from 1 to {MOST_HALVINGS}, or nothing where none are wanted")
    return count


def _steps(time: Table, dt: float) -> int:
    """The number of steps, from `steps` or from `duration`, which must be a whole number of them."""
    if ("steps" in time) == ("duration" in time):
        both = "both 'steps' and 'duration'" if "steps" in time else "neither 'duration' (s) nor 'steps'"
        raise SceneFileError(f"[time] has {both}: give one of them")
    if "steps" in time:
        given: int = time.integer("steps")
        return given
    duration: float = time.number("duration", unit="s", positive=True)
    steps = round(duration / dt)
    if steps < 1 or abs(steps * dt - duration) > 1e-6 * duration:
        low = max(1, int(duration / dt))
        raise SceneFileError(
            f"'duration' in [time] is {duration:g} s, no whole number of steps of {dt:g} s: take {low * dt:g} or "
            f"{(low + 1) * dt:g} s, or give 'steps'"
        )
    return steps
