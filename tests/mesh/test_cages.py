"""Grid cells around a surface: all of it inside, nothing more than cut and inner cells, about as many as asked for."""

import warnings

import numpy as np
import pytest

import jaxfem as jf
from jaxfem.mesh import locate


def ball(cells=4, radius=0.5):
    mesh = jf.mesh.ball(radius, cells)
    return mesh.points, mesh.surface


def torus(n=24, m=12, wide=1.0, thin=0.3):
    u, v = (2 * np.pi * each.ravel() for each in np.meshgrid(np.arange(n) / n, np.arange(m) / m, indexing="ij"))
    points = np.stack(
        [(wide + thin * np.cos(v)) * np.cos(u), (wide + thin * np.cos(v)) * np.sin(u), thin * np.sin(v)], 1
    )
    i, j = (each.ravel() for each in np.meshgrid(np.arange(n), np.arange(m), indexing="ij"))
    a, b, c, d = i * m + j, (i + 1) % n * m + j, (i + 1) % n * m + (j + 1) % m, i * m + (j + 1) % m
    return points, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


@pytest.mark.parametrize("shape", [ball, torus])
@pytest.mark.parametrize("tets", [5, 6, 12])
def test_the_whole_surface_is_inside(shape, tets):
    points, triangles = shape()
    mesh = jf.mesh.cage(points, triangles, size=0.17, tets_per_cell=tets)
    rng = np.random.default_rng(0)
    share = rng.dirichlet(np.ones(3), len(triangles))
    inside = np.concatenate([points, np.einsum("tc,tci->ti", share, points[triangles])])
    assert locate(mesh.points, mesh.cells, inside)[2].max() < 1e-12


def test_what_is_inside_is_kept_and_holes_are_left_open():
    """The ball's middle is filled; the torus keeps its hole, a ball within a ball its cavity's walls apart."""
    points, triangles = ball()
    mesh = jf.mesh.cage(points, triangles, size=0.1)
    assert locate(mesh.points, mesh.cells, [[0, 0, 0], [0.1, 0.2, 0.0]])[2].max() == 0
    assert mesh.volume < 4 / 3 * np.pi * (0.5 + 0.1 * 3**0.5) ** 3  # no cell lies further out than its diagonal
    points, triangles = torus()
    mesh = jf.mesh.cage(points, triangles, size=0.15)
    assert locate(mesh.points, mesh.cells, [[0, 0, 0]])[2][0] > 0.3


@pytest.mark.parametrize("wanted", [300, 1500, 6000])
def test_about_as_many_elements_as_asked_for(wanted):
    mesh = jf.mesh.cage(*torus(), elements=wanted)
    assert abs(len(mesh.cells) - wanted) < 0.15 * wanted
    assert "times their volume" in mesh.notes[-1]


def test_a_crack_smaller_than_a_cell_is_no_harm():
    points, triangles = ball()
    whole, torn = (jf.mesh.cage(points, each, size=0.15) for each in (triangles, triangles[3:]))
    assert whole.volume == torn.volume


@pytest.mark.parametrize(
    "change, words",
    [
        (dict(size=0.1, elements=100), "both size and elements"),
        (dict(size=-1.0), "positive"),
        (dict(tets_per_cell=7), "5, 6 or 12"),
        (dict(triangles=np.zeros((0, 3), int)), "shape"),
        (dict(points=ball()[0] * [1, 1, 0]), "flat"),
    ],
)
def test_what_is_no_cage_is_refused(change, words):
    points, triangles = ball(2)
    with pytest.raises(jf.MeshError, match=words):
        jf.mesh.cage(**(dict(points=points, triangles=triangles) | change))


def test_holes_that_leave_a_cage_hollow_are_warned_of_and_volumes_are_right_or_not_told():
    """A bowl, by cells smaller and larger than its mouth; triangles in a heap, inside out, and some of them turned."""
    points, triangles = ball(4)
    whole = float(jf.mesh.cage(points, triangles, size=0.15).notes[-1].split(" times")[0].split()[-1])
    open_ = triangles[(points[triangles][:, :, 2] < 0.2).any(1)]
    with pytest.warns(jf.MeshWarning, match=r'surface "bowl" has holes wider than the cells'):
        assert "hollow" in jf.mesh.cage(points, open_, size=0.1, name="bowl").notes[-1]
    heap = points[triangles].reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)
    turned = np.where(np.arange(len(triangles))[:, None] % 2, triangles, triangles[:, ::-1])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for each in (heap, (points, triangles[:, ::-1]), (points, triangles[2:])):
            note = jf.mesh.cage(*each, size=0.15).notes[-1]
            assert abs(float(note.split(" times")[0].split()[-1]) - whole) < 0.02 * whole
        assert "enclose nothing" in jf.mesh.cage(points, triangles[:1], size=0.15).notes[-1]
        assert "not turned alike" in jf.mesh.cage(points, turned, size=0.15).notes[-1]
