"""Constants of laws with a memory, or far from linear, come back from simulated recordings with noise."""

import numpy as np
import pytest

import jaxfem as jf
from jaxfem.fitting import Recording, Search, attach, marker_positions

DT = 1e-2
PLACES = {"tip": (0.1, 0.015, 0.03), "left": (0.1, 0.0, 0.01), "middle": (0.05, 0.015, 0.03)}


def recorded(scene, steps, noise, finer=1):
    """A recording of the markers, sampled each DT, with noise as a share of the largest motion."""
    model, params, state = scene
    markers = attach(model, PLACES)
    states, info = jf.rollout(model, params, state, DT / finer, steps * finer, every=finer)
    assert not info.status.any()
    clean = np.concatenate([marker_positions(markers, x) for x in (state.positions[None], states.positions)])
    size = np.abs(clean - clean[0]).max()
    noisy = clean + noise * size * np.random.default_rng(0).normal(size=clean.shape)
    return Recording(np.arange(steps + 1) * DT, noisy, tuple(PLACES)), markers


def recovered(material, start, names, steps, noise, velocity=(0.0, 0.0, 0.0), loads=(), **settings):
    """Value over true value of each constant that a fit finds, from the start."""
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1))
    body = jf.SoftBody(mesh, density=1070.0, material=material, fixed="x-", velocity=velocity, loads=loads)
    scene = model, params, state = jf.build(jf.Scene([body]), tolerance=1e-9, **settings)
    recording, markers = recorded(scene, steps, noise)
    first = params.replace(**{name: material.values[name] * share for name, share in start.items()})
    found = jf.fit(
        model,
        first,
        state,
        recording,
        markers,
        parameters=names,
        dt=DT,
        release=0.0,
        search=Search(candidates=1, polish=12, tol=1e-5),
        checks="warn",
    )
    return {name: value / material.values[name] for name, value in found.values.items()}


@pytest.mark.slow
def test_relaxation_comes_back_within_five_percent():
    material = jf.Viscoelastic(2.6e5, 0.4, 1e-3, [(0.3, 0.06)])
    names = ("young", "g_1", "tau_1")
    found = recovered(material, {"g_1": 0.5, "tau_1": 2.0}, names, 60, 0.003, scheme="generalized_alpha")
    assert found == pytest.approx(dict.fromkeys(names, 1.0), abs=0.05)


@pytest.mark.slow
def test_yield_and_creep_come_back_within_two_percent():
    """A bar that is hit bends past yield, and rings about the set that it keeps."""
    material = jf.CreepPlastic(young=1e5, poisson=0.3, damping=2e-3, yield_strain=0.03, creep=12.0)
    names = ("yield_strain", "creep")
    start = {"yield_strain": 0.6, "creep": 2.0}
    found = recovered(material, start, names, 40, 0.003, velocity=(0.0, 0.0, -1.0))
    assert found == pytest.approx(dict.fromkeys(names, 1.0), abs=0.02)


@pytest.mark.slow
def test_yeoh_comes_back_from_a_stretch_within_three_percent():
    """A bar is let go under a load that stretches it to 3.4 times its length; the noise is twice that of cameras."""
    material = jf.Yeoh(c1=2.4e4, c2=2e3, c3=60.0, poisson=0.4, damping=2e-2)
    names = ("c1", "c2", "c3")
    start = {"c1": 1.6, "c2": 0.5, "c3": 2.0}
    loads = [jf.Traction("x+", (3e5, 0.0, 0.0))]
    found = recovered(material, start, names, 40, 0.0002, loads=loads)  # of 240 mm
    assert found == pytest.approx(dict.fromkeys(names, 1.0), abs=0.03)
