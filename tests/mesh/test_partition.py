"""Groups of elements: sizes as asked for, in one piece each, and never of parts that move by themselves."""

import numpy as np
import pytest

import jaxfem as jf
from jaxfem.mesh.partition import partition, separate


def centres(mesh):
    return mesh.points[mesh.cells].mean(1), mesh.cells


def joined(*meshes):
    """Meshes in one that share no node."""
    first = np.cumsum([0, *(len(each.points) for each in meshes)])
    return jf.TetMesh(
        np.concatenate([each.points for each in meshes]),
        np.concatenate([each.cells + start for each, start in zip(meshes, first, strict=False)]),
    )


@pytest.mark.parametrize("groups", [1, 2, 3, 5, 7, 8, 13, 60])
def test_groups_of_a_box_are_of_alike_size_and_in_one_piece(groups):
    places, cells = centres(jf.mesh.box((0.1, 0.03, 0.02), (5, 2, 1)))
    label = partition(places, cells, groups)
    sizes = np.bincount(label)
    assert len(sizes) == groups and sizes.min() > 0 and sizes.max() <= -(-len(cells) // groups) + 1
    assert groups > 8 or all(len(separate(cells[label == each])) == 1 for each in range(groups))


def test_arms_of_a_fork_are_no_group():
    """Across the longest extent both tips would be one group, and share a rotation."""
    whole = jf.mesh.box((0.1, 0.09, 0.02), (8, 3, 1))
    places = centres(whole)[0]
    fork = whole.cells[(places[:, 0] < 0.0126) | (np.abs(places[:, 1] - 0.045) > 0.0151)]
    label = partition(whole.points[fork].mean(1), fork, 2)
    assert [len(separate(fork[label == each])) for each in (0, 1)] == [1, 1]


def test_separate_parts_have_groups_of_their_own():
    one, other = jf.mesh.box((0.1, 0.1, 0.1), 2), jf.mesh.box((0.1, 0.1, 0.1), 1, origin=(0.2, 0, 0))
    places, cells = centres(joined(one, other))
    for groups in (2, 3, 5):
        label = partition(places, cells, groups)
        assert len(np.unique(label)) == groups and not {*label[:48]} & {*label[48:]}
    with pytest.raises(ValueError, match="2 separate parts, which share no rotation"):
        partition(places, cells, 1)
    with pytest.raises(ValueError, match="54 elements"):
        partition(places, cells, 55)
