"""What the discretisation moves is estimated by refits, and the estimate is about right."""

import numpy as np
import pytest

import jaxfem as jf
from jaxfem.fitting import FitError, Recording, Search, Take, attach, fit_takes, marker_positions, refine

PLACES = {"tip": (0.1, 0.015, 0.03), "left": (0.1, 0.0, 0.01), "middle": (0.05, 0.015, 0.03)}
DT, ROWS, TRUE = 1e-2, 24, {"young": 2e5, "damping": 4e-3}


def built(mesh, **changes):
    return jf.build(jf.Scene([jf.SoftBody(mesh, density=1070.0, poisson=0.3, fixed="x-", **{**TRUE, **changes})]))


def take_of(mesh, recording, name="take"):
    model, params, state = built(mesh, young=3e5)
    return Take(model, params, state, recording, PLACES, DT, release=0.0, compare="position", name=name)


def recorded(mesh, substeps):
    model, params, state = built(mesh)
    markers = attach(model, PLACES)
    states, _ = jf.rollout(model, params, state, DT / substeps, ROWS * substeps, every=substeps)
    first = np.asarray(marker_positions(markers, state.positions))[None]
    clean = np.concatenate([first, marker_positions(markers, states.positions)])
    noisy = clean + 2e-5 * np.random.default_rng(0).normal(size=clean.shape)
    return Recording(DT * np.arange(len(noisy)), noisy, tuple(PLACES))


@pytest.mark.slow
def test_the_share_of_step_and_mesh_is_estimated():
    """The recording is of a step eight times shorter and a refined mesh, so both errors are known: they are what is
    off of values fitted with one of them coarse."""
    coarse = jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1))
    fine = jf.mesh.refined(coarse)
    search = Search(candidates=1, polish=12, tol=1e-6)
    taken = take_of(coarse, recorded(fine, 1))
    result = fit_takes([taken], parameters=tuple(TRUE), search=search)
    told = refine(result, [take_of(fine, taken.recording)])
    step, mesh = told.refinements
    assert (step.what, mesh.what) == ("time step", "mesh") and step.converged and mesh.converged
    assert mesh.by == f"{len(coarse.cells)} to {len(fine.cells)} elements"
    for name, true in TRUE.items():
        assert mesh.values[name] == pytest.approx(true, rel=0.02)  # the recording's own mesh and step
        assert result.values[name] + mesh.shift[name] == pytest.approx(mesh.values[name])
    assert mesh.estimate["young"] == pytest.approx(4 / 3 * mesh.shift["young"])  # second order
    # backward Euler damps by half a step: at half the step a quarter of a step goes over to the material
    assert step.shift["damping"] == pytest.approx(DT / 2, rel=0.4)
    assert step.estimate["damping"] == pytest.approx(2 * step.shift["damping"])
    assert any("more than its error bar" in text for text in told.warnings) and "discretisation" in told.summary()
    with pytest.raises(FitError, match='no finer take is named "take"'):
        refine(result, [take_of(fine, taken.recording, "other")])
