"""A stranger's first hour, by the commands that the documentation shows, in a new environment: no test, a script.

    python tests/first_hour.py [--here] [--surface bunny.obj]

Makes a virtual environment (with --here it takes this one), installs the package, and does there: a scanned surface to
a drop on a plane with a page that plays; a hexahedral part in millimetres; a fit from a Motive export. Prints seconds
of processor time of each and fails where one is wrong or the drop takes more than five minutes.
"""

import argparse
import json
import pathlib
import resource
import shlex
import subprocess
import sys
import tempfile
import time

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[1]
BUNNY = ROOT.parent / "shared" / "data" / "meshes" / "bunny_10k.obj"
MOST = 300.0  # s of processor time, of the drop
DROP = """
[time]
step = 0.005
duration = 0.5
save_every = 4
[[body]]
name = "scan"
mesh = { file = "scan.vtu", scale = 1 }
position = [0.0, 0.0, 0.15]
young = 1e5
poisson = 0.3
density = 1000.0
damping = 0.002
[[contact]]
a = "scan"
ground = { plane = [0, 0, 1], point = [0, 0, 0] }
"""
PART = """
[time]
step = 0.005
duration = 0.1
[[body]]
name = "part"
mesh = { file = "part.inp", scale = 1e-3 }
young = 1e6
poisson = 0.3
density = 1000.0
fixed = { below = { x = 1e-6 } }
"""
BEAM = """
[time]
step = 0.01
duration = 0.8
[[body]]
name = "beam"
mesh = { box = [0.10, 0.03, 0.03], cells = [6, 2, 2], tets_per_cell = 12 }
young = 1e6
poisson = 0.4
density = 1070.0
damping = 4e-4
fixed = "x-"
"""
FIT = """
scene = "beam.toml"
recording = "take.csv"
[markers]
tip = [0.1, 0.015, 0.03]
side = [0.1, 0.03, 0.015]
[fit]
parameters = ["young", "damping"]
"""
TRUE = {"young": 2.6e5, "damping": 4e-3}


def spent() -> float:
    """Processor time of all that was run so far [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def hexahedra(path: pathlib.Path) -> None:
    """A bar of 4 x 2 x 2 bricks of 10 mm, as Abaqus writes it."""
    grid = np.stack(np.meshgrid(range(5), range(3), range(3), indexing="ij"), -1).reshape(-1, 3)
    number = {tuple(place): k + 1 for k, place in enumerate(grid.tolist())}
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    lines = ["*NODE", *(f"{k + 1}, {x * 10.0}, {y * 10.0}, {z * 10.0}" for k, (x, y, z) in enumerate(grid))]
    lines.append("*ELEMENT, TYPE=C3D8, ELSET=ALL")
    cells = [(i, j, k) for i in range(4) for j in range(2) for k in range(2)]
    for count, (i, j, k) in enumerate(cells, 1):
        lines.append(", ".join(map(str, [count, *(number[i + a, j + b, k + c] for a, b, c in corners)])))
    path.write_text("\n".join(lines) + "\n")


def motive(folder: pathlib.Path, places: np.ndarray) -> None:
    """Places (k, 2, 3) [m] as Motive exports them, in mm, 100 frames a second."""
    head = [
        "Format Version,1.23,Take Name,take,Capture Frame Rate,100.000000,Length Units,Millimeters",
        "",
        ",Type" + ",Marker" * 6,
        ",Name" + ",beam:tip" * 3 + ",beam:side" * 3,
        ",ID" + ",A1" * 3 + ",A2" * 3,
        "," + ",Position" * 6,
        "Frame,Time (Seconds)" + ",X,Y,Z" * 2,
    ]
    rows = [f"{k},{k / 100:.6f}," + ",".join(f"{1e3 * v:.6f}" for v in row.ravel()) for k, row in enumerate(places)]
    (folder / "take.csv").write_text("\n".join([*head, *rows]) + "\n")


RECORD = """
import sys, json, numpy as np, jax
jax.config.update("jax_enable_x64", True)
import jaxfem as jf
from jaxfem.fitting import attach, marker_positions
from jaxfem.io import load_scene
file = load_scene(sys.argv[1])
model, params, state = file.build()
values = json.loads(sys.argv[2])
states, _ = jf.rollout(model, params.replace(**values), state, 0.01, 80)
markers = attach(model, {"tip": (0.1, 0.015, 0.03), "side": (0.1, 0.03, 0.015)})
still = np.tile(marker_positions(markers, state.positions), (30, 1, 1))
moving = np.asarray(marker_positions(markers, states.positions))
noise = 3e-5 * np.random.default_rng(0).normal(size=(110, 2, 3))
np.save(sys.argv[3], np.concatenate([still, moving]) + noise)
"""


def main() -> int:
    """Run it; 0 where all is right."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--here", action="store_true", help="use this environment, as it is")
    options.add_argument("--surface", default=str(BUNNY), help="the scan")
    given = options.parse_args()
    folder = pathlib.Path(tempfile.mkdtemp(prefix="first_hour_"))
    python = sys.executable
    if not given.here:
        subprocess.run([python, "-m", "venv", str(folder / "venv")], check=True)
        python = str(folder / "venv" / "bin" / "python")
        subprocess.run([python, "-m", "pip", "install", "-q", f"{ROOT}[cli,mesh]"], check=True)

    def run(line: str) -> str:
        words = shlex.split(line)
        words = [python, "-m", *words] if words[0] == "jaxfem" else [python, *words]
        ran = subprocess.run(words, cwd=folder, capture_output=True, text=True)
        if ran.returncode:
            raise SystemExit(f"{line}\n{ran.stdout}{ran.stderr}")
        return ran.stdout + ran.stderr

    begun, wall = spent(), time.perf_counter()
    for name, text in (("drop", DROP), ("part", PART), ("beam", BEAM), ("fit", FIT)):
        (folder / f"{name}.toml").write_text(text)
    if pathlib.Path(given.surface).is_file():
        run(f"jaxfem mesh make {given.surface} --scale 0.1 --out scan.vtu")
        run("jaxfem simulate drop.toml")
        run("jaxfem view drop_results")
        page = folder / "drop_results" / "drop.html"
        assert page.stat().st_size < 10e6 and "<canvas" in page.read_text()
        used = spent() - begun
        print(f"scan to a page: {used:.0f} s of processor time, {time.perf_counter() - wall:.0f} s; {page}")
        assert used < MOST, f"the drop took {used:.0f} s of processor time, more than {MOST:g}"
    else:
        print(f"no surface {given.surface}: the drop is left out")
    begun = spent()
    hexahedra(folder / "part.inp")
    assert "0.04 x 0.02 x 0.02 m" in run("jaxfem mesh info part.inp --scale 1e-3")
    said = run("jaxfem simulate part.toml")
    assert "16 hexahedra" in said, said
    print(f"a hexahedral part in mm: {spent() - begun:.0f} s")
    begun = spent()
    values = json.dumps(TRUE)
    (folder / "record.py").write_text(RECORD)
    run(f"record.py beam.toml '{values}' places.npy")
    motive(folder, np.load(folder / "places.npy"))
    assert "Motive" in run("jaxfem recording info take.csv")
    run("jaxfem fit fit.toml")
    found = json.loads((folder / "fit_fit" / "fitted.json").read_text())["values"]
    assert all(abs(found[name] / true - 1) < 0.05 for name, true in TRUE.items()), found
    print(f"a fit from Motive: {spent() - begun:.0f} s; {found}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
