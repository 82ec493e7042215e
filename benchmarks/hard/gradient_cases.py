"""Tiny scenes of which one number is differentiated by another, each as nasty as it can be made."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

import jaxfem as jf

TOLERANCE, LOOSE = 1e-13, 1e-11


@dataclasses.dataclass(frozen=True)
class Problem:
    """`function`: x -> (a scalar, the run's infos), differentiated `at` x; `scale`: of x, for differences, if not x;
    `tolerance`: that of its steps."""

    function: Callable[[Any], tuple[Any, Any]]
    at: float
    scale: float | None = None
    tolerance: float = TOLERANCE


CASES: dict[str, tuple[str, Callable[[], Problem]]] = {}


def case(name: str, what: str) -> Callable[[Callable[[], Problem]], Callable[[], Problem]]:
    """Register a function that makes a problem: its name, and what is differentiated by what."""

    def register(function: Callable[[], Problem]) -> Callable[[], Problem]:
        CASES[name] = what, function
        return function

    return register


def weighted(places: Any) -> Any:
    """A sum of coordinates in which nothing cancels."""
    return jnp.sum(places * np.random.default_rng(5).standard_normal(places.shape))


def soft(change: Any, points: Any = None, steps: int = 3, dt: float = 5e-3, **body: Any) -> Problem:
    """A free cube of 12 elements from changed places; derivative in Young's modulus."""
    mesh = jf.mesh.box((0.1,) * 3, 1, tets_per_cell=12)
    mesh = mesh if points is None else jf.TetMesh(points(np.array(mesh.points)), mesh.cells)
    values = {"young": 1e5, "poisson": 0.3, "density": 1000.0, "damping": 2e-3} | body
    model, params, state = jf.build(jf.Scene([jf.SoftBody(mesh, **values)], gravity=(0, 0, 0)), tolerance=TOLERANCE)
    start = state.replace(positions=jnp.asarray(change(np.array(mesh.points))))

    def end(share: Any) -> Any:
        own = params.replace(young=params.young * share)
        states, infos = jf.rollout(model, own, start, dt, steps)
        return weighted(states.positions[-1]), infos

    return Problem(end, 1.0)


def stretched(x: np.ndarray) -> np.ndarray:
    """Longer, thinner across."""
    return x * (1.3, 0.9, 0.8)


@case("elements turned inside out", "places, by Young's modulus")
def inverted() -> Problem:
    """One corner pushed through the cube."""
    return soft(lambda x: np.where((x == x.max(0)).all(1)[:, None], x - 0.12, x))


@case("flattened to a plane", "places, by Young's modulus")
def flattened() -> Problem:
    """All elements of no volume."""
    return soft(lambda x: x * (1.2, 0.9, 0))


@case("all stretches equal", "places, by Young's modulus")
def equal() -> Problem:
    """Where principal directions are any: a cube a fifth larger."""
    return soft(lambda x: x * 1.2)


@case("sliver of 0.05 degrees", "places, by Young's modulus")
def sliver() -> Problem:
    """The middle node next to a face."""

    def squeezed(x: np.ndarray) -> np.ndarray:
        middle = int(np.argmin(np.linalg.norm(x - 0.05, axis=1)))
        x[middle, 2] = 0.05 * np.tan(np.radians(0.05))
        return x

    return soft(stretched, squeezed)


@case("E jumps by 1e6 inside", "places, by the modulus of all")
def jump() -> Problem:
    """Half of the elements a million times stiffer."""
    return soft(stretched, young=np.where(np.arange(12) % 2, 1e4, 1e10))


@case("nu = 0.4999", "places, by Poisson's ratio")
def incompressible() -> Problem:
    """A bar under its weight; the ratio's distance from a half is the scale."""
    mesh = jf.mesh.box((0.3, 0.1, 0.1), (3, 1, 1))
    body = jf.SoftBody(mesh, 1e5, 0.4999, 1000.0, damping=2e-3, fixed="x-", strain="smoothed")
    model, params, state = jf.build(jf.Scene([body]), tolerance=TOLERANCE)

    def end(poisson: Any) -> Any:
        states, infos = jf.rollout(model, params.replace(poisson=poisson), state, 1e-2, 5)
        return weighted(states.positions[-1] - model.rest), infos

    return Problem(end, 0.4999, 1e-4)


@case("joint limit struck", "angle, by the rate at the start")
def limit() -> Problem:
    """A rod swings up against its limit and falls from it."""
    rod = jf.RigidBody(jf.Box((1.0, 0.02, 0.02)), mass=1.0, position=(0.5, 0, 0))
    hinge = jf.HingeJoint(None, rod, (0, 0, 0), (0, 1, 0), low=-0.4, high=3.0)
    model, params, state = jf.build(jf.Scene([rod], joints=[hinge]), tolerance=TOLERANCE)

    def end(rate: Any) -> Any:
        turning = jnp.array([[0.0, -1, 0]]) * rate
        rigid = state.rigid.replace(angular_velocities=turning, velocities=jnp.array([[0.0, 0, 0.5]]) * rate)
        states, infos = jf.rollout(model, params, state.replace(rigid=rigid), 1 / 60, 20)
        return weighted(states.rigid.orientations[-1]), infos

    return Problem(end, 5.0)


@case("bounce", "height, by the drop")
def bounce() -> Problem:
    """A ball falls, and bounces once."""
    ball = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(0, 0, 1.1))
    ground = jf.Contact(ball, jf.Plane(), restitution=0.5, friction=0.0)
    model, params, state = jf.build(jf.Scene([ball], contacts=[ground]), tolerance=TOLERANCE)

    def end(drop: Any) -> Any:
        rigid = state.rigid.replace(positions=jnp.array([[0, 0, 1.0]]) * (drop + 0.1))
        states, infos = jf.rollout(model, params, state.replace(rigid=rigid), 1 / 60, 39)
        return states.rigid.positions[-1, 0, 2], infos

    return Problem(end, 1.0)


def with_friction(params: Any, friction: Any) -> Any:
    """All contacts at one coefficient."""
    contacts = {
        name: own.replace(friction=jnp.ones_like(own.friction) * friction) for name, own in params.contacts.items()
    }
    return params.replace(contacts=contacts)


@case("sliding until it stops", "way, by friction")
def stop() -> Problem:
    """A box slides at 1 m/s, and lies for as long again."""
    box = jf.RigidBody(jf.Box((0.4, 0.4, 0.1)), mass=1.0, position=(0, 0, 0.05), velocity=(1, 0, 0))
    model, params, state = jf.build(jf.Scene([box], contacts=[jf.Contact(box, jf.Plane())]), tolerance=TOLERANCE)

    def end(friction: Any) -> Any:
        states, infos = jf.rollout(model, with_friction(params, friction), state, 1 / 60, 40)
        return states.rigid.positions[-1, 0, 0], infos

    return Problem(end, 0.31)


@case("redundant joints", "places, by gravity")
def redundant() -> Problem:
    """A pendulum held by the same ball joint twice, and by a hinge."""
    rod = jf.RigidBody(jf.Box((0.5, 0.1, 0.1)), mass=1.0, position=(0.25, 0, 0))
    twice = [jf.BallJoint(rod, None, (0, 0, 0), name=name) for name in ("one", "again")]
    hinge = jf.HingeJoint(None, rod, (0, 0, 0), (0, 1, 0), name="hinge")
    model, params, state = jf.build(jf.Scene([rod], joints=[*twice, hinge]), tolerance=TOLERANCE)

    def end(gravity: Any) -> Any:
        own = params.replace(gravity=jnp.array([0.0, 0, -1]) * gravity)
        states, infos = jf.rollout(model, own, state, 1 / 60, 12)
        return weighted(states.rigid.positions[-1]), infos

    return Problem(end, 9.81)


@case("laid on the ground without weight", "height, by the speed")
def grazing() -> Problem:
    """A ball that touches the ground and does not move: upwards it leaves, downwards it is held. No derivative."""
    ball = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(0, 0, 0.1))
    scene = jf.Scene([ball], gravity=(0, 0, 0), contacts=[jf.Contact(ball, jf.Plane(), friction=0.0)])
    model, params, state = jf.build(scene, tolerance=TOLERANCE)

    def end(speed: Any) -> Any:
        rigid = state.rigid.replace(velocities=jnp.array([[0, 0, 1.0]]) * speed)
        states, infos = jf.rollout(model, params, state.replace(rigid=rigid), 1 / 60, 2)
        return states.rigid.positions[-1, 0, 2], infos

    return Problem(end, 0.0, 1.0)


@case("stacked boxes", "places, by friction")
def stacked() -> Problem:
    """Two boxes on the ground, the upper one slides on the lower: sixteen corners for what three would carry."""
    lower = jf.RigidBody(jf.Box((0.4, 0.4, 0.1)), mass=1.0, position=(0, 0, 0.05), name="lower")
    upper = jf.RigidBody(jf.Box((0.2, 0.2, 0.1)), mass=2.0, position=(0, 0, 0.15), velocity=(0.5, 0.2, 0), name="upper")
    contacts = [jf.Contact(lower, jf.Plane()), jf.Contact(upper, lower)]
    model, params, state = jf.build(jf.Scene([lower, upper], contacts=contacts), tolerance=TOLERANCE)

    def end(friction: Any) -> Any:
        states, infos = jf.rollout(model, with_friction(params, friction), state, 1 / 60, 6)
        return weighted(states.rigid.positions[-1]), infos

    return Problem(end, 0.2)


@case("1000 kg on 1 g", "places, by Young's modulus")
def heavy_on_light() -> Problem:
    """A block dropped by a millimetre on a soft cube on the ground; at a tolerance that its steps reach."""
    mesh = jf.mesh.box((0.1,) * 3, 1, tets_per_cell=12, origin=(-0.05, -0.05, 0))
    cube = jf.SoftBody(mesh, 1e8, 0.3, 1.0, damping=0.02, name="cube")
    block = jf.RigidBody(jf.Box((0.1,) * 3), mass=1000.0, position=(0, 0, 0.151), name="block")
    contacts = [jf.Contact(cube, jf.Plane()), jf.Contact(cube, block)]
    model, params, state = jf.build(jf.Scene([cube, block], contacts=contacts), tolerance=LOOSE)

    def end(share: Any) -> Any:
        states, infos = jf.rollout(model, params.replace(young=params.young * share), state, 1 / 60, 4)
        return weighted(states.rigid.positions[-1]) + weighted(states.positions[-1]), infos

    return Problem(end, 1.0, tolerance=LOOSE)
