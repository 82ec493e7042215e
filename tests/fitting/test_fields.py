"""A modulus that varies through a body, found element by element from markers on its surface."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.fitting import FitError, Recording, Take, attach, fit_field, marker_positions

DT, ROWS, SOFT, RATIO = 1e-2, 12, 1e5, 5.0


class Block:
    """A soft block with a stiff part in the middle, that sinks under its weight; markers on all of its surface."""

    def __init__(self):
        self.mesh = jf.mesh.box((0.12, 0.04, 0.04), (6, 2, 2), tets_per_cell=5)
        body = jf.SoftBody(self.mesh, SOFT, 0.3, 1000.0, damping=5e-3, fixed="x-")
        self.model, self.params, self.state = jf.build(jf.Scene([body], gravity=(0, -4.0, -9.0)))
        middle = self.mesh.points[np.asarray(self.model.elements.cells)].mean(axis=1)
        self.stiff = (middle[:, 0] > 0.04) & (middle[:, 0] < 0.08)
        self.truth = np.where(self.stiff, RATIO * SOFT, SOFT)
        outside = np.unique(self.mesh.surface)
        self.places = {f"m{k}": tuple(self.mesh.points[k]) for k in outside if self.mesh.points[k, 0] > 0}

    def take(self, noise):
        params = self.params.replace(young=jnp.asarray(self.truth))
        markers = attach(self.model, self.places)
        states, _ = jf.rollout(self.model, params, self.state, DT, ROWS)
        first = np.asarray(marker_positions(markers, self.state.positions))[None]
        clean = np.concatenate([first, marker_positions(markers, states.positions)])
        noisy = clean + noise * np.random.default_rng(0).normal(size=clean.shape)
        recording = Recording(DT * np.arange(len(noisy)), noisy, tuple(self.places))
        return Take(self.model, self.params, self.state, recording, markers, DT, compare="position", release=0.0)


@pytest.fixture(scope="module")
def block():
    return Block()


@pytest.mark.slow
def test_a_stiff_inclusion_comes_back_within_ten_percent(block):
    found = fit_field(block.take(1e-5), "young", sigma=1e-5, start=1.5e5)
    volumes = np.asarray(block.model.elements.volumes)

    def mean(where):
        return np.exp(np.average(np.log(found.elements[where]), weights=volumes[where]))

    assert mean(block.stiff) == pytest.approx(RATIO * SOFT, rel=0.1)
    assert mean(~block.stiff) == pytest.approx(SOFT, rel=0.1)
    assert found.status == "converged" and found.gain > 0.9
    off = np.log(found.elements / block.truth) / found.deviations
    assert np.mean(np.abs(off) < 3) > 0.9


def test_impossible_fields_are_refused(block):
    take = block.take(1e-5)
    for settings, message in (
        ({"name": "poisson"}, "give a positive constant"),
        ({"jump": 0.9}, "above 1"),
        ({"kind": "rough"}, "kind"),
        ({"regions": np.zeros(3, int)}, "each of the 120 elements"),
        ({"regions": 2 * np.arange(120)}, "without a gap"),
    ):
        with pytest.raises(FitError, match=message):
            fit_field(take, **settings)
