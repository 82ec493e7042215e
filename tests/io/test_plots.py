"""Plots: files of the right kind, limits that hold the body, units with a prefix, no global state."""

import builtins
import sys

import numpy as np
import pytest

import jaxfem as jf
from jaxfem.io import plots

PNG = b"\x89PNG\r\n"


@pytest.fixture
def saved(monkeypatch):
    """The figures that are saved, as matplotlib objects."""
    figures = []
    save = plots._save
    monkeypatch.setattr(plots, "_save", lambda figure, path: figures.append(figure) or save(figure, path))
    return figures


def test_energies(tmp_path, saved):
    energies = {"kinetic": [0.0, 2e-3], "elastic": [1e-3, 0.0], "gravity": [0.0, -1e-3]}
    path = plots.plot_energies(tmp_path / "new" / "energies.png", [0.0, 0.1], energies)
    assert path.read_bytes().startswith(PNG)
    (axes,) = saved[0].axes
    assert axes.get_ylabel() == "energy (mJ)" and axes.get_xlabel() == "time (s)"
    assert [line.get_label() for line in axes.lines] == ["kinetic", "elastic", "gravity", "sum"]
    np.testing.assert_allclose(axes.lines[3].get_ydata(), [1.0, 1.0])


@pytest.mark.parametrize("shift", [(0.0, 0.0, -0.5), (0.02, 0.0, 0.0)])
def test_shapes(tmp_path, saved, shift):
    mesh = jf.mesh.beam(0.2, 0.1, 0.1, 2)
    shapes = {"t = 0 s": mesh.points, "t = 1 s": mesh.points + np.array(shift)}
    path = plots.plot_shapes(tmp_path / "shapes.png", mesh.surface, shapes)
    assert path.read_bytes().startswith(PNG)
    first, second, bar = saved[0].axes
    assert [axes.get_title() for axes in (first, second)] == list(shapes)
    limits = np.array([second.get_xlim(), second.get_ylim(), second.get_zlim()]).T
    np.testing.assert_array_equal(limits, np.array([first.get_xlim(), first.get_ylim(), first.get_zlim()]).T)
    everything = np.concatenate(list(shapes.values()))
    assert (limits[0] <= everything.min(0)).all() and (limits[1] >= everything.max(0)).all()
    ratio = np.ptp(limits, axis=0) / second._box_aspect
    np.testing.assert_allclose(ratio, ratio[0])  # a metre is as long on every axis
    assert second.get_zlabel() == "z (m)" and bar.get_ylabel() == "displacement (mm)"


def test_shapes_that_never_moved(tmp_path):
    mesh = jf.mesh.box((1, 1, 1), 1)
    assert plots.plot_shapes(tmp_path / "shapes.png", mesh.surface, {"t = 0 s": mesh.points}).is_file()


def test_single_time(tmp_path, saved):
    plots.plot_series(tmp_path / "a.png", [0.0], {"tip": [0.0]}, "displacement", "m")
    assert saved[0].axes[0].lines[0].get_marker() == "o" and saved[0].axes[0].get_ylabel() == "displacement (m)"


def test_no_global_state(tmp_path):
    plots.plot_series(tmp_path / "a.png", [0.0, 1.0], {"tip": [0.0, 1.0]}, "displacement", "m")
    if "matplotlib.pyplot" in sys.modules:
        assert sys.modules["matplotlib.pyplot"].get_fignums() == []


def test_without_matplotlib(tmp_path, monkeypatch):
    original = builtins.__import__

    def without(name, *rest):
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return original(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(plots.PlotError, match=r"plots need matplotlib: pip install 'jaxfem\[cli\]'"):
        plots.plot_series(tmp_path / "a.png", [0.0], {}, "energy", "J")


def test_shapes_show_rigid_bodies_and_let_one_see_cavities(tmp_path, saved):
    solid = jf.mesh.box((0.3, 0.3, 0.3), 3)
    middle = np.abs(solid.points[solid.cells].mean(1) - 0.15).max(1) < 0.05
    hollow = jf.TetMesh(solid.points, solid.cells[~middle])
    outer = plots._outer(hollow.surface, hollow.points)
    corners = hollow.points[hollow.surface].mean(1)
    np.testing.assert_array_equal(outer, np.abs(corners - 0.15).max(1) > 0.14)
    assert 0 < outer.sum() < len(outer) and not plots._outer(solid.surface, solid.points).any()
    ball, triangles = jf.Sphere(0.1).outline(np.zeros((2, 3)))
    others = {"t = 0 s": (ball + np.array([0.6, 0, 0]))[triangles]}
    plots.plot_shapes(tmp_path / "shapes.png", hollow.surface, {"t = 0 s": hollow.points}, others=others)
    axes = saved[0].axes[0]
    grey, body = axes.collections
    assert len(grey.get_facecolor()) == len(triangles) and axes.get_xlim()[1] > 0.69
    assert set(np.round(body.get_facecolor()[:, 3], 2)) == {0.3, 1.0}


def test_a_mesh(tmp_path, saved):
    mesh = jf.mesh.box((0.2, 0.1, 0.1), 1)
    assert plots.plot_mesh(tmp_path / "mesh.png", mesh.points, mesh.surface, "part").is_file()
    assert saved[0].axes[0].get_title() == "part"
