"""The [[body]] tables of a scene file: mesh, material, supports, prescribed motions and loads of a soft body."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jaxfem.declared.loads import LOADS, Load
from jaxfem.declared.scene import ROTATIONS, STRAINS, Driven, SoftBody
from jaxfem.inputs import SURFACE_KEYS
from jaxfem.io.selections import select_faces, select_nodes
from jaxfem.io.toml_tables import SceneFileError, Table, is_integer, is_number, suggestion
from jaxfem.materials.base import LAWS, Material
from jaxfem.materials.constants import DENSITY, MASS_DAMPING, Constant, MaterialError
from jaxfem.materials.linear import Linear
from jaxfem.mesh import MeshError, TetMesh, ball, beam, box, cage, from_cad, from_surface, read, read_surface, refined
from jaxfem.motion import Motion

BODY_KEYS = (
    *("name", "mesh", "position", "rotate", "material", "density", "mass_damping", "surface"),
    *("fixed", "velocity", "strain", "rotation", "driven", "load"),
)
MOTION_KEYS = ("velocity", "amplitude", "frequency", "phase", "angular_velocity", "center")
DRIVEN_KEYS = ("nodes", *MOTION_KEYS)
MESH_KEYS = {
    "file": ("scale", "merge"),
    "surface": ("scale", "size"),
    "cad": ("size", "finest"),
    "cage": ("scale", "elements", "size", "tets_per_cell"),
    "box": ("cells", "tets_per_cell", "origin"),
    "beam": ("cells_along", "tets_per_cell", "origin"),
    "ball": ("cells", "center"),
}


def body_keys(values: dict[str, Any], where: str) -> tuple[str, ...]:
    """Keys that a [[body]] table may hold: those of every body, and the constants and options of its material."""
    table = Table(values, where, None)
    law = _law(table)
    constants = law.constants_of(_options(table, law))
    for name in (*(each.name for each in constants), *law.options):
        if name in BODY_KEYS and name != DENSITY.name:
            raise SceneFileError(
                f"{law.__name__} calls a constant or option {name!r}, a key of every [[body]]: rename it"
            )
    return (*BODY_KEYS, *(each.name for each in constants), *law.options)


def _law(table: Table) -> type[Material]:
    return LAWS[table.choice("material", LAWS.words(), Linear.word)].made


def read_body(table: Table, folder: Path, finer: bool = False) -> SoftBody:
    """The soft body that a [[body]] table describes; mesh files are looked for in `folder`. `finer`: its mesh refined.

    SceneFileError names the table and the key; SceneError, MaterialError and FileNotFoundError as for `SoftBody` and
    `jaxfem.mesh.read`.
    """
    name = table.text("name", None)
    plain, skin = _mesh(table, folder), _surface(table, folder)
    mesh = _placed(table, refined(plain) if finer else plain)
    if finer and _counts_nodes(table.values):
        raise SceneFileError(
            f"{table.where} selects nodes by their numbers, which a finer mesh has more of: select them by a group, a "
            "box or a half-space"
        )
    if skin is not None:  # moved along with the mesh
        skin = _placed_points(table, skin[0]), skin[1]
    if name is not None:
        mesh = mesh.renamed(name)
    return SoftBody(
        mesh,
        density=_constant(table, mesh, DENSITY),
        mass_damping=table.number(MASS_DAMPING.name, unit=MASS_DAMPING.unit) if MASS_DAMPING.name in table else None,
        material=_material(table, mesh),
        fixed=select_nodes(table, "fixed", mesh) if "fixed" in table else None,
        driven=[_driven(values, mesh, place) for values, place in _children(table, "driven")],
        loads=[_load(values, mesh, place) for values, place in _children(table, "load")],
        velocity=table.vector("velocity", (0.0, 0.0, 0.0), "m/s"),
        strain=table.choice("strain", tuple(STRAINS), SoftBody.strain),
        rotation=table.choice("rotation", ROTATIONS, ROTATIONS[0]),
        name=name,
        surface=skin,
    )


def _counts_nodes(values: Any) -> bool:
    """Whether a table selects nodes by number somewhere."""
    if isinstance(values, list):
        return any(_counts_nodes(each) for each in values)
    if not isinstance(values, dict):
        return False
    return any((key == "nodes" and _numbers(each)) or _counts_nodes(each) for key, each in values.items())


def _numbers(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(each, int) for each in value)


def _children(table: Table, key: str) -> list[tuple[dict[str, Any], str]]:
    """Each table of [[body.KEY]] with its name for messages."""
    raw = table.tables(key, f"body.{key}")
    return [(values, f"[[body.{key}]] {number} of {table.where}") for number, values in enumerate(raw, 1)]


def _material(table: Table, mesh: TetMesh) -> Material:
    """The material that the table names, with its constants and options."""
    law = _law(table)
    options = _options(table, law)
    constants = {each.name: _constant(table, mesh, each) for each in law.constants_of(options)}
    try:
        return law(**constants, **options)
    except MaterialError as problem:
        raise SceneFileError(f"{table.where}: {problem}") from problem


def _options(table: Table, law: type[Material]) -> dict[str, Any]:
    """All options of the law, those that the table leaves out at their defaults."""
    options = {key: table.get(key) if key in table else default for key, default in law.options.items()}
    for key, value in options.items():
        if type(value) is not type(law.options[key]):
            raise table.wrong(key, f"of the kind of {law.options[key]!r}")
    return options


def _constant(table: Table, mesh: TetMesh, constant: Constant) -> Any:
    """One number, or one for each of the mesh's cell groups, spread over the elements (m,)."""
    key, unit = constant.name, constant.unit
    if key not in table and constant.default is not None:
        return constant.default
    if not isinstance(table.get(key, unit=unit), dict):
        value = table.get(key)
        if not is_number(value) and not isinstance(value, float):  # NaN goes on, to the message of its own range
            raise table.wrong(key, f"a number{' of ' + unit if unit else ''}, or one for each cell group")
        return float(value)
    groups = table.table(key, mesh.cell_groups, f"{key!r} in {table.where}, one number for each cell group")
    values = np.full(len(mesh.cells), np.nan)
    for group in groups.values:
        values[mesh.cell_groups[group]] = groups.number(group, unit=unit)
    missed = np.flatnonzero(np.isnan(values))
    if missed.size:
        raise SceneFileError(f"{groups.where} leaves out {missed.size} elements, like {missed[0]}: name their group")
    return values


def _mesh(table: Table, folder: Path) -> TetMesh:
    where = f"'mesh' in {table.where}"
    raw = table.get("mesh")
    kinds = ", ".join(MESH_KEYS)
    if not isinstance(raw, dict):
        raise table.wrong(
            "mesh", 'a table like { box = [0.1, 0.03, 0.03], cells = [10, 3, 3] } or { file = "part.msh" }'
        )
    given = [kind for kind in MESH_KEYS if kind in raw]
    if len(given) != 1:
        every = {*MESH_KEYS, *(key for keys in MESH_KEYS.values() for key in keys)}
        Table(raw, where, every)
        raise SceneFileError(f"{where} names {' and '.join(given) or 'no kind of mesh'}: give one of {kinds}")
    mesh = Table(raw, f"{where} (a {given[0]})", (given[0], *MESH_KEYS[given[0]]))
    arguments = _mesh_arguments(given[0], mesh, folder)
    makers: dict[str, Callable[..., TetMesh]] = {
        "file": read,
        "surface": _filled,
        "cad": from_cad,
        "cage": _cage,
        "box": box,
        "beam": beam,
        "ball": ball,
    }
    try:
        return makers[given[0]](**arguments)
    except MeshError as problem:
        raise SceneFileError(f"{where}: {problem}") from problem


def _mesh_arguments(kind: str, mesh: Table, folder: Path) -> dict[str, Any]:
    if kind == "file":
        return {
            "path": folder / mesh.text("file"),
            "scale": mesh.number("scale", None, positive=True),
            "merge": mesh.get("merge") if "merge" in mesh else False,
        }
    if kind == "surface":
        return {
            "path": folder / mesh.text("surface"),
            "scale": mesh.number("scale", None, positive=True),
            "size": mesh.number("size", None, unit="m", positive=True),
        }
    if kind == "cad":
        sizes = {key: mesh.number(key, None, unit="m", positive=True) for key in ("size", "finest")}
        return {"path": folder / mesh.text("cad"), **sizes}
    if kind == "cage":
        sized = {"elements": mesh.integer("elements")} if "elements" in mesh else {}
        return {
            "path": folder / mesh.text("cage"),
            "scale": mesh.number("scale", None, positive=True),
            "size": mesh.number("size", None, unit="m", positive=True),
            "tets_per_cell": mesh.integer("tets_per_cell", 6),
            **sized,
        }
    if kind == "ball":
        center = mesh.vector("center", (0.0, 0.0, 0.0), "m")
        return {
            "radius": mesh.number("ball", unit="m", positive=True),
            "cells": mesh.integer("cells"),
            "center": center,
        }
    size = mesh.vector(kind, unit="m")
    shared = {"tets_per_cell": mesh.integer("tets_per_cell", 6), "origin": mesh.vector("origin", (0.0, 0.0, 0.0), "m")}
    if kind == "beam":
        return dict(
            zip(("length", "width", "height"), size, strict=True), cells_along=mesh.integer("cells_along"), **shared
        )
    return {"size": size, "cells": _cell_counts(mesh), **shared}


def _filled(path: Path, scale: float | None, size: float | None) -> TetMesh:
    """The volume inside the surface of a file."""
    return from_surface(*read_surface(path, scale), size, path.stem)


def _cage(path: Path, scale: float | None, **how: Any) -> TetMesh:
    """Grid cells around the surface of a file."""
    return cage(*read_surface(path, scale), name=path.stem, **how)


def _surface(table: Table, folder: Path) -> tuple[np.ndarray, np.ndarray] | None:
    """The surface that a body shows: that of its `surface`, else what its cage is around; None without any."""
    if "surface" in table:
        given = table.table("surface", SURFACE_KEYS, f"'surface' in {table.where}")
        return read_surface(folder / given.text("file"), given.number("scale", None, positive=True))
    mesh = table.get("mesh")
    return read_surface(folder / mesh["cage"], mesh.get("scale")) if "cage" in mesh else None


def _cell_counts(mesh: Table) -> Any:
    counts = mesh.get("cells")
    each = counts if isinstance(counts, list) and len(counts) == 3 else [counts]
    if not all(is_integer(count) and count >= 1 for count in each):
        raise mesh.wrong("cells", "a whole number of at least 1, or a list of three")
    return counts


def _placed(table: Table, mesh: TetMesh) -> TetMesh:
    """The mesh turned (`rotate`, about its `center`, the origin by default), then moved by `position`."""
    moved = {"rotate", "position"} & {*table.values}
    return dataclasses.replace(mesh, points=_placed_points(table, mesh.points)) if moved else mesh


def _placed_points(table: Table, points: np.ndarray) -> np.ndarray:
    """Points (n, 3) turned and moved likewise."""
    if "rotate" in table:
        from scipy.spatial.transform import Rotation  # slow to import: only where a body is turned

        turn = table.table("rotate", ("axis", "degrees", "center"), f"'rotate' in {table.where}")
        axis = np.array(turn.vector("axis"))
        length = np.linalg.norm(axis)
        if length == 0:
            raise turn.wrong("axis", "a direction, not all zeros")
        matrix = Rotation.from_rotvec(axis / length * np.radians(turn.number("degrees"))).as_matrix()
        center = np.array(turn.vector("center", (0.0, 0.0, 0.0), "m"))
        points = (points - center) @ matrix.T + center
    return points + np.array(table.vector("position", unit="m")) if "position" in table else points


def _driven(values: dict[str, Any], mesh: TetMesh, where: str) -> Driven:
    table = Table(values, where, DRIVEN_KEYS)
    return Driven(select_nodes(table, "nodes", mesh), read_motion(table))


def read_motion(table: Table) -> Motion:
    """The prescribed motion whose keys a table holds."""
    zero = (0.0, 0.0, 0.0)
    return Motion(
        velocity=table.vector("velocity", zero, "m/s"),
        amplitude=table.vector("amplitude", zero, "m"),
        frequency=table.number("frequency", 0.0, "Hz"),
        phase=table.number("phase", 0.0, "rad"),
        angular_velocity=table.vector("angular_velocity", zero, "rad/s"),
        center=table.vector("center", zero, "m"),
    )


def _load(values: dict[str, Any], mesh: TetMesh, where: str) -> Load:
    word = values.get("kind")
    if not isinstance(word, str) or word not in LOADS:
        problem = f"missing key 'kind' in {where}" if word is None else f"'kind' in {where} is {word!r}"
        raise SceneFileError(problem + suggestion(str(word), LOADS.words()))
    kind = LOADS[word].made
    table = Table(values, f"{where} ({word})", ("kind", kind.place, "value"))
    amount = table.number("value", unit=kind.unit) if kind.scalar else table.vector("value", unit=kind.unit)
    return kind(**{kind.place: _place(table, kind.place, mesh), kind.amount: amount})


def _place(table: Table, key: str, mesh: TetMesh) -> Any:
    """Where a load acts: nodes, faces or a point."""
    select = {"nodes": select_nodes, "faces": select_faces}
    return select[key](table, key, mesh) if key in select else table.vector(key, unit="m")
