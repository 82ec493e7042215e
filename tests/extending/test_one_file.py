"""Files to touch: a copy of the package, one new file in the folder of its kind, and a scene file that names it."""

import os
import pathlib
import shutil
import subprocess
import sys

import pytest

import jaxfem as jf

MATERIAL = """
from jaxfem.materials.base import Material
from jaxfem.materials.constants import Constant
from jaxfem.materials.moduli import eigenstiffness


class Cork(Material, word="cork"):
    \"\"\"Linear, of Poisson's ratio zero.\"\"\"

    constants = (Constant("modulus", "Pa", "must be > 0 Pa", low=0.0),)

    def stiffness(self, values):
        return eigenstiffness(values["modulus"], 0.0)
"""
SCHEME = """
from typing import ClassVar

from jaxfem.schemes.backward_euler import BackwardEuler


class Explicit(BackwardEuler):
    \"\"\"Not what it says.\"\"\"

    name: ClassVar[str] = "explicit"
"""
METHOD = """
import dataclasses
from typing import ClassVar

from jaxfem.methods.nodes.method import Condensed


@dataclasses.dataclass(frozen=True)
class Own(Condensed):
    \"\"\"The condensed method under another name.\"\"\"

    name: ClassVar[str] = "own"
"""
JOINT = """
from dataclasses import field
from typing import Any

from jaxfem.declared.joints.base import Joint, Part
from jaxfem.inputs import Vector, takes
from jaxfem.rows.locks import PointLock


class Peg(Joint, kind="peg"):
    \"\"\"A point of each body.\"\"\"

    place: Any = field(default=None, metadata=takes(Vector("m")))

    def parts(self, bodies, where):
        ends = bodies.point(self.a, self.place, where), bodies.point(self.b, self.place, where)
        yield Part("point", PointLock(*ends), self.softness)
"""
SHAPE = """
from dataclasses import field
from typing import Any

from jaxfem.inputs import Number, takes
from jaxfem.rigid.shapes.base import Shape


class Level(Shape, word="level"):
    \"\"\"Level ground at a height.\"\"\"

    height: Any = field(metadata=takes(Number("m")))

    def distance(self, point):
        return point[2] - self.height
"""
LOAD = """
from typing import Any

import numpy as np

from jaxfem.declared.loads.base import Load, Loaded, weighted


class Shared(Load, kind="shared"):
    \"\"\"One force, shared by some nodes.\"\"\"

    nodes: Any
    total: Any

    place = "nodes"
    amount = "total"
    unit = "N"

    def resolved(self, body: Loaded, offset: int, dtype: Any) -> Any:
        nodes = body.nodes_of("load", self.nodes)
        return weighted(nodes + offset, np.full(len(nodes), 1 / len(nodes)), dtype)
"""
BODY = "[[body]]\nmesh = { box = [1, 1, 1], cells = 1 }\ndensity = 1e3\n"
LINEAR = BODY + "young = 1e5\npoisson = 0.3\n"
TIME = "[time]\nstep = 0.01\nsteps = 1\n"
BALL = '[[rigid]]\nname = "ball"\nshape = { sphere = 0.1 }\nmass = 1.0\n'
CASES = {
    "materials": (MATERIAL, TIME + BODY + 'material = "cork"\nmodulus = 1e5\n', "params.modulus"),
    "schemes": (SCHEME, TIME + 'scheme = "explicit"\n' + LINEAR, "model.scheme.order"),
    "methods": (METHOD, TIME + '[solver]\nmethod = "own"\n' + LINEAR, "model.method.name"),
    "declared/joints": (
        JOINT,
        TIME + BALL + '[[joint]]\nkind = "peg"\nb = "ball"\nplace = [0, 0, 0.1]\n',
        "model.joints['point world-rigid']",
    ),
    "declared/loads": (
        LOAD,
        TIME + LINEAR + "[[body.load]]\nkind = 'shared'\nnodes = 'x+'\nvalue = [1, 2, 3]\n",
        "model.loads[0].weights.sum() == 1 and params.loads[0]",
    ),
    "rigid/shapes": (
        SHAPE,
        TIME + BALL + '[[contact]]\na = "ball"\nground = { level = -0.2 }\nfriction = 0.0\n',
        "model.contacts['smooth rigid-ground level']",
    ),
}


@pytest.mark.parametrize("folder", CASES)
def test_one_new_file_is_enough(folder, tmp_path):
    source, scene, found = CASES[folder]
    package = tmp_path / "jaxfem"
    shutil.copytree(pathlib.Path(jf.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    (package / folder / "brand_new.py").write_text(f'"""New."""\n{source}')
    (tmp_path / "scene.toml").write_text(scene)
    code = f"from jaxfem.io import load_scene; model, params, state = load_scene('scene.toml').build(); print({found})"
    alone = {**os.environ, "JAX_ENABLE_X64": "1", "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=alone, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.strip()
