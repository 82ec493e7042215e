"""Outlines of shapes: closed, turned outward, and where the distance is 0."""

import jax
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.rigid.shapes.outline import level_surface
from jaxfem.rigid.shapes.surface import checked_triangles, solid_moments

BOX = np.array([[-1.0, -1, -1], [1, 1, 1]])
SOLIDS = [jf.Sphere(0.4), jf.Box((0.4, 0.6, 0.8)), jf.Capsule(0.2, 0.7), jf.Cylinder(0.3, 0.5)]


@pytest.mark.parametrize("shape", SOLIDS, ids=lambda shape: type(shape).__name__)
def test_solids_enclose_their_volume(shape):
    points, triangles = checked_triangles(*shape.outline(BOX))
    assert abs(solid_moments(points, triangles)[0] / shape.mass_properties()[0] - 1) < 0.02
    assert np.abs(jax.vmap(shape.distance)(points)).max() < 1e-6


def test_a_level_surface_is_closed_and_turned_outward():
    shape = jf.Sphere(0.7)
    points, triangles = checked_triangles(*level_surface(shape.distance, BOX))
    assert abs(solid_moments(points, triangles)[0] / shape.mass_properties()[0] - 1) < 0.02
    assert np.abs(np.linalg.norm(points, axis=1) - 0.7).max() < 0.005


@pytest.mark.parametrize("height", [5.0, 40.0])
def test_a_ground_far_below_is_drawn_where_it_is(height):
    """A box that looks at what is above it alone."""
    ground = jf.SignedDistance(lambda place, values: place[2] - 0.1 * jax.numpy.sin(place[0]))
    points, triangles = ground.outline(BOX + np.array([0, 0, height]))
    assert len(triangles) and np.abs(points[:, 2]).max() < 0.2
    nothing = jf.SignedDistance(lambda place, values: 1.0 + 0 * place[0])
    assert [len(each) for each in nothing.outline(BOX)] == [0, 0]


def test_grounds_are_drawn_within_the_box():
    plane = jf.Plane((0.2, 0, 0.1), (0.0, 1.0, 1.0))
    points, triangles = plane.outline(BOX)
    corners = points[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.abs(jax.vmap(plane.distance)(points)).max() < 1e-6 and (normal @ [0, 1, 1] > 0).all()
    field = jf.HeightField(np.array([[0.0, 0.1, 0.0], [0.2, 0.0, 0.1]]), (0.5, 0.5), (-0.5, -0.5))
    points, triangles = field.outline(BOX)
    assert len(triangles) == 4 and np.allclose(points[1], [-0.5, 0.0, 0.1])
    corners = points[triangles]
    assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0).all()
    wall = jf.SignedDistance(lambda place, values: place[0] - values, 0.3)
    points, triangles = wall.outline(BOX)
    assert len(triangles) and np.allclose(points[:, 0], 0.3)
