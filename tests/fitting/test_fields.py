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

    def take(self, noise, truth=None):
        params = self.params.replace(young=jnp.asarray(self.truth if truth is None else truth))
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


@pytest.mark.slow
def test_a_field_that_changes_smoothly_comes_back_from_the_one_value_that_fits_best(block):
    """Slabs along the block, of which the last is three times as stiff as the first; no start is given."""
    middle = block.mesh.points[np.asarray(block.model.elements.cells)].mean(axis=1)[:, 0]
    slab = np.clip((middle / 0.02).astype(int), 0, 5)
    told = SOFT * 3.0 ** (np.arange(6) / 5)
    take = block.take(1e-5, told[slab])
    found = fit_field(take, "young", regions=slab, kind="smooth", jump=1.5)
    assert found.status == "converged" and told[0] < found.mean < told[-1] and found.gain > 0.5
    assert found.noise == pytest.approx(1e-5, rel=0.15)  # found, not given
    assert np.allclose(found.values[:4], told[:4], rtol=0.05)  # the tip hardly bears anything,
    assert (np.abs(np.log(found.values / told)) < 4 * found.deviations).all()  # and its bars say so
    assert (found.deviations[:4] < 0.05).all() and found.deviations[5] > found.deviations[0]


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
