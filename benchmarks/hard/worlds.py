"""The scenes of hard cases, few, so that cases share compiled programs; each is built once a setting."""

import functools
import itertools
from typing import Any

import jax.numpy as jnp
import numpy as np

import jaxfem as jf
from hard.case import NotServed, Setting
from hard.running import World

SIDE, DT = 0.1, 1 / 60
SOFT = ("condensed", "mprgp")
SOFT_ALL = ("condensed", "mprgp", "condensed implicit", "condensed alpha")
RIGID = ("direct", "mprgp", "pgs")
LOOSE = ("mprgp",)  # rigid bodies that nothing ties
EXTRAS = {"implicit": {"rotation_update": "implicit"}, "alpha": {"scheme": "generalized_alpha"}}


def built(scene: jf.Scene, at: Setting, max_iterations: int = 20_000, **known: Any) -> World:
    """A world of a scene, by a setting's route; NotServed where the method refuses it."""
    method, *extras = at.route.split()
    options: dict[str, Any] = {"max_iterations": max_iterations}
    for each in extras:
        options |= EXTRAS[each]
    try:
        model, params, state = jf.build(scene, solver=method, dtype=at.dtype, **options)
    except jf.SceneError as refusal:
        if str(refusal).startswith(f'solver "{method}'):
            raise NotServed(str(refusal)) from None
        raise
    return World(model, params, state, **known)


def cube_mesh(low: float = 0.0, centre: tuple[float, float, float] = (0, 0, 0)) -> Any:
    """A cube of 1 dm, 2 x 2 x 2 cells of 12 tetrahedra, its lower face at z = low."""
    x, y, z = centre
    return jf.mesh.box((SIDE,) * 3, 2, tets_per_cell=12, origin=(x - SIDE / 2, y - SIDE / 2, z + low))


def soft_cube(mesh: Any, young: float = 1e5, density: float = 1000.0, damping: float = 0.01, **other: Any) -> Any:
    """A soft cube whose modulus is one number an element, so that it may change by element later."""
    moduli = np.full(len(mesh.cells), young)
    return jf.SoftBody(mesh, young=moduli, poisson=0.3, density=density, damping=damping, name="cube", **other)


@functools.cache
def free_cube(at: Setting, offset: float = 0.0) -> World:
    """A soft cube in empty space."""
    scene = jf.Scene([soft_cube(cube_mesh(-SIDE / 2, (offset, 0, 0)))], gravity=(0, 0, 0))
    return built(scene, at, free=True)


@functools.cache
def floor_cube(at: Setting) -> World:
    """A soft cube on a rough floor."""
    cube = soft_cube(cube_mesh())
    return built(jf.Scene([cube], contacts=[jf.Contact(cube, jf.Plane(), name="floor")]), at)


@functools.cache
def clamped_brick(at: Setting, strain: str = "element", poisson: float = 0.3) -> World:
    """A brick of 0.4 x 0.1 x 0.1 m, clamped at one end."""
    mesh = jf.mesh.box((0.4, 0.1, 0.1), (4, 1, 1), tets_per_cell=12)
    body = jf.SoftBody(mesh, 1e7, poisson, 1000.0, damping=0.01, fixed="x-", strain=strain, name="brick")
    return built(jf.Scene([body]), at, size=0.4)


@functools.cache
def tower(at: Setting) -> World:
    """A block of 1000 kg on a soft cube of 1 g, on a plane."""
    cube = soft_cube(cube_mesh(), young=1e8, density=1.0, damping=0.02)
    block = jf.RigidBody(jf.Box((SIDE,) * 3), mass=1000.0, position=(0, 0, 1.5 * SIDE), name="block")
    contacts = [jf.Contact(cube, jf.Plane(), name="floor"), jf.Contact(cube, block, name="top")]
    return built(jf.Scene([cube, block], contacts=contacts), at)


@functools.cache
def rim_on_rim(at: Setting, below: str) -> World:
    """A soft cube on what has its outline: a cube of the same mesh on a plane, or a rigid "box" held in place."""
    cube = jf.SoftBody(cube_mesh(SIDE), 1e5, 0.3, 1000.0, damping=0.005, name="cube")
    if below == "box":
        box = jf.RigidBody(jf.Box((SIDE,) * 3), mass=1.0, position=(0, 0, SIDE / 2), fixed=True, name="box")
        return built(jf.Scene([cube, box], contacts=[jf.Contact(cube, box, name="rim")]), at)
    lower = jf.SoftBody(cube_mesh(), 1e5, 0.3, 1000.0, damping=0.005, name="lower")
    contacts = [jf.Contact(lower, jf.Plane(), name="floor"), jf.Contact(cube, lower, name="rim")]
    return built(jf.Scene([cube, lower], contacts=contacts), at)


@functools.cache
def plate(at: Setting) -> World:
    """A thin soft plate above a thin rigid slab."""
    mesh = jf.mesh.box((0.2, 0.2, 0.004), (4, 4, 1), tets_per_cell=5, origin=(-0.1, -0.1, 0.1))
    thin = jf.SoftBody(mesh, young=1e6, poisson=0.3, density=1000.0, damping=0.005, name="plate")
    slab = jf.RigidBody(jf.Box((0.6, 0.6, 0.01)), mass=1.0, position=(0, 0, -0.005), fixed=True, name="slab")
    scene = jf.Scene([thin, slab], contacts=[jf.Contact(thin, slab, name="strike")])
    return built(scene, at, size=0.2, max_iterations=2000)


@functools.cache
def chain(at: Setting) -> World:
    """Ten links of 1 g along x from the world, a ball at the end."""
    links = [
        jf.RigidBody(jf.Box((0.1, 0.02, 0.02)), mass=1e-3, position=(0.1 * k + 0.05, 0, 0), name=f"link {k + 1}")
        for k in range(10)
    ]
    ball = jf.RigidBody(jf.Sphere(0.05), mass=1.0, position=(1.05, 0, 0), name="ball")
    bodies = [None, *links, ball]
    joints = [
        jf.BallJoint(a, b, (0.1 * k, 0, 0), name=f"joint {k + 1}")
        for k, (a, b) in enumerate(itertools.pairwise(bodies))
    ]
    return built(jf.Scene([*links, ball], joints=joints), at, size=1.0)


@functools.cache
def loose_box(at: Setting) -> World:
    """A rigid box in empty space."""
    box = jf.RigidBody(jf.Box((0.1, 0.2, 0.3)), mass=1.0, name="box")
    return built(jf.Scene([box], gravity=(0, 0, 0)), at, free=True, size=0.3)


@functools.cache
def ground(at: Setting) -> World:
    """A rigid box and, far from it, a ball on a rough plane."""
    box = jf.RigidBody(jf.Box((0.2, 0.2, 0.2)), mass=1.0, position=(0, 0, 0.1), name="box")
    ball = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(100, 0, 0.1), name="ball")
    contacts = [jf.Contact(box, jf.Plane(), name="floor"), jf.Contact(ball, jf.Plane(), name="court")]
    return built(jf.Scene([box, ball], contacts=contacts), at)


@functools.cache
def smooth_ground(at: Setting) -> World:
    """A rigid box on a plane, declared without friction."""
    box = jf.RigidBody(jf.Box((0.2, 0.2, 0.2)), mass=1.0, position=(0, 0, 0.1), name="box")
    return built(jf.Scene([box], contacts=[jf.Contact(box, jf.Plane(), friction=0.0, name="floor")]), at)


@functools.cache
def pair(at: Setting, depth: float = 0.0) -> World:
    """Two equal rigid boxes on top of each other on a plane, next to no friction; `depth` [m]: into each other."""
    boxes = [
        jf.RigidBody(jf.Box((0.2,) * 3), mass=1.0, position=(0, 0, 0.1 + k * (0.2 - depth)), name=name)
        for k, name in enumerate(("lower", "upper"))
    ]
    contacts = [
        jf.Contact(boxes[0], jf.Plane(), friction=1e-3),
        jf.Contact(*boxes[::-1], friction=1e-3, name="between"),
    ]
    return built(jf.Scene(boxes, contacts=contacts), at)


def changed(params: Any, **values: float) -> Any:
    """Params with every contact's `friction` or `restitution` set."""
    contacts = {
        name: own.replace(**{key: jnp.full_like(getattr(own, key), value) for key, value in values.items()})
        for name, own in params.contacts.items()
    }
    return params.replace(contacts=contacts)


def tilted(params: Any, degrees: float, size: float = 9.81, towards: float = 0.0) -> Any:
    """Params with gravity turned, as if the ground were a slope down the direction `towards` [degrees from x]."""
    a, b = np.radians(degrees), np.radians(towards)
    pull = size * np.array([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), -np.cos(a)])
    return params.replace(gravity=jnp.asarray(pull, params.gravity.dtype))
