"""pyPBD: position-based dynamics. Its Python side cannot change gravity (9.81 m/s^2 along -y), so free bodies fall.

Soft bodies by its FEM constraints; rigid ones by joints. 20 iterations in 5 substeps, after its own examples.
"""

import importlib.metadata
import pathlib
import tempfile
from functools import partial

import numpy as np
import pypbd
from hard.wanted import Wanted

from hard_others.shared import BAD_START, CHAINS, TIMES, G, cells, recovery

NAME, VERSION = "pyPBD", importlib.metadata.version("pypbd")
STEPS = {"1/60 s": 1 / 60, "5 ms, its own": 5e-3}
CUBE = """v -0.5 -0.5 -0.5\nv 0.5 -0.5 -0.5\nv 0.5 0.5 -0.5\nv -0.5 0.5 -0.5
v -0.5 -0.5 0.5\nv 0.5 -0.5 0.5\nv 0.5 0.5 0.5\nv -0.5 0.5 0.5
f 1 3 2\nf 1 4 3\nf 5 6 7\nf 5 7 8\nf 1 2 6\nf 1 6 5\nf 2 3 7\nf 2 7 6\nf 3 4 8\nf 3 8 7\nf 4 1 5\nf 4 5 8
"""


def fresh(dt: float):
    """An empty simulation and its model."""
    pypbd.Logger.reset() if hasattr(pypbd.Logger, "reset") else None
    simulation = pypbd.Simulation.getCurrent()
    if simulation.getModel() is None:
        simulation.initDefault()
    model = simulation.getModel()
    model.cleanup()
    simulation.getTimeStep().reset()
    pypbd.TimeManager.getCurrent().setTime(0.0)
    pypbd.TimeManager.getCurrent().setTimeStepSize(dt)
    stepping = simulation.getTimeStep()
    stepping.setValueUInt(pypbd.TimeStepController.NUM_SUB_STEPS, 5)
    stepping.setValueUInt(pypbd.TimeStepController.MAX_ITERATIONS, 20)
    return stepping, model


def run(stepping, model, dt: float, duration: float, each=None) -> None:
    """Steps to `duration` [s]; `each()` looks at every one."""
    for _ in range(round(duration / dt)):
        stepping.step(model)
        if each:
            each()


def soft_start(change, dt: float):
    """A soft cube, falling freely, from a bad start."""
    stepping, model = fresh(dt)
    rest, tets = cells()
    model.addTetModel([np.array(point) for point in rest], tets.ravel().tolist(), False, False)
    body, particles = model.getTetModels()[0], model.getParticles()
    for k in range(len(rest)):
        particles.setMass(k, 1.0 / len(rest))
    body.setInitialX(np.zeros(3))
    model.addSolidConstraints(body, 2, 1e5, 0.3, 1.0, False, False)
    for k, place in enumerate(change(rest)):
        particles.setPosition(k, np.array(place))
    run(stepping, model, dt, TIMES["free"])
    places = np.array([particles.getPosition(k) for k in range(len(rest))])
    return [Wanted("distance from its shape over size", recovery(rest, places), 1e-2)], []


def box(model, size, mass: float, place):
    """A rigid box of a size (3,) [m]; mass 0 holds it."""
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "cube.obj"
        path.write_text(CUBE)
        vertices, mesh = pypbd.OBJLoader.loadObjToMesh(str(path), np.ones(3))
    density = mass / float(np.prod(size)) if mass else 1.0
    body = model.addRigidBody(
        density, vertices, mesh, np.array(place, float), np.identity(3), np.array(size, float), False, False
    )
    if not mass:
        body.setMass(0.0)
    return body


def chain(mass: float, gravity: float, dt: float):
    """Ten links and a heavy end, let go horizontally."""
    stepping, model = fresh(dt)
    bodies = [box(model, (0.1,) * 3, 0.0, (-0.05, 0, 0))]
    for k in range(10):
        bodies.append(box(model, (0.1, 0.02, 0.02), 1e-3, (0.1 * k + 0.05, 0, 0)))
    bodies.append(box(model, (0.1,) * 3, mass, (1.05, 0, 0)))
    for k in range(11):
        model.addBallJoint(k, k + 1, np.array([0.1 * k, 0.0, 0.0]))
    tops, longest = [0.0], [0.0]

    def look():
        place, speed = np.array(bodies[-1].getPosition()), np.array(bodies[-1].getVelocity())
        tops.append(mass * (G * place[1] + speed @ speed / 2))
        longest.append(float(np.linalg.norm(place)) - 1.05)

    run(stepping, model, dt, TIMES["chain"], look)
    growth = max(tops) / (mass * gravity) if np.isfinite(tops).all() else float("nan")
    return [Wanted("energy growth", growth, 1e-3), Wanted("longer than it is [m]", max(longest), 1e-2)], []


def tumbling(dt: float):
    """A falling box that tumbles, as long as 1e4 steps of 1/60 s."""
    stepping, model = fresh(dt)
    body = box(model, (0.1, 0.2, 0.3), 1.0, (0, 0, 0))
    body.setAngularVelocity(np.array([0.1, 100.0, 0.0]))
    own = np.diag([0.13, 0.1, 0.05]) / 12.0
    kinetic, momenta = [], []

    def look():
        turn, omega = np.array(body.getRotationMatrix()), np.array(body.getAngularVelocity())
        momenta.append(turn @ own @ turn.T @ omega)
        kinetic.append(omega @ momenta[-1] / 2)

    run(stepping, model, dt, TIMES["tumble"], look)
    off = np.abs(np.array(kinetic) / kinetic[0] - 1).max()
    lost = np.linalg.norm(momenta[-1] - momenta[0]) / np.linalg.norm(momenta[0])
    return [Wanted("energy off", float(off), 0.05), Wanted("angular momentum off", float(lost), 1e-9)], []


def contradictory(dt: float):
    """A box held at two points that are half a metre too far apart."""
    stepping, model = fresh(dt)
    posts = [box(model, (0.1,) * 3, 0.0, (x, 0, 0)) for x in (-0.25, 0.25)]
    body = box(model, (0.5, 0.1, 0.1), 1.0, (0, 0, 0))
    model.addBallJoint(0, 2, np.array([-0.25, 0.0, 0.0]))
    model.addBallJoint(1, 2, np.array([0.25, 0.0, 0.0]))
    posts[1].setPosition(np.array([0.75, 0.0, 0.0]))
    posts[1].setOldPosition(np.array([0.75, 0.0, 0.0]))
    run(stepping, model, dt, 1.0)
    turn, place = np.array(body.getRotationMatrix()), np.array(body.getPosition())
    left, right = (place + turn @ np.array([x, 0, 0]) for x in (-0.25, 0.25))
    gap = max(np.linalg.norm(left - (-0.25, 0, 0)), np.linalg.norm(right - (0.75, 0, 0)))
    return [Wanted("joints open [m]", float(gap), 1e-3)], []


def lost(dt: float):
    """NaN in the start."""
    stepping, model = fresh(dt)
    body = box(model, (0.1,) * 3, 1.0, (0, 0, 0))
    body.setPosition(np.array([np.nan, 0, 0]))
    run(stepping, model, dt, 0.1)
    return [Wanted("not finite", float(not np.isfinite(body.getPosition()).all()), 0)], []


CASES = {
    **{name: partial(soft_start, change) for name, change in BAD_START.items()},
    **{name: partial(chain, *values) for name, values in CHAINS.items() if values[1] == G},
    "1e4 steps of tumbling": tumbling,
    "joints that contradict each other": contradictory,
    "NaN in the start": lost,
}
