"""Refined meshes fill the same body with eight times the elements, and groups come along."""

import numpy as np
import pytest

import jaxfem as jf


@pytest.mark.parametrize("mesh", [jf.mesh.box((2.0, 1.0, 1.0), (2, 1, 1)), jf.mesh.ball(1.0, 2)], ids=["box", "ball"])
def test_the_body_stays_and_elements_are_eight_times_as_many(mesh):
    inside = np.flatnonzero(mesh.points[mesh.cells].mean(axis=1)[:, 0] > 0)
    left = np.flatnonzero(mesh.points[:, 0] <= mesh.points[:, 0].min() + 1e-9)
    mesh = jf.TetMesh(mesh.points, mesh.cells, "m", mesh.face_groups, {"left": left}, {"inside": inside})
    finer = jf.mesh.refined(mesh)
    assert len(finer.cells) == 8 * len(mesh.cells) and not finer.notes
    assert np.array_equal(finer.points[: len(mesh.points)], mesh.points)
    assert finer.volume == pytest.approx(mesh.volume, rel=1e-12)
    assert len(finer.surface) == 4 * len(mesh.surface)  # conforming: no face inside belongs to one element alone
    assert finer.volumes[finer.cell_groups["inside"]].sum() == pytest.approx(mesh.volumes[inside].sum(), rel=1e-12)
    assert np.allclose(finer.volumes.reshape(-1, 8).sum(axis=1), mesh.volumes)
    for name, faces in mesh.face_groups.items():
        mine, old = finer.face_groups[name], faces

        def area(which, triangles):
            a, b, c = (which.points[triangles[:, k]] for k in range(3))
            return np.cross(b - a, c - a).sum(axis=0) / 2, np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2

        assert len(mine) == 4 * len(old)
        for one, other in zip(area(finer, mine), area(mesh, old), strict=True):
            assert np.allclose(one, other, atol=1e-12)
    x = finer.points[:, 0]
    assert np.array_equal(np.sort(finer.node_groups["left"]), np.flatnonzero(x <= x.min() + 1e-9))


def test_shapes_do_not_get_worse_again_and_again():
    mesh = jf.mesh.box((1.0, 1.0, 1.0), 1)
    worst = []
    for _ in range(3):
        mesh = jf.mesh.refined(mesh)
        edges = np.linalg.norm(np.diff(mesh.points[mesh.edges], axis=1)[:, 0], axis=1)
        worst.append(edges.max() / np.cbrt(mesh.volumes.min()))
    assert worst[2] <= worst[0] * (1 + 1e-9)
