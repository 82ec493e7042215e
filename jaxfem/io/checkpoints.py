"""Where a run stood at its last frame, to go on from there: the whole state, and what was written by then."""

import csv
import hashlib
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxfem.io.scene_files import SceneFileError
from jaxfem.model import Model, Params, State
from jaxfem.pytrees import with_keys, without_keys
from jaxfem.stepping import rollout


def checkpoint_path(index: Path) -> Path:
    """Beside the index of frames."""
    return index.with_suffix(".state.npz")


def scene_mark(model: Model, params: Params) -> str:
    """A word that builds share whose scenes are equal, in kinds and in numbers: shapes, laws, loads, joints, contacts
    and their places, the time scheme.

    What a method prepares, its settings and tolerance, and how long and how often a run is written are not in it.
    """
    parts = model.joints, model.contacts, model.rigid, model.loads, model.driven, model.scheme
    told = params, model.rest, model.free, model.elements.cells, parts
    kinds = jax.tree.structure((told, model.domains)), model.laws, model.rotation_kind, model.mass, model.bodies
    words = _SET.sub(lambda held: str(sorted(held[1].split(", "))), _PLACE.sub("", str(kinds)))
    found = hashlib.sha256(words.encode())
    for key, leaf in jax.tree_util.tree_flatten_with_path(told)[0]:
        found.update(jax.tree_util.keystr(key).encode())
        found.update(np.ascontiguousarray(leaf).tobytes())
    return found.hexdigest()


_PLACE = re.compile(r" at 0x[0-9a-f]+")
"""Where an object stands in memory: of functions, as a signed distance, only the name is known."""
_SET = re.compile(r"frozenset\(\{([^{}]*)\}\)")
"""What each process writes in an order of its own."""


def save_checkpoint(path: Path, state: State, done: int, dt: float, frames: int, mark: str = "") -> None:
    """Write the state after `done` steps of `dt` [s], when `frames` frames were written. Replaces the last at once.

    `mark`: the scene's, see `scene_mark`.
    """
    leaves = jax.tree_util.tree_flatten_with_path(without_keys(state))[0]
    names = np.array([jax.tree_util.keystr(key) for key, _ in leaves])
    arrays = {f"leaf_{number}": np.asarray(leaf) for number, (_, leaf) in enumerate(leaves)}
    temporary = path.with_name(path.name + ".part.npz")
    np.savez(temporary, names=names, done=done, dt=dt, frames=frames, mark=mark, **arrays)  # type: ignore[arg-type]
    temporary.replace(path)


def load_checkpoint(
    path: Path, model: Model, params: Params, state: State, dt: float, mark: str = ""
) -> tuple[State, int, int]:
    """(state, steps done, frames written) of an earlier run of the same scene. SceneFileError where it is another, or
    one with other numbers: another `mark`."""
    if not path.is_file():
        raise SceneFileError(f"there is no {path} to go on from: the run was not begun, or by an older version")
    stood: Any = jax.eval_shape(lambda given: rollout(model, params, given, dt, 1)[0], state)
    wanted = jax.tree_util.tree_flatten_with_path(jax.eval_shape(without_keys, stood))[0]
    with np.load(path) as saved:
        names = [jax.tree_util.keystr(key) for key, _ in wanted]
        leaves = [saved[f"leaf_{number}"] for number in range(len(saved["names"]))]
        same = saved["names"].tolist() == names and all(
            leaf.shape == each.shape[1:] and leaf.dtype == each.dtype
            for leaf, (_, each) in zip(leaves, wanted, strict=True)
        )
        if int(saved["done"]) == 0:  # nothing but the start was written
            return state, 0, int(saved["frames"])
        same &= "mark" not in saved or str(saved["mark"]) in ("", mark)
        if not same or float(saved["dt"]) != dt:
            raise SceneFileError(
                f"{path} is of another scene, time step, method or precision, or numbers in the scene were "
                "changed: give --force to begin anew, or --out FOLDER"
            )
        found: State = jax.tree.map(with_keys, jax.tree.unflatten(jax.tree.structure(stood), leaves), stood)
        return found, int(saved["done"]), int(saved["frames"])


def listed_frames(index: Path) -> list[tuple[float, Path, dict[str, Path]]]:
    """(time [s], path, parts by name) of each frame that an index lists."""
    found: list[tuple[float, Path, dict[str, Path]]] = []
    for entry in ET.parse(index).getroot().iter("DataSet"):
        path = index.parent / entry.attrib["file"]
        if entry.attrib.get("part", "0") == "0":
            found.append((float(entry.attrib["timestep"]), path, {}))
        else:
            found[-1][2][entry.attrib["name"]] = path
    return found


def table_head(path: Path) -> list[str]:
    """Names of a table's columns."""
    with open(path, newline="", encoding="utf-8") as file:
        return next(csv.reader(file), [])


def trimmed_table(path: Path, until: float) -> tuple[list[str], np.ndarray]:
    """Head and numbers of a table of a run, once all later than the time `until` [s] has been cut off the file."""
    with open(path, newline="", encoding="utf-8") as file:
        head, *lines = list(csv.reader(file))
    whole = [line for line in lines if len(line) == len(head)]  # the last may be cut
    lines = [line for line in whole if float(line[0]) <= until * (1 + 1e-8)]
    with open(path, "w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([head, *lines])
    return head, np.array([[float(value) for value in line] for line in lines]).reshape(-1, len(head))
