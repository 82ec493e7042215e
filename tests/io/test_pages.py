"""The page of `jaxfem view`: what it holds is what the frames hold, its size, its script in node and in a browser."""

import base64
import json
import re
import shutil
import subprocess

import numpy as np
import pytest
from browser import BROWSER, opened

import jaxfem as jf
from jaxfem.cli.main import main
from jaxfem.io.pages import HERE, write_page
from jaxfem.io.parts import Part
from jaxfem.io.reading import Frame

TYPES = {"u1": np.uint8, "u2": "<u2", "u4": "<u4", "f4": "<f4"}
NODE = shutil.which("node")


def bending(cells, count, parts=False):
    """Frames of a block that sways; with a rigid ball beside it, contact points that come and go, and ground."""
    mesh = jf.mesh.box((0.4, 0.1, 0.1), cells)
    ball = jf.Sphere(0.05).outline(np.zeros((2, 3)))
    for number in range(count):
        shift = np.zeros_like(mesh.points)
        shift[:, 2] = 0.1 * np.sin(0.2 * number) * mesh.points[:, 0]
        stress = 1e4 * (1 + number) * np.ones(len(mesh.cells))
        frame = Frame(0.01 * number, mesh.points + shift, mesh.cells, {"displacement": shift, "von_mises": stress})
        if parts:
            up = np.array([0.6, 0, 0.01 * number])
            frame.parts["rigid"] = Part(
                ball[0] + up, "triangle", ball[1], {"displacement": 0 * ball[0] + up - [0.6, 0, 0]}
            )
            flat = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0]])
            frame.parts["ground"] = Part(flat, "triangle", np.array([[0, 1, 2]]))
            held = np.zeros((number % 3, 3))
            frame.parts["contacts"] = Part(
                held, "vertex", np.zeros((len(held), 1), int), {"force": held + np.array([0, 0, 2.0])}
            )
        yield frame


def held(path):
    """The data of a page, arrays decoded."""
    text = re.search(r'<script id="data" type="application/json">(.*?)</script>', path.read_text(), re.S).group(1)

    def decoded(found):
        if set(found) == {"type", "data"}:
            return np.frombuffer(base64.b64decode(found["data"]), TYPES[found["type"]])
        return found

    return json.loads(text, object_hook=decoded)


def test_a_page_holds_the_frames_to_a_few_microns(tmp_path):
    frames = list(bending((4, 1, 1), 6, parts=True))
    path, count = write_page(
        tmp_path / "run.html", frames, "a <run>", {"energy (J)": (np.arange(3.0), {"sum": np.ones(3)})}
    )
    data = held(path)
    assert count == 6 and data["times"] == [frame.time for frame in frames]
    soft, rigid, ground, contacts = data["meshes"]
    low, span = np.array(data["low"]), np.array(data["span"])
    places = (low + soft["places"].reshape(-1, 3) / 65535 * span).reshape(6, -1, 3)
    nodes = np.unique(jf.mesh.box((0.4, 0.1, 0.1), (4, 1, 1)).surface)
    np.testing.assert_allclose(places[5], frames[5].positions[nodes], atol=2 * span.max() / 65535)
    (stress,) = soft["fields"]
    assert stress["values"].reshape(6, -1)[:, 0].tolist() == [round(255 * k / 6) for k in range(1, 7)]
    colours = {each["name"]: each for each in data["colourings"]}
    assert colours["von_mises"]["high"] == 6e4 and colours["von_mises"]["unit"] == "Pa"
    assert ground["starts"] == [0, 3] and len(rigid["starts"]) == 7  # what stands still is there once
    assert np.diff(contacts["starts"]).tolist() == [0, 2, 4, 0, 2, 4] and contacts["kind"] == "line"
    text = path.read_text()
    assert "a &lt;run&gt;" in text and "http" not in re.sub(r'<script id="data".*?</script>', "", text, flags=re.S)


def test_size_of_a_hundred_frames_of_ten_thousand_triangles(tmp_path):
    frames = list(bending((70, 17, 17), 100))
    path, count = write_page(tmp_path / "large.html", frames, "large", most=1e9)
    triangles = len(held(path)["meshes"][0]["index"]) // 3
    assert count == 100 and triangles > 10_000 and path.stat().st_size < 10e6
    path, count = write_page(tmp_path / "small.html", frames, "small", most=1e6)
    assert path.stat().st_size <= 1e6 and 5 < count < 50
    with pytest.raises(ValueError, match="no frame"):
        write_page(path, [], "none")


def test_a_long_table_is_thinned(tmp_path):
    """Its ends and its shape stay; a million rows would be all there is on the page."""
    times = np.linspace(0.0, 1.0, 100_001)
    frames = list(bending((1, 1, 1), 2))
    path, _ = write_page(tmp_path / "long.html", frames, "long", {"energy (J)": (times, {"kinetic": times**2})})
    (graph,) = held(path)["graphs"]
    assert 3000 < len(graph["times"]) <= 4001 and path.stat().st_size < 1e6
    np.testing.assert_allclose(graph["lines"][0]["values"], np.square(graph["times"]), rtol=1e-5)
    assert graph["times"][0] == 0.0 and graph["times"][-1] > 0.999


@pytest.mark.skipif(NODE is None, reason="needs node")
def test_the_scripts_own_numbers():
    script = f"""
const page = require({json.dumps(str(HERE / "numbers.js"))});
const camera = {{ yaw: 0.3, pitch: 0.5, distance: 2, size: 1, target: [1, 2, 3] }};
const view = page.viewMatrix(camera, 1.5);
const at = (m, p) => [0, 1, 2, 3].map((i) => m[i] * p[0] + m[4 + i] * p[1] + m[8 + i] * p[2] + m[12 + i]);
console.log(JSON.stringify([
  page.frameAt([0, 1, 2.5], 2.4), page.frameAt([0, 1, 2.5], -1), page.frameAt([0, 1, 2.5], 9),
  page.viridis(0), page.viridis(1), page.measured(0.0123, "m"), page.measured(25000, "Pa"), page.measured(0, "s"),
  page.ticks(0, 1, 4), [...page.decoded({{ type: "u2", data: "AQACAA==" }})], at(view.matrix, [1, 2, 3]),
  at(view.matrix, [1, 2, 4])]));
"""
    found = json.loads(subprocess.run([NODE, "-e", script], capture_output=True, text=True, check=True).stdout)
    assert found[:3] == [1, 0, 2]
    np.testing.assert_allclose(found[3], [0.267, 0.005, 0.329], atol=0.02)
    np.testing.assert_allclose(found[4], [0.993, 0.906, 0.144], atol=0.02)
    assert found[5:8] == ["12.3 mm", "25 kPa", "0 s"] and found[8] == [0, 0.5, 1] and found[9] == [1, 2]
    centre, above = np.array(found[10]), np.array(found[11])
    assert np.allclose(centre[:2], 0, atol=1e-5) and np.isclose(centre[3], 2)  # in the middle, at its distance
    assert above[1] / above[3] > 0.1 and abs(above[0]) < 1e-5  # z is up, from above


COLOURED = """
const seen = new Set();
let coloured = 0;
player.find("speed").value = 0.1;
player.data.colourings.forEach((each, i) => setTimeout(() => {
  player.find("colour").value = each.name;
  player.find("colour").dispatchEvent(new Event("change"));
  coloured += 1;
}, 200 * i));"""
WATCHED = """
  const gl = player.gl, some = new Uint8Array(256), canvas = player.canvas;
  gl.readPixels(canvas.width >> 1, (canvas.height >> 1) - 8, 8, 8, gl.RGBA, gl.UNSIGNED_BYTE, some);
  seen.add(document.body.dataset.frame);
  return { seen: seen.size, drawn: some.some((v) => v > 0) };"""


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="needs chromium or chrome")
def test_a_browser_plays_it_without_a_word_on_its_console(tmp_path):
    graph = {"energy (J)": (np.arange(6) * 0.01, {"kinetic": np.arange(6.0)})}
    path, _ = write_page(tmp_path / "run.html", list(bending((4, 1, 1), 6, parts=True)), "run", graph)
    enough = "seen.size > 3 && coloured == player.data.colourings.length && found.drawn"
    page, body, said = opened(path.read_text(), path, WATCHED, enough, COLOURED)
    assert not said, said
    assert int(re.search(r'data-seen="(\d+)"', body).group(1)) >= 4, body
    assert 'data-drawn="true"' in body, body
    assert re.search(r'<p id="trouble" hidden', page)


def test_view_writes_a_page_of_a_run(tmp_path, capsys):
    from jaxfem.io import FrameWriter

    model, params, state = jf.build(jf.Scene([jf.SoftBody(jf.mesh.box((1, 1, 1), 1), 1e5, 0.3, 1e3)]))
    with FrameWriter(tmp_path, "cube", model, params, {"tip": (1, 1, 1)}) as writer:
        writer.write(state)
        writer.write(state.replace(positions=state.positions * 1.1, time=state.time + 0.1))
    assert main(["view", str(tmp_path)]) == 0
    data = held(tmp_path / "cube.html")
    assert [graph["title"] for graph in data["graphs"]] == ["energy (J)", "displacement of points (m)"]
    assert "open it in a browser" in capsys.readouterr().out
    assert main(["view", str(tmp_path / "frames")]) == 2 and "must hold one .pvd index" in capsys.readouterr().err
