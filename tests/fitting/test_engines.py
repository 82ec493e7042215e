"""Fits whose simulations go with lanes last are those of others, and an engine that cannot serve says so."""

import dataclasses

import numpy as np
import pytest
from scenes import beam

import jaxfem as jf
from jaxfem.fitting import FitError, Recording, Take
from jaxfem.fitting.engines import Engine, LanesLast, chosen
from jaxfem.fitting.evaluation import Evaluator
from jaxfem.fitting.noise import Noise
from jaxfem.fitting.recovery import assembled

PLACES = {"tip": (0.1, 0.015, 0.03), "side": (0.05, 0.0, 0.015)}
ROWS = 12


def evaluator_of(scene, parameters, rows=ROWS, **more):
    """Evaluates a recording of markers that sink and swing; what they do in it does not matter here."""
    times = 0.01 * np.arange(rows + 1)
    fall = -4e-3 * (1 - np.cos(40 * times))[:, None] * np.array([1.0, 0.4])
    places = np.array(list(PLACES.values())) + np.stack([0 * fall, 0 * fall, fall], -1)
    take = Take(*scene, Recording(times, places, tuple(PLACES)), PLACES, 0.01, release=0.0)
    made, _, shared = assembled([take], parameters, (), None, None, Noise(), None, "warn", **more)
    return made, shared.starts[0]


@pytest.mark.slow
def test_lanes_tell_what_others_tell():
    """Residuals and columns at points of which one breaks down: materials, gravity, a delay, places of markers."""
    scene = beam((1, 1, 1), build={"scheme": "generalized_alpha"})
    evaluator, z = evaluator_of(scene, ("young", "poisson", "damping", "gravity.y", "delay"), places=1e-3)
    lanes = Evaluator(evaluator.pieces, evaluator.unknowns)
    assert lanes.take("lanes", 3) == "asked for" and lanes.pieces[0].engine.width == 8
    broken = z.copy()
    broken[evaluator.unknowns.names.index("gravity.y")] = np.nan
    points = [z, z + 0.05, broken]
    for (r, columns, _), (want, wanted, _) in zip(
        lanes.together(points, True)[:2], map(evaluator.linear, points[:2]), strict=True
    ):
        np.testing.assert_allclose(r[0], want[0], atol=1e-7 * np.abs(want[0]).max())
        for one, another in zip(columns[0], wanted[0], strict=True):
            np.testing.assert_allclose(one, another, atol=1e-6 * np.abs(another).max())
    step = 1e-8 * (np.array(evaluator.unknowns.names) == "delay")  # of which no simulation knows
    (ahead,), (behind,) = (evaluator.linear(z + sign * step)[0] for sign in (1, -1))
    slope = evaluator.linear(z)[1][0][evaluator.unknowns.names.index("delay")]
    inside = slice(1, -1)  # at both ends what is before and behind is held
    difference = (ahead - behind) / 2e-8
    np.testing.assert_allclose(slope[inside], difference[inside], atol=1e-4 * np.abs(slope).max())
    assert np.abs(slope).max() > 0 and not np.isfinite(lanes.together(points, True)[2][0][0]).any()


def test_the_choice_is_told():
    scene = beam((1, 1, 1))
    evaluator, _ = evaluator_of(scene, ("young",))
    piece = evaluator.pieces[0]
    given = [(piece.problem, piece.plan)]
    with pytest.raises(FitError, match="engine is 'lane'; known: auto, vmap, lanes"):
        chosen("lane", given, 0)
    assert type(chosen("vmap", given, 16)[0][0]) is Engine
    (engine,), _ = chosen("lanes", given, 100)
    assert isinstance(engine, LanesLast) and engine.width == 32
    engines, reason = chosen("auto", given, 16)
    assert type(engines[0]) is Engine and "longer to compile than it saves" in reason
    long = [(piece.problem, dataclasses.replace(piece.plan, frames=1000))]
    engines, reason = chosen("auto", long, 16)
    assert isinstance(engines[0], LanesLast) and engines[0].width == 16 and reason == "soft bodies on CPUs"
    some = [(piece.problem, dataclasses.replace(piece.plan, at_once=1))]
    with pytest.raises(FitError, match='"lanes" makes all columns of a Jacobian together'):
        chosen("lanes", some, 0)
    rubber = jf.NeoHookean(young=1e5, poisson=0.3)
    body = jf.SoftBody(jf.mesh.box((0.1, 0.03, 0.03), (1, 1, 1)), material=rubber, density=1e3, fixed="x-")
    law = jf.build(jf.Scene([body]))
    other = [(piece.problem.replace(model=law[0], params=law[1], state=law[2]), piece.plan)]
    with pytest.raises(FitError, match="takes laws that are linear"):
        chosen("lanes", other, 0)
    (engine,), reason = chosen("auto", other, 16)
    assert type(engine) is Engine and "takes laws that are linear" in reason
    moved = dataclasses.replace(piece, engine=LanesLast()).on(piece.problem.replace(model=law[0]))
    assert type(moved.engine) is Engine  # what lanes know of a scene is of one model
