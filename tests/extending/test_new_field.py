"""A field of the frames that this file alone defines: the volume change of each element."""

import numpy as np
import pytest

import jaxfem as jf
from jaxfem.elements.tetra import deformation_gradient
from jaxfem.io.export import FrameWriter
from jaxfem.io.fields import FIELDS, computed, frame_field
from jaxfem.io.reading import read_frames
from jaxfem.tensors import determinant


@pytest.fixture
def volume_change():
    @frame_field("volume_change", "", "element")
    def compute(model, params, state):
        return determinant(deformation_gradient(model.elements, state.positions)) - 1

    yield
    del FIELDS["volume_change"]


def test_frames_hold_it(volume_change, tmp_path):
    body = jf.SoftBody(jf.mesh.box((1, 1, 1), 1), young=1e5, poisson=0.3, density=1e3)
    model, params, state = jf.build(jf.Scene([body]))
    with FrameWriter(tmp_path, "cube", model, params) as writer:
        writer.write(state.replace(positions=1.1 * state.positions))
    (frame,) = read_frames(writer.index)
    np.testing.assert_allclose(frame.fields["volume_change"], 1.1**3 - 1, rtol=1e-6)
    np.testing.assert_allclose(frame.displacement, 0.1 * np.asarray(state.positions), atol=1e-7)
    with pytest.raises(AttributeError, match="no field 'pressure'"):
        _ = frame.pressure


def test_a_name_that_a_tensor_has_is_refused(tmp_path):
    model, params, state = jf.build(
        jf.Scene([jf.SoftBody(jf.mesh.box((1, 1, 1), 1), young=1e5, poisson=0.3, density=1e3)])
    )
    frame_field("strain", "", "element")(lambda model, params, state: model.elements.volumes)
    try:
        with pytest.raises(ValueError, match='the field "strain" is there already'):
            computed(model, params, state, True)
    finally:
        del FIELDS["strain"]
