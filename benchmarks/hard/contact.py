"""Contact: crushing, slopes, impacts, overlap, thin plates, heavy on light."""

import jax.numpy as jnp
import numpy as np

from hard.case import Setting, Told, Wanted, case
from hard.running import Run, World, recovery, roll
from hard.soft import stretched
from hard.worlds import DT, RIGID, SIDE, SOFT, changed, floor_cube, ground, pair, plate, rim_on_rim, tower


def lowest(run: Run) -> float:
    """How far the lowest node of any frame is under the floor [m]."""
    return max(0.0, -min(float(np.asarray(frame.positions)[:, 2].min()) for frame in run.frames))


def moving(world: World, speed, at: str = "soft"):
    """The start with all velocities (3,) [m/s]."""
    dtype = world.model.rest.dtype
    state = world.state.replace(velocities=jnp.broadcast_to(jnp.asarray(speed, dtype), world.model.rest.shape))
    if state.rigid is not None and at != "nodes":
        rigid = state.rigid
        state = state.replace(
            rigid=rigid.replace(velocities=jnp.broadcast_to(jnp.asarray(speed, dtype), rigid.velocities.shape))
        )
    return state


def raised(world: World, height: float):
    """The start with everything lifted [m]."""
    up = jnp.asarray((0, 0, height), world.model.rest.dtype)
    state = world.state.replace(positions=world.state.positions + up)
    if state.rigid is not None:
        state = state.replace(rigid=state.rigid.replace(positions=state.rigid.positions + up))
    return state


@case("200 g and back", "soft contact", SOFT, quick=True)
def crushed(at: Setting) -> Told:
    """A third of a second at 200 g, then at rest: back in shape, and no node ever under the floor."""
    world = floor_cube(at)
    heavy = world.params.replace(gravity=world.params.gravity * 200)
    down = roll(world, DT, 20, None, heavy)
    up = roll(world, DT, 200, down.end)
    back = recovery(world, up.end)
    wanted = [
        Wanted("distance from its shape over size", back, 0.03),
        Wanted("deepest node [m]", max(lowest(down), lowest(up)), 1e-3),
        Wanted("inverted at the end", int(up.infos[-1].inverted), 0),
        Wanted("bad status", max(down.status, up.status), 0),
    ]
    return Told(wanted, [down, up], recovery=back)


@case("g = 1e4 on a soft cube", "soft contact", SOFT)
def strong_pull(at: Setting) -> Told:
    """A thousand times its weight: no node under the floor, nothing lost."""
    world = floor_cube(at)
    run = roll(world, DT, 100, None, world.params.replace(gravity=jnp.asarray((0, 0, -1e4), world.model.rest.dtype)))
    return Told([Wanted("deepest node [m]", lowest(run), 1e-3), Wanted("bad status", run.status, 0)], [run])


def struck(at: Setting, world: World, run: Run) -> Told:
    """After an impact: above the floor, in shape, without energy from nothing."""
    back = recovery(world, run.end)
    wanted = [
        Wanted("energy growth", run.energy_growth, at.rounding(1e-6, 1e-3)),
        Wanted("deepest node [m]", lowest(run), 2e-3),
        Wanted("distance from its shape over size", back, 0.03),
        Wanted("bad status", run.status, 0),
    ]
    return Told(wanted, [run], recovery=back)


@case("soft cube strikes at 100 m/s", "soft contact", SOFT, quick=True)
def soft_impact(at: Setting) -> Told:
    """Down, and half aside."""
    world = floor_cube(at)
    state = moving(world, (50.0, 0, -100.0)).replace(positions=raised(world, 1.0).positions)
    return struck(at, world, roll(world, DT, 200, state))


@case("soft cube with restitution 1", "soft contact", SOFT)
def soft_bouncy(at: Setting) -> Told:
    """Energy never above its start."""
    world = floor_cube(at)
    run = roll(world, DT, 200, raised(world, 0.3), changed(world.params, restitution=1.0))
    return Told(
        [Wanted("energy growth", run.energy_growth, at.rounding(1e-6, 1e-3)), Wanted("bad status", run.status, 0)],
        [run],
    )


@case("dt 1 s on the floor", "soft contact", SOFT)
def long_steps(at: Setting) -> Told:
    """A stretched cube on the floor, in steps of a second."""
    world = floor_cube(at)
    start = world.moved(lambda x: stretched(x) - stretched(x)[:, 2].min() * np.array([0, 0, 1]))
    run = roll(world, 1.0, 60, start)
    back = recovery(world, run.end)
    return Told(
        [Wanted("distance from its shape over size", back, 0.03), Wanted("bad status", run.status, 0)],
        [run],
        recovery=back,
    )


def out_of_the_floor(name: str, depth: float, quick: bool) -> None:
    """A case that starts in the floor by a share of the cube's height."""

    @case(name, "overlap", SOFT, quick=quick)
    def found(at: Setting) -> Told:
        world = floor_cube(at)
        run = roll(world, DT, 200, raised(world, -depth * SIDE))
        speed = max(float(np.linalg.norm(np.asarray(each.velocities), axis=1).max()) for each in run.frames)
        wanted = [
            Wanted("fastest [m/s]", speed, 2.0),
            Wanted("under the floor at the end [m]", max(0.0, -float(run.end.positions[:, 2].min())), 1e-3),
            Wanted("distance from its shape over size", recovery(world, run.end), 0.03),
        ]
        return Told(wanted, [run], recovery=recovery(world, run.end))


out_of_the_floor("soft cube half in the floor", 0.5, True)
out_of_the_floor("soft cube under the floor", 1.2, False)


@case("rigid box and ball strike at 100 m/s", "rigid contact", RIGID, quick=True)
def rigid_impact(at: Setting) -> Told:
    """They stay above the floor and gain nothing."""
    world = ground(at)
    state = moving(world, (50.0, 0, -100.0)).replace(rigid=raised(world, 1.0).rigid)
    state = state.replace(rigid=state.rigid.replace(velocities=moving(world, (50.0, 0, -100.0)).rigid.velocities))
    run = roll(world, DT, 100, state)
    low = max(0.0, 0.1 - min(float(np.asarray(each.rigid.positions)[:, 2].min()) for each in run.frames))
    wanted = [
        Wanted("energy growth", run.energy_growth, at.rounding(1e-6, 1e-3)),
        Wanted("under the floor [m]", low, 1e-3),
        Wanted("bad status", run.status, 0),
    ]
    return Told(wanted, [run])


@case("restitution 1, ball", "rigid contact", RIGID, quick=True)
def bouncy(at: Setting) -> Told:
    """A ball dropped from 1 m comes back to 1 m, again and again, and never higher."""
    world = ground(at)
    run = roll(world, DT, 300, raised(world, 1.0), changed(world.params, restitution=1.0))
    top = max(float(each.rigid.positions[1, 2]) for each in run.frames[len(run.frames) // 2 :]) - 0.1
    growth = run.energy_growth * run.scale / (2 * 9.81)  # over the energy of a fall of 1 m
    return Told([Wanted("energy growth", growth, 0.05), Wanted("height off 1 m [m]", abs(1 - top), 0.05)], [run])


@case("restitution 0.5, ball", "rigid contact", RIGID)
def half_bouncy(at: Setting) -> Told:
    """Tops of e^2 and e^4 (dt 1/60)."""
    world = ground(at)
    run = roll(world, DT, 100, raised(world, 1.0), changed(world.params, restitution=0.5))
    # In flight, z + v^2 / 2 g is the top; the flights' middles are at 0.68 and 1.02 s.
    found = [(float(each.rigid.positions[1, 2]) - 0.1, float(each.rigid.velocities[1, 2])) for each in run.frames]
    tops = [found[k][0] + found[k][1] ** 2 / (2 * 9.81) for k in (8, 12)]
    off = max(abs(tops[0] / 0.25 - 1), abs(tops[1] / 0.0625 - 1))
    return Told([Wanted("error of two tops", off, 0.05)], [run], note=f"tops {tops[0]:.3f} and {tops[1]:.3f} m")


@case("g = 1e4 on a rigid box", "rigid contact", RIGID)
def rigid_pull(at: Setting) -> Told:
    """It stays where it is."""
    world = ground(at)
    run = roll(
        world, DT, 100, None, world.params.replace(gravity=jnp.asarray((0, 0, -1e4), world.params.gravity.dtype))
    )
    off = float(np.abs(np.asarray(run.end.rigid.positions - run.frames[0].rigid.positions, float)).max())
    return Told([Wanted("moved [m]", off, 1e-3), Wanted("bad status", run.status, 0)], [run])


@case("rigid box half a metre under the ground", "overlap", RIGID, quick=True)
def buried(at: Setting) -> Told:
    """It comes up, slowly."""
    world = ground(at)
    run = roll(world, DT, 300, raised(world, -0.5))
    speed = max(float(np.abs(each.rigid.velocities).max()) for each in run.frames)
    under = max(0.0, 0.1 - float(run.end.rigid.positions[:, 2].min()))
    return Told([Wanted("fastest [m/s]", speed, 3.0), Wanted("under the ground at the end [m]", under, 1e-3)], [run])


@case("rigid bodies at rest for 1e5 steps", "long", RIGID, long=True)
def resting(at: Setting) -> Told:
    """They neither creep nor sink."""
    world = ground(at)
    run = roll(world, DT, 100_000)
    off = float(np.abs(np.asarray(run.end.rigid.positions - run.frames[0].rigid.positions, float)).max())
    return Told([Wanted("moved [m]", off, 1e-3), Wanted("bad status", run.status, 0)], [run])


@case("two boxes without friction", "symmetry", RIGID)
def drifting(at: Setting) -> Told:
    """On top of each other they do not drift aside."""
    world = pair(at)
    run = roll(world, DT, 600)
    aside = float(np.abs(np.asarray(run.end.rigid.positions, float)[:, :2]).max())
    return Told([Wanted("aside after 10 s [m]", aside, 1e-3), Wanted("bad status", run.status, 0)], [run])


def into_each_other(name: str, depth: float) -> None:
    @case(name, "overlap", RIGID)
    def found(at: Setting) -> Told:
        world = pair(at, depth)
        run = roll(world, DT, 200)
        gap = float(run.end.rigid.positions[1, 2] - run.end.rigid.positions[0, 2]) - 0.2
        speed = max(float(np.abs(each.rigid.velocities).max()) for each in run.frames)
        return Told([Wanted("fastest [m/s]", speed, 2.0), Wanted("still inside [m]", max(0.0, -gap), 2e-3)], [run])


into_each_other("two rigid boxes, half inside each other", 0.1)
into_each_other("two rigid boxes in one place", 0.2)


def heavy(name: str, tolerance: float | None, quick: bool) -> None:
    @case(name, "mass ratio", SOFT, quick=quick)
    def found(at: Setting) -> Told:
        world = tower(at)
        model = world.model
        if tolerance is not None:
            model = model.replace(tolerance=jnp.asarray(tolerance, model.rest.dtype))
        run = roll(World(model, world.params, world.state), DT, 60)
        place = np.asarray(run.end.rigid.positions, float)[0]
        most = int(world.model.max_iterations)
        wanted = [
            Wanted("height of the block off 0.149 [m]", abs(place[2] - 0.149), 2e-3),
            Wanted("aside [m]", float(np.abs(place[:2]).max()), 5e-3),
            Wanted("iterations over their limit", run.iterations / most, 1.0),
            Wanted("bad status", run.status, 0),
        ]
        return Told(wanted, [run])


heavy("1000 kg on 1 g", None, False)
heavy("1000 kg on 1 g, tolerance 1e-6", 1e-6, False)
heavy("1000 kg on 1 g, tolerance 1e-11", 1e-11, False)


def on_its_outline(name: str, below: str) -> None:
    @case(name, "soft contact", SOFT, quick=True)
    def found(at: Setting) -> Told:
        world = rim_on_rim(at, below)
        run = roll(world, DT, 120)
        rest, places = (np.asarray(each, float) for each in (world.model.rest, run.end.positions))
        # Nodes of the face of the cube lie where those of the one below do, or level on the box.
        count = len(rest) // (1 if below == "box" else 2)
        face = np.flatnonzero(np.isclose(rest[:count, 2], SIDE, atol=1e-6))
        level = np.full(len(face), SIDE)
        if below != "box":
            level = np.array([places[count:][np.abs(rest[count:] - rest[k]).sum(1).argmin(), 2] for k in face])
        wanted = [
            Wanted("faces apart or in each other [m]", float(np.abs(places[face, 2] - level).max()), 5e-5),
            Wanted("iterations of the worst step over their limit", run.iterations / 2000, 1.0),
            Wanted("bad status", run.status, 0),
        ]
        return Told(wanted, [run])


on_its_outline("soft cube on a cube of its mesh", "cube")
on_its_outline("soft cube on a rigid box of its outline", "box")


def flying(speed: float, seed: int) -> None:
    @case(f"thin plate at {speed:g} m/s, seed {seed}", "thin", SOFT[:1], long=True)
    def found(at: Setting) -> Told:
        world = plate(at)
        turn = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]
        turn = turn * np.sign(np.linalg.det(turn))
        rest = np.asarray(world.model.rest, float)
        places = (rest - rest.mean(0)) @ turn.T + (0, 0, 0.3)
        state = moving(world, (0, 0, -speed), "nodes").replace(positions=jnp.asarray(places, world.model.rest.dtype))
        run = roll(world, DT, 20, state)
        inside = np.abs(np.asarray(run.end.positions, float)[:, :2]).max(1) < 0.3
        under = np.asarray(run.end.positions, float)[inside, 2].min(initial=0.0)
        wanted = [
            Wanted("through the slab [m]", max(0.0, -float(under)), 3e-3),
            Wanted("energy growth", run.energy_growth, 1e-3),
            Wanted("bad status", run.status, 0),
        ]
        return Told(wanted, [run], recovery=recovery(world, run.end))


for _speed in (50.0, 200.0):
    for _seed in range(2):
        flying(_speed, _seed)
