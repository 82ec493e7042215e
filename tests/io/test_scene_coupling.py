"""Scene files with rigid bodies, joints and contacts: what they hold, what they refuse, and a run of one."""

import csv

import numpy as np
import pytest

import jaxfem as jf
from jaxfem.cli.main import main
from jaxfem.io import SceneFileError, load_scene

TIME = "[time]\nstep = 0.01\nsteps = 3\n"
SOFT = """
[[body]]
name = "arm"
mesh = { box = [0.3, 0.1, 0.1], cells = [2, 1, 1] }
young = 1e5
poisson = 0.3
density = 1000.0
"""
RIGID = """
[[rigid]]
name = "tool"
shape = { box = [0.1, 0.1, 0.1] }
mass = 0.2
position = [0.35, 0.05, 0.05]
rotate = { axis = [0, 0, 1], degrees = 90 }
"""
REST = """
[[rigid]]
name = "ball"
shape = { capsule = 0.05, length = 0.1 }
density = 500.0
position = [0.6, 0, 0.5]

[[rigid]]
shape = { cylinder = 0.05, length = 0.1 }
mass = 1.0
position = [0.9, 0, 0.5]
motion = { velocity = [0.1, 0, 0] }

[[joint]]
kind = "weld"
a = "arm"
b = "tool"
nodes = "x+"

[[joint]]
name = "shoulder"
kind = "hinge"
b = "ball"
anchor = [0.6, 0, 0.6]
axis = [0, 1, 0]
high = 0.5
motor = { target = 1.0, strength = 2.0 }

[[joint]]
kind = "rope"
a = "ball"
anchor = [0.6, 0, 0.5]
anchor_b = [0.6, 0, 1.0]

[[contact]]
a = "arm"
ground = { plane = [0, 0, 1], point = [0, 0, -0.5] }
friction = 0.3

[[contact]]
a = "tool"
b = "ball"

[[contact]]
a = "ball"
ground = { heights = [[0, 0], [0, 0]], spacing = [1.0, 1.0], origin = [0.0, -0.5] }
restitution = 0.2
"""


@pytest.fixture
def write(tmp_path):
    def written(text):
        path = tmp_path / "scene.toml"
        path.write_text(text)
        return path

    return written


def test_everything_is_read(write):
    file = load_scene(write(TIME + SOFT + RIGID + REST))
    scene = file.scene
    assert [type(body).__name__ for body in scene.bodies] == ["SoftBody", *["RigidBody"] * 3]
    assert isinstance(scene.rigid[1].shape, jf.Capsule) and scene.rigid[2].motion.velocity == (0.1, 0.0, 0.0)
    np.testing.assert_allclose(scene.rigid[0].orientation, np.sqrt([0.5, 0, 0, 0.5]), atol=1e-15)
    assert [type(joint).__name__ for joint in scene.joints] == ["WeldJoint", "HingeJoint", "DistanceJoint"]
    assert scene.joints[1].motor == jf.Motor(1.0, 2.0) and scene.joints[2].rope
    assert [contact.friction for contact in scene.contacts] == [0.3, 0.5, 0.5]
    model, params, state = file.build()
    assert model.method.name == "mprgp" and model.rigid.names == ("tool", "ball", "cylinder")
    assert "shoulder" in model.joints["angle motor world-rigid"].names
    assert {name.split(" ")[0] for name in model.contacts} == {"rough"}
    assert len(jf.impulses(model, state)) == 1 + len(model.joints) + 2 * len(model.contacts)
    assert set(params.joints) == set(model.joints)


def test_a_surface_file_makes_a_rigid_body(write, tmp_path):
    import meshio

    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    meshio.Mesh(points, [("triangle", [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])]).write(tmp_path / "part.obj")
    text = "[[rigid]]\nshape = { file = 'part.obj', scale = 0.1 }\ndensity = 6000.0"
    (body,) = load_scene(write(TIME + text)).scene.rigid
    assert body.properties[0] == pytest.approx(1.0)


def test_a_surface_file_gives_the_points_that_touch(write, tmp_path):
    import meshio

    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    meshio.Mesh(points, [("triangle", [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])]).write(tmp_path / "skin.obj")
    text = SOFT + "[[contact]]\na = 'arm'\nground = { plane = [0, 0, 1] }\nsurface = { file = 'skin.obj', scale = 0.1 }"
    (contact,) = load_scene(write(TIME + text)).scene.contacts
    np.testing.assert_allclose(np.sort(contact.surface, 0), np.sort(0.1 * points, 0))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"add a table \[\[body\]\] .* or a \[\[rigid\]\] one"),
        (RIGID.replace("mass", "mas"), r"unknown key 'mas' in \[\[rigid\]\] 1 \"tool\": did you mean 'mass'"),
        (RIGID.replace("box = ", "bax = "), "unknown key 'bax' in 'shape'"),
        (RIGID.replace("[0.1, 0.1, 0.1]", "3"), "list of 3 finite numbers"),
        (RIGID.replace("{ box = [0.1, 0.1, 0.1] }", '"box"'), "must be a table like"),
        (RIGID.replace("mass = 0.2", ""), "`density` in kg/m"),
        (RIGID + "orientation = [1, 0, 0, 0]", "both 'orientation' and 'rotate'"),
        (RIGID + "fixed = 1", "true or false"),
        (RIGID + "[[joint]]\nkind = 'ball'\na = 'tool'", r"missing key 'anchor' in \[\[joint\]\] 1 \(ball\)"),
        (RIGID + "[[joint]]\nkind = 'bal'\na = 'tool'", "did you mean 'ball'"),
        (RIGID + "[[joint]]\nkind = 'ball'\nanchor = [0, 0, 0]", "world to itself"),
        (RIGID + "[[joint]]\nkind = 'ball'\naxis = [0, 0, 1]\na = 'tool'", "unknown key 'axis'"),
        (RIGID + "[[joint]]\nkind = 'weld'\na = 'tool'\nnodes = 'x+'", "those of a soft body"),
        (SOFT + "[[contact]]\na = 'arm'\nground = { plane = [0, 0, 1] }\nsurface = 'skin.obj'", "table"),
        (RIGID + "[[contact]]\na = 'tool'", "neither 'b'"),
        (RIGID + "[[contact]]\na = 'tool'\nground = { plain = [0, 0, 1] }", "did you mean 'plane'"),
        (RIGID + "[[contact]]\na = 'tool'\nground = { heights = [1, 2], spacing = [1, 1] }", "at least two rows"),
        (RIGID + "[[contact]]\na = 'tool'\nb = 'tool'\nfriction = 'high'", "must be a finite number"),
    ],
)
def test_mistakes_are_named(write, text, message):
    with pytest.raises((SceneFileError, jf.SceneError), match=message):
        load_scene(write(TIME + text))


@pytest.mark.parametrize(
    "text",
    [
        pytest.param(SOFT + RIGID, marks=pytest.mark.slow),
        RIGID + "[[contact]]\na = 'tool'\nground = { plane = [0, 0, 1] }",
    ],
)
def test_simulate_writes_poses(write, tmp_path, text):
    out = tmp_path / "out"
    assert main(["simulate", str(write(TIME + text)), "--out", str(out), "--no-plots"]) == 0
    with open(out / "rigid.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4 and "tool_qw" in rows[0]
    assert float(rows[-1]["tool_z_m"]) == pytest.approx(0.05 if "contact" in text else 0.05 - 9.81 * 6e-4, abs=1e-8)
    assert len(list((out / "frames").glob("scene_?????.vtu"))) == 4
