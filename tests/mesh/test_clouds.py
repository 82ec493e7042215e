"""Delaunay meshes fill the hull, also where points lie on a grid; surfaces that are open or not convex are refused."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from jaxfem.mesh import MeshError, ball, box, delaunay, from_convex_surface, quality


def test_random_cloud_fills_its_hull():
    points = np.random.default_rng(3).normal(size=(400, 3))
    mesh = delaunay(points, name="cloud")
    short = 1 - mesh.volume / ConvexHull(points).volume
    assert 0 <= short < 1e-3 and quality(mesh).closed_surface
    assert (short < 1e-9) == (not any("short of the hull" in note for note in mesh.notes))


@pytest.mark.parametrize("cells", [(1, 1, 1), (3, 3, 3), (6, 4, 5)])
def test_grid_points_make_no_flat_elements(cells):
    grid = box((3.0, 2.0, 1.0), cells)
    mesh = delaunay(grid.points)
    assert mesh.volume == pytest.approx(6.0) and len(mesh.points) == len(grid.points)
    assert mesh.volumes.min() > 0.99 * 6.0 / (6 * np.prod(cells))
    assert quality(mesh).warnings() == () and len(mesh.surface) == len(grid.surface)


def test_coincident_points_are_left_out_with_a_note():
    grid = box((1.0, 1.0, 1.0), 2)
    mesh = delaunay(np.concatenate([grid.points, grid.points[:2]]))
    assert len(mesh.points) == 27 and any("2 nodes without an element" in note for note in mesh.notes)


@pytest.mark.parametrize("spacing", [None, 0.2])
def test_inside_of_a_convex_surface(spacing):
    shell = ball(1.0, 4)
    mesh = from_convex_surface(shell.points, shell.surface[:, ::-1], spacing)
    report = quality(mesh)
    assert mesh.volume == pytest.approx(shell.volume, rel=1e-3)
    assert report.min_dihedral > 5.0 and report.closed_surface
    assert len(mesh.points) > len(shell.surface_nodes)


def test_unusable_surfaces_are_named():
    bar = box((3.0, 1.0, 1.0), (3, 1, 1))
    with pytest.raises(MeshError, match='surface "body" is not closed: 3 edges without exactly two triangles'):
        from_convex_surface(bar.points, bar.surface[1:])
    points = bar.points.copy()
    points[(points[:, 0] == 1.0) & (points[:, 2] == 1.0), 2] = 0.5
    with pytest.raises(MeshError, match=r'"dent" is not convex .*encloses 2.5 m\^3, its convex hull 3 m\^3'):
        from_convex_surface(points, bar.surface, name="dent")
    with pytest.raises(MeshError, match="spacing=-1"):
        from_convex_surface(bar.points, bar.surface, spacing=-1)
    with pytest.raises(MeshError, match="give a larger spacing"):
        from_convex_surface(bar.points, bar.surface, spacing=1e-3)
    with pytest.raises(MeshError, match="use a node that does not exist"):
        from_convex_surface(bar.points, bar.surface + 1)
    with pytest.raises(MeshError, match="fewer than four points"):
        delaunay(bar.points[:3])
    with pytest.raises(MeshError, match="one plane"):
        delaunay(bar.points[bar.nodes("z-")])
