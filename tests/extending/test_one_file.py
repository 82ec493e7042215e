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
from typing import ClassVar

from jaxfem.methods.nodes.method import Condensed


class Own(Condensed):
    \"\"\"The condensed method under another name.\"\"\"

    name: ClassVar[str] = "own"
"""
JOINT = """
from dataclasses import field
from typing import Any

from jaxfem.declared.joints.base import Joint, Part
from jaxfem.inputs import Number, Vector, takes
from jaxfem.materials.quantities import positive
from jaxfem.pytrees import Pytree
from jaxfem.rows.attachments import Point, difference
from jaxfem.rows.locks import JointRows, Softness, spring_rows


class Rubber(Pytree):
    \"\"\"`stiffness` (m,) [N/m].\"\"\"

    stiffness: Any = field(metadata=positive("stiffness", "N/m", "stiffness of the rubber"))


class Stretched(JointRows):
    \"\"\"Two points, three equal springs between them.\"\"\"

    a: Point
    b: Point

    def rows(self, at, values, stage):
        gap = difference(self.a.placed(at), self.b.placed(at))
        soft = Softness(1 / values.stiffness, 0 * values.stiffness)
        return spring_rows(gap.position, gap.triples, gap.jacobian, soft, at, stage)


class Peg(Joint, kind="peg"):
    \"\"\"A rubber peg in a point of each body.\"\"\"

    place: Any = field(default=None, metadata=takes(Vector("m")))
    stiffness: Any = field(default=1e3, metadata=takes(Number("N/m", positive=True)))

    def parts(self, bodies, where):
        ends = bodies.point(self.a, self.place, where), bodies.point(self.b, self.place, where)
        yield Part("rubber", Stretched(*ends), Rubber(self.stiffness))
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
FIELD = """

@frame_field("speed", "m/s", "node")
def speed(model: Model, params: Params, state: State) -> Array:
    \"\"\"Of each node.\"\"\"
    return jnp.linalg.norm(state.velocities, axis=-1)
"""
BODY = "[[body]]\nmesh = { box = [1, 1, 1], cells = 1 }\ndensity = 1e3\n"
LINEAR = BODY + "young = 1e5\npoisson = 0.3\n"
TIME = "[time]\nstep = 0.01\nsteps = 1\n"
BALL = '[[rigid]]\nname = "ball"\nshape = { sphere = 0.1 }\nmass = 1.0\n'
CASES = {
    "materials": (
        MATERIAL,
        TIME + BODY + 'material = "cork"\nmodulus = 1e5\n',
        "params.modulus, known['modulus.box'].unit",
    ),
    "schemes": (SCHEME, TIME + 'scheme = "explicit"\n' + LINEAR, "model.scheme.order"),
    "methods": (METHOD, TIME + '[solver]\nmethod = "own"\n' + LINEAR, "model.method.name"),
    "declared/joints": (
        JOINT,
        TIME + BALL + '[[joint]]\nkind = "peg"\nname = "peg"\nb = "ball"\nplace = [0, 0, 0.1]\nstiffness = 5e3\n',
        "model.joints['rubber world-rigid'], known['joint.peg.stiffness'].unit",
    ),
    "declared/loads": (
        LOAD,
        TIME + LINEAR + "[[body.load]]\nkind = 'shared'\nnodes = 'x+'\nvalue = [1, 2, 3]\n",
        "model.loads[0].weights.sum() == 1 and params.loads[0]",
    ),
    "io/fields.py": (FIELD, TIME + LINEAR, "computed(model, params, state)['speed'].shape"),
    "rigid/shapes": (
        SHAPE,
        TIME + BALL + '[[contact]]\na = "ball"\nground = { level = -0.2 }\nfriction = 0.0\n',
        "model.contacts['smooth rigid-ground level']",
    ),
}


CODE = """
from jaxfem.fitting.paths import placed_constants
from jaxfem.io import load_scene
from jaxfem.io.fields import computed

model, params, state = load_scene("scene.toml").build()
known = placed_constants(model, params, state)
print({found})
"""


@pytest.mark.parametrize("folder", CASES)
def test_one_new_file_is_enough(folder, tmp_path):
    source, scene, found = CASES[folder]
    package = tmp_path / "jaxfem"
    shutil.copytree(pathlib.Path(jf.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    if folder.endswith(".py"):
        (package / folder).write_text((package / folder).read_text() + source)
    else:
        (package / folder / "brand_new.py").write_text(f'"""New."""\n{source}')
    (tmp_path / "scene.toml").write_text(scene)
    code = CODE.format(found=found)
    alone = {**os.environ, "JAX_ENABLE_X64": "1", "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=alone, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.strip()
