"""Wavefront .obj surfaces: points and faces only, so that files with normals and textures of any count can be read."""

from itertools import pairwise
from pathlib import Path

import numpy as np

from ..checks import MeshError
from ..raw import RawMesh


def read_obj(path: Path) -> RawMesh:
    """The surface of an .obj file, faces with more than three corners cut into a fan of triangles."""
    points: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    for number, line in enumerate(path.read_text(errors="replace").splitlines(), start=1):
        words = line.partition("#")[0].split()
        try:
            if words[:1] == ["v"]:
                points.append([float(word) for word in words[1:4]])
            elif words[:1] == ["f"]:
                corners = [int(word.partition("/")[0]) for word in words[1:]]
                # -1 is the last point so far
                corners = [each - 1 if each > 0 else len(points) + each for each in corners]
                triangles += [(corners[0], b, c) for b, c in pairwise(corners[1:])]
        except ValueError as problem:
            raise MeshError(f"cannot read {path}, line {number}: {problem}") from problem
    places = np.array(points, dtype=np.float64)
    if places.ndim != 2 or places.shape[1] != 3:
        raise MeshError(f"cannot read {path}: its lines v do not hold three coordinates each")
    faces = np.array(triangles, dtype=np.int64).reshape(-1, 3)
    if len(faces) and (faces.min() < 0 or faces.max() >= len(places)):
        raise MeshError(f"cannot read {path}: a face uses a point that does not exist (there are {len(places)})")
    return RawMesh(places, [("triangle", faces)])
