"""Rigid bodies and joints: heavy ends, spin, joints that repeat or contradict each other, motors, ropes."""

import functools

import jax.numpy as jnp
import numpy as np

import jaxfem as jf
from hard.case import Setting, Told, Wanted, case
from hard.running import Run, World, momenta, roll
from hard.worlds import DT, LOOSE, RIGID, SIDE, SOFT, built, chain, cube_mesh, loose_box, soft_cube


def open_by(world: World, run: Run) -> float:
    """The largest gap of a joint at the end [m or rad]: what `diagnose` measures."""
    one = jf.diagnose(world.model, run.params, run.end, run.infos[-1])
    return max((each.amount for each in one.findings if each.kind == "open"), default=0.0)


def swinging(name: str, mass: float, gravity: float, quick: bool) -> None:
    @case(name, "mass ratio", RIGID, quick=quick)
    def found(at: Setting) -> Told:
        world = chain(at)
        dtype = world.params.gravity.dtype
        rigid = world.params.rigid.replace(mass=world.params.rigid.mass.at[-1].set(mass))
        params = world.params.replace(rigid=rigid, gravity=jnp.asarray((0, 0, -gravity), dtype))
        run = roll(world, DT, 120, None, params)
        wanted = [
            Wanted("energy growth", run.energy_growth, at.rounding(1e-3, 1e-2)),
            Wanted("joints open [m]", open_by(world, run), 1e-3),
            Wanted("bad status", run.status, 0),
        ]
        return Told(wanted, [run])


swinging("chain of 1 g links with 1 kg", 1.0, 9.81, True)
swinging("chain of 1 g links with 100 kg", 100.0, 9.81, True)
swinging("chain of 1 g links with 1000 kg", 1000.0, 9.81, True)
swinging("chain of 1 g links with 1 kg at g = 1e4", 1.0, 1e4, True)


def spinning(name: str, spin, steps: int, quick: bool = False) -> None:
    @case(name, "momentum", LOOSE, quick=quick)
    def found(at: Setting) -> Told:
        world = loose_box(at)
        rigid = world.state.rigid
        state = world.state.replace(rigid=rigid.replace(angular_velocities=jnp.asarray([spin], rigid.positions.dtype)))
        run = roll(world, DT, steps, state)
        kinetic = run.energies[:, 0]
        before = np.linalg.norm(momenta(world, run.params, run.frames[0])[2])
        off = (
            np.linalg.norm(momenta(world, run.params, run.end)[2] - momenta(world, run.params, run.frames[0])[2])
            / before
        )
        wanted = [
            Wanted("energy off", float(np.abs(kinetic / kinetic[0] - 1).max()), 0.05),
            Wanted("angular momentum off", float(off), at.rounding(1e-9, 2e-3)),
            Wanted("bad status", run.status, 0),
        ]
        return Told(wanted, [run])


spinning("1e4 steps of spin about the long axis", (0.0, 0.0, 100.0), 10_000)
spinning("1e4 steps of tumbling", (0.1, 100.0, 0.0), 10_000, quick=True)
spinning("tumbling at 1e4 rad/s", (1.0, 1e4, 1.0), 1000)


@case("dt 1e-6 s, a rigid body falls", "precision", LOOSE, quick=True)
def tiny_steps(at: Setting) -> Told:
    """A thousand steps of a microsecond."""
    world = loose_box(at)
    params = world.params.replace(gravity=jnp.asarray((0, 0, -9.81), world.params.gravity.dtype))
    start = world.state.replace(rigid=world.state.rigid.replace(positions=world.state.rigid.positions + 1.0))
    run = roll(world, 1e-6, 1000, start, params)
    fall = -9.81 * 1e-12 * 1000 * 1001 / 2
    moved = float(np.asarray(run.end.rigid.positions, float)[0, 2]) - 1.0
    return Told([Wanted("error of the fall", abs(moved / fall - 1), 1e-2)], [run])


def jointed(joints, gravity=(0.0, 0.0, -9.81)):
    """A world of one box of 1 kg with joints to the world."""

    @functools.cache
    def world(at: Setting) -> World:
        box = jf.RigidBody(jf.Box((0.5, 0.1, 0.1)), mass=1.0, name="box")
        return built(jf.Scene([box], gravity, joints=joints(box)), at, size=0.5)

    return world


redundant = jointed(
    lambda box: [
        jf.BallJoint(box, None, (-0.25, 0, 0), name="left"),
        jf.BallJoint(box, None, (-0.25, 0, 0), name="left again"),
        jf.WeldJoint(box, None, (0.25, 0, 0), name="right"),
        jf.WeldJoint(box, None, (0, 0, 0), name="middle"),
    ]
)
contradictory = jointed(
    lambda box: [
        jf.DistanceJoint(box, None, (0, 0, 0), (0, 0, 1.0), length=0.3, name="short"),
        jf.DistanceJoint(box, None, (0, 0, 0), (0, 0, 1.0), length=0.6, name="long"),
    ]
)


@case("redundant joints", "joints", RIGID)
def repeated(at: Setting) -> Told:
    """Two welds and the same ball joint twice: it stays where it is."""
    world = redundant(at)
    run = roll(world, DT, 60)
    off = float(np.abs(np.asarray(run.end.rigid.positions, float)).max())
    return Told([Wanted("moved [m]", off, 1e-6 if not at.single else 1e-4), Wanted("bad status", run.status, 0)], [run])


def impossible(name: str, world, routes, quick: bool = False) -> None:
    @case(name, "joints", routes, quick=quick)
    def found(at: Setting) -> Told:
        """Nothing can be right here but a word."""
        scene = world(at)
        run = roll(scene, DT, 60)
        gap = open_by(scene, run)
        return Told([Wanted("joints open [m]", gap, 1e-3)], [run])


impossible("joints that contradict each other", contradictory, RIGID, True)


@functools.cache
def apart(at: Setting) -> World:
    """A box whose two corners are each held at one place of the world, moved half a metre apart from each other."""
    box = jf.RigidBody(jf.Box((0.5, 0.1, 0.1)), mass=1.0, name="box")
    held = jf.RigidBody(jf.Box((0.1,) * 3), mass=1.0, position=(-0.25, 0, 0), fixed=True, name="post")
    moved = jf.RigidBody(
        jf.Box((0.1,) * 3), mass=1.0, position=(0.25, 0, 0), motion=jf.Motion(velocity=(0.5, 0, 0)), name="puller"
    )
    joints = [jf.BallJoint(box, held, (-0.25, 0, 0), name="left"), jf.BallJoint(box, moved, (0.25, 0, 0), name="right")]
    return built(jf.Scene([box, held, moved], joints=joints), at, size=0.5)


impossible("a body pulled apart by its joints", apart, RIGID)


@functools.cache
def soft_impossible(at: Setting) -> World:
    """A soft cube one of whose points should be in two places."""
    cube = soft_cube(cube_mesh(-SIDE / 2))
    joints = [
        jf.DistanceJoint(cube, None, (0, 0, 0), (0, 0, 1.0), length=0.3, name="short"),
        jf.DistanceJoint(cube, None, (0, 0, 0), (0, 0, 1.0), length=0.6, name="long"),
    ]
    return built(jf.Scene([cube], joints=joints), at, size=1.0)


impossible("a soft point in two places", soft_impossible, SOFT)


@functools.cache
def motor(at: Setting) -> World:
    """A link of 1 g turned by a motor, a link of 1 kg at its end."""
    link = jf.RigidBody(jf.Box((0.1, 0.02, 0.02)), mass=1e-3, position=(0.05, 0, 0), name="link")
    load = jf.RigidBody(jf.Box((0.1, 0.02, 0.02)), mass=1.0, position=(0.15, 0, 0), name="load")
    joints = [
        jf.HingeJoint(link, None, (0, 0, 0), (0, 0, 1), motor=jf.Motor(5.0, 1e6), name="hinge"),
        jf.BallJoint(load, link, (0.1, 0, 0), name="elbow"),
    ]
    return built(jf.Scene([link, load], (0, 0, 0), joints=joints), at, size=0.2)


@case("motor of 1e6 N m on 1 g", "joints", RIGID)
def strong_motor(at: Setting) -> Told:
    """It holds its rate, and the elbow holds."""
    world = motor(at)
    run = roll(world, DT, 120)
    rate = abs(float(np.asarray(run.end.rigid.angular_velocities, float)[0, 2]))
    wanted = [
        Wanted("rate off 5 rad/s", abs(rate - 5), 0.05),
        Wanted("joints open [m]", open_by(world, run), 1e-3),
        Wanted("bad status", run.status, 0),
    ]
    return Told(wanted, [run])


@functools.cache
def rope(at: Setting) -> World:
    """100 kg on a rope of 1 m that is slack at the start, over a ring of 1 g in its middle."""
    ring = jf.RigidBody(jf.Sphere(0.02), mass=1e-3, position=(0.3, 0, 0), name="ring")
    load = jf.RigidBody(jf.Sphere(0.1), mass=100.0, position=(0.6, 0, 0), name="load")
    joints = [
        jf.DistanceJoint(ring, None, (0.3, 0, 0), (0, 0, 0), length=0.5, rope=True, name="upper"),
        jf.DistanceJoint(load, ring, (0.6, 0, 0), (0.3, 0, 0), length=0.5, rope=True, name="lower"),
    ]
    return built(jf.Scene([ring, load], joints=joints), at, size=1.0)


@case("slack rope that snaps taut", "joints", RIGID)
def snapping(at: Setting) -> Told:
    """100 kg fall into a rope with 1 g in its middle: it does not give, and energy does not grow."""
    world = rope(at)
    run = roll(world, DT, 180)
    ring, load = np.array([np.asarray(each.rigid.positions, float) for each in run.frames]).transpose(1, 0, 2)
    longest = max(np.linalg.norm(ring, axis=1).max(), np.linalg.norm(load - ring, axis=1).max())
    wanted = [
        Wanted("longer than it is [m]", float(longest) - 0.5, 5e-3),
        Wanted("energy growth", run.energy_growth, 1e-3),
        Wanted("bad status", run.status, 0),
    ]
    return Told(wanted, [run])
