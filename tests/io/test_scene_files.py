"""Scene files: every kind of mesh, load and selection is read, and every mistake is refused by name with a remedy."""

import numpy as np
import pytest
from kinds import own_alone

import jaxfem as jf
from jaxfem.io import SceneFileError, beam_scene, load_scene
from jaxfem.materials.constants import MaterialError

BODY = """
[[body]]
name = "beam"
mesh = { box = [0.2, 0.1, 0.1], cells = [2, 1, 1] }
young = 1e5
poisson = 0.3
density = 1000.0
"""
TIME = """
[time]
step = 0.01
steps = 4
"""
SCENE = TIME + BODY


@pytest.fixture
def load(tmp_path):
    def loaded(text):
        path = tmp_path / "scene.toml"
        path.write_text(text)
        return load_scene(path)

    return loaded


def test_example(load):
    file = load(beam_scene(young=123456.789, poisson=0.4, damping=1.5e-3, cells=(4, 2, 2)))
    (body,) = file.scene.bodies
    assert body.made_of.values == {"young": 123456.789, "poisson": 0.4, "damping": 1.5e-3} and body.name == "beam"
    assert len(body.mesh.cells) == 4 * 2 * 2 * 12 and (body.mesh.points[body.fixed, 0] == 0).all()
    assert (file.dt, file.steps, file.every, file.duration) == (0.01, 100, 1, 1.0)
    assert file.points == {"tip": (0.1, 0.015, 0.015)} and file.folder.name == "results"
    assert (file.solver, file.tolerance, file.precision) == ("auto", 1e-8, "float64")


def test_defaults_and_build(load):
    file = load(SCENE)
    assert file.folder.name == "scene_results" and file.points == {} and file.tolerance is None
    np.testing.assert_array_equal(file.scene.gravity, (0, 0, -9.81))
    model, params, _ = file.build()
    assert model.bodies == ("beam",) and model.rest.dtype == np.float64 and float(params.young) == 1e5
    assert load(SCENE + "[solver]\nprecision = 'float32'").build()[2].positions.dtype == np.float32
    assert load(SCENE + "[solver]\nmax_iterations = 7\ntolerance = 1e-4").build()[0].max_iterations == 7


def test_duration(load):
    assert load("[time]\nstep = 0.01\nduration = 0.3\nsave_every = 5" + BODY).steps == 30


@pytest.mark.parametrize(
    ("mesh", "elements"),
    [
        ("{ box = [1, 1, 1], cells = 2, tets_per_cell = 5, origin = [1, 0, 0] }", 40),
        ("{ beam = [4.0, 1.0, 1.0], cells_along = 4 }", 24),
        ("{ ball = 0.5, cells = 1, center = [0, 0, 1] }", 20),
    ],
)
def test_generated_meshes(load, mesh, elements):
    file = load(SCENE.replace("{ box = [0.2, 0.1, 0.1], cells = [2, 1, 1] }", mesh))
    assert len(file.scene.bodies[0].mesh.cells) == elements


def test_mesh_file_beside_the_scene(load, tmp_path):
    jf.mesh.write(tmp_path / "part.msh", jf.mesh.box((200, 100, 100), (2, 1, 1)))
    text = SCENE.replace("{ box = [0.2, 0.1, 0.1], cells = [2, 1, 1] }", '{ file = "part.msh", scale = 1e-3 }')
    body = load(text + 'fixed = "x-"').scene.bodies[0]
    assert body.mesh.name == "beam" and body.mesh.volume == pytest.approx(0.2 * 0.1 * 0.1)
    assert len(body.fixed) == 4


def test_placed(load):
    text = SCENE + "position = [0, 0, 1]\nrotate = { axis = [0, 0, 2], degrees = 90 }"
    bounds = load(text).scene.bodies[0].mesh.bounds
    np.testing.assert_allclose(bounds, [[-0.1, 0, 1], [0, 0.2, 1.1]], atol=1e-15)
    about = load(SCENE + "rotate = { axis = [0, 0, 1], degrees = 180, center = [0.1, 0.05, 0] }").scene.bodies[0].mesh
    np.testing.assert_allclose(about.bounds, [[0, 0, 0], [0.2, 0.1, 0.1]], atol=1e-15)


@pytest.mark.parametrize(
    ("selection", "count"),
    [
        ('"x-"', 4),
        ('["x-", "x+"]', 8),
        ("{ below = { x = 0.1 } }", 8),
        ("{ above = { x = 0.1 }, below = { z = 0 } }", 4),
        ("{ box = [[0, 0, 0], [0.2, 0.1, 0]] }", 6),
        ("{ nodes = [0, 3] }", 2),
        ('["x-", { above = { x = 0.2, z = 0.1 } }]', 6),
    ],
)
def test_selections(load, selection, count):
    assert len(load(f"{SCENE}fixed = {selection}").scene.bodies[0].fixed) == count


def test_loads_and_motions(load):
    text = """
[[body.load]]
kind = "traction"
faces = "x+"
value = [0, 0, -100]
[[body.load]]
kind = "pressure"
faces = ["z+", { above = { z = 0.1 } }]
value = 20
[[body.load]]
kind = "nodal_force"
nodes = { above = { x = 0.2 } }
value = [1, 0, 0]
[[body.load]]
kind = "point_force"
point = [0.1, 0.05, 0.05]
value = [0, 1, 0]
[[body.driven]]
nodes = "x-"
amplitude = [0, 0, 0.01]
frequency = 2
"""
    body = load(SCENE + text).scene.bodies[0]
    traction, pressure, nodal, point = body.loads
    assert isinstance(traction, jf.Traction) and len(traction.faces) == 2
    assert isinstance(pressure, jf.Pressure) and len(pressure.faces) == 4  # named twice, loaded once
    assert isinstance(nodal, jf.NodalForce) and len(nodal.nodes) == 4
    assert isinstance(point, jf.PointForce) and point.force == (0, 1, 0)
    assert body.driven[0].motion.frequency == 2 and body.driven[0].motion.amplitude == (0, 0, 0.01)
    load(SCENE + text).build()


def test_material_for_each_cell_group(load, tmp_path):
    mesh = jf.mesh.box((0.2, 0.1, 0.1), (2, 1, 1))
    halves = {"soft": np.arange(6), "stiff": np.arange(6, 12)}
    jf.mesh.write(tmp_path / "part.msh", jf.TetMesh(mesh.points, mesh.cells, cell_groups=halves))
    text = SCENE.replace("{ box = [0.2, 0.1, 0.1], cells = [2, 1, 1] }", '{ file = "part.msh" }')
    body = load(text.replace("1e5", "{ soft = 1e4, stiff = 1e6 }")).scene.bodies[0]
    np.testing.assert_array_equal(body.made_of.values["young"], np.repeat([1e4, 1e6], 6))
    with pytest.raises(SceneFileError, match="leaves out 6 elements, like 6: name their group"):
        load(text.replace("1e5", "{ soft = 1e4 }"))
    with pytest.raises(SceneFileError, match=r"unknown key 'stif' .* did you mean 'stiff'"):
        load(text.replace("1e5", "{ soft = 1e4, stif = 1e6 }"))


def test_tables_of_other_commands(tmp_path):
    (tmp_path / "a.toml").write_text(SCENE + "[fit]\nx = 1")
    load_scene(tmp_path / "a.toml", also=("fit",))
    with pytest.raises(SceneFileError, match="unknown key 'fit' in the top level"):
        load_scene(tmp_path / "a.toml")


LOAD = SCENE + "[[body.load]]\n"
BAD = [
    (SCENE.replace("young", "yuong"), r"unknown key 'yuong' in \[\[body\]\] 1 \"beam\": did you mean 'young'\?"),
    (SCENE + "[solvr]", r"unknown key 'solvr' in the top level: did you mean 'solver'\?"),
    (SCENE.replace("steps", "stesp"), r"unknown key 'stesp' in \[time\]: did you mean 'steps'"),
    (SCENE.replace("young = 1e5\n", ""), r"missing key 'young' in \[\[body\]\] 1 \"beam\": give it in Pa"),
    (SCENE.replace("step = 0.01\n", ""), r"missing key 'step' in \[time\]: give it in s"),
    (SCENE.replace("mesh", "# mesh"), "missing key 'mesh' in"),
    (SCENE.replace("1e5", '"soft"'), "'young' in .* is the text \"soft\": it must be a number of Pa"),
    (SCENE.replace("1e5", "true"), "'young' in .* is true: it must be a number"),
    (SCENE.replace("0.01", "0"), r"'step' in \[time\] is 0: it must be a positive number of s"),
    (SCENE.replace("0.01", "inf"), r"'step' in \[time\] is inf: it must be a finite number"),
    (SCENE.replace("steps = 4", "steps = 2.5"), r"'steps' in \[time\] is 2.5: it must be a whole number, at least 1"),
    (SCENE.replace("steps = 4", "duration = -1"), "'duration' .* is -1: it must be a positive number of s"),
    (SCENE.replace("steps = 4", "duration = 0.025"), "no whole number of steps of 0.01 s: take 0.02 or 0.03 s"),
    (SCENE.replace("steps = 4", ""), "neither 'duration' .* nor 'steps': give one"),
    (SCENE.replace("steps = 4", "steps = 4\nduration = 0.04"), "both 'steps' and 'duration': give one"),
    (SCENE.replace("steps = 4", "steps = 4\nsave_every = 0"), "'save_every' in .* at least 1"),
    ("gravity = [0, 0]" + SCENE, "'gravity' in the top level is .0, 0.: it must be a list of 3 finite numbers in m/s"),
    ("gravity = [0, 0, nan]" + SCENE, "'gravity' .* must be a list of 3 finite numbers"),
    (TIME, r"holds no body: add a table \[\[body\]\]"),
    ("body = []" + TIME, "holds no body"),
    (SCENE.replace("[[body]]", "[body]"), r"single table: write \[\[body\]\]"),
    (SCENE.replace("cells = [2, 1, 1]", "cells = [2, 0, 1]"), "'cells' in 'mesh' in .* at least 1"),
    (SCENE.replace("cells = [2, 1, 1]", "cels = 1"), "unknown key 'cels' in 'mesh' .*did you mean 'cells'"),
    (SCENE.replace("box", "bxo"), "unknown key 'bxo' in 'mesh' in .*did you mean 'box'"),
    (
        SCENE.replace("box = [0.2, 0.1, 0.1], ", ""),
        "no kind of mesh: give one of file, surface, cad, cage, box, beam, ball",
    ),
    (SCENE.replace("{ box", "{ ball = 1.0, box"), "names box and ball: give one of"),
    (SCENE.replace("[2, 1, 1]", "1, tets_per_cell = 7"), "'mesh' in .* can be cut into 5, 6 or 12"),
    (SCENE.replace("[0.2,", "[-0.2,"), "'mesh' in .* three positive lengths"),
    (
        SCENE + 'fixed = "left"',
        r"'fixed' in .*no node group \"left\" in \"beam\": it has \"x-\", \"x\+\", .*\"surface\"",
    ),
    (SCENE + "fixed = { below = { x = -1 } }", "'fixed' in .* selects no node: \"beam\" reaches from x 0 to 0.2, y"),
    (SCENE + "fixed = { belo = { x = -1 } }", "unknown key 'belo' .*did you mean 'below'"),
    (SCENE + "fixed = { below = { w = 1 } }", "unknown key 'w' in 'below' .* known are x, y, z"),
    (SCENE + "fixed = { nodes = [99] }", "'nodes' in .* node numbers from 0 to 11"),
    (SCENE + "fixed = { box = [[1, 1, 1], [0, 0, 0]] }", "'box' .* the smaller corner, then the larger"),
    (SCENE + "fixed = 3", "'fixed' in .* is 3: it must be a group's name"),
    (SCENE + "rotate = { axis = [0, 0, 0], degrees = 9 }", "'axis' in .* not all zeros"),
    (SCENE + 'strain = "nodal"', "'strain' in .* is 'nodal'"),
    (SCENE + "[solver]\nmethod = 'condense'", "'method' in .solver. is 'condense': did you mean 'condensed'"),
    (SCENE + "[solver]\ntolerance = 2", "'tolerance' .* between 0 and 1"),
    (SCENE + "[output]\npoints = { tip = [1, 2] }", "'tip' in points of .output. .* list of 3 finite numbers in m"),
    (LOAD + "faces = 'x+'", r"missing key 'kind' in \[\[body.load\]\] 1 of .*known are nodal_force, point_force"),
    (LOAD + "kind = 'presure'\nfaces = 'x+'", "'kind' in .* is 'presure': did you mean 'pressure'"),
    (LOAD + "kind = 'pressure'\nfaces = 'x+'\nvalue = [1, 2, 3]", "'value' in .*: it must be a finite number of Pa"),
    (LOAD + "kind = 'traction'\nfaces = 'up'\nvalue = [1, 2, 3]", "'faces' in .*no face group \"up\""),
    (LOAD + "kind = 'traction'\nfaces = { nodes = [0] }\nvalue = [1, 2, 3]", "selects no face of the surface"),
    (LOAD + "kind = 'traction'\nnodes = 'x+'\nvalue = [1, 2, 3]", "unknown key 'nodes' in .*traction.*known are faces"),
    (SCENE + "[[body.driven]]\nnodes = 'x+'\nspeed = 1", r"unknown key 'speed' in \[\[body.driven\]\] 1"),
    (SCENE.replace("0.01", "0.01 s"), r"not valid TOML: .*at line 3"),
]


@pytest.mark.parametrize(("text", "message"), BAD, ids=[message[:40] for _, message in BAD])
def test_refused(load, text, message):
    with own_alone(), pytest.raises(SceneFileError, match=message) as caught:
        load(text)
    assert "scene.toml" in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("poisson = 0.3", "poisson = 0.5", 'poisson of "beam" is 0.5: it must lie strictly between'),
        ("young = 1e5", "young = -1e5", 'young of "beam" is -100000: it must be > 0 Pa'),
        ("young = 1e5", "young = nan", 'young of "beam" is nan: it must be > 0 Pa'),
        ("density = 1000.0", "density = 0", 'density of "beam" is 0'),
    ],
)
def test_impossible_materials(load, old, new, message):
    with pytest.raises(MaterialError, match=message):
        load(SCENE.replace(old, new))


def test_names_that_clash(load):
    with pytest.raises(jf.SceneError, match='two bodies are called "beam"'):
        load(SCENE + BODY)


def test_missing_files(load, tmp_path):
    text = SCENE.replace("{ box = [0.2, 0.1, 0.1], cells = [2, 1, 1] }", '{ file = "prat.msh" }')
    jf.mesh.write(tmp_path / "part.msh", jf.mesh.box((1, 1, 1), 1))
    with pytest.raises(FileNotFoundError, match=r"no mesh file .*prat.msh: the folder holds part.msh"):
        load(text)
    with pytest.raises(FileNotFoundError, match=r"no scene file .*other.toml: the folder holds scene.toml"):
        load_scene(tmp_path / "other.toml")
    with pytest.raises(FileNotFoundError, match="is a folder: give a scene file"):
        load_scene(tmp_path)
