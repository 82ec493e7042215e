"""A soft cube in empty space: bad starts, bad meshes, stiffness that jumps, long runs."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxfem as jf
from hard.case import Setting, Told, Wanted, case
from hard.running import CHUNK, Run, World, masses, momenta, points, recovery, roll
from hard.worlds import DT, SIDE, SOFT, SOFT_ALL, built, clamped_brick, cube_mesh, free_cube, soft_cube

STEPS = 200
SEEDS = 10


def recovers(at: Setting, world: World, run: Run, near: float = 1e-3) -> Told:
    """It comes back to its shape, gains no energy and keeps its linear momentum."""
    back = recovery(world, run.end)
    wanted = [
        Wanted("distance from its shape over size", back, max(near, at.rounding(0, 5e-3))),
        Wanted("energy growth", run.energy_growth, at.rounding(1e-9, 1e-4)),
        Wanted("linear momentum", run.linear_drift, at.rounding(1e-9, 1e-3)),
        Wanted("bad status", run.status, 0),
        Wanted("inverted at the end", int(run.infos[-1].inverted), 0),
    ]
    rate = turning(world, run.params, run.end)
    return Told(wanted, [run], recovery=back, note=f"turns at {rate:.3g} rad/s at the end")


def from_start(name: str, change, dt: float = DT, quick: bool = False) -> None:
    """A case that starts with changed places."""

    @case(name, "soft start", SOFT, quick=quick)
    def found(at: Setting) -> Told:
        world = free_cube(at)
        return recovers(at, world, roll(world, dt, STEPS, world.moved(change)))


def mirrored(seed: int):
    """Mirrored in x, with a little noise, so that seeds differ."""
    noise = 1e-3 * SIDE * np.random.default_rng(seed).standard_normal((35, 3))
    return lambda x: x * (-1, 1, 1) + noise


def anywhere(seed: int):
    """Each node somewhere in the cube."""
    return lambda x: np.random.default_rng(seed).uniform(-SIDE / 2, SIDE / 2, x.shape)


def stretched(x):
    """A third longer, thinner across."""
    centre = x.mean(0)
    return centre + (x - centre) * (1.3, 0.9, 0.9)


from_start("flattened", lambda x: x * (1, 1, 0), quick=True)
from_start("inside out", lambda x: -x, quick=True)
from_start("line", lambda x: x * (1, 0, 0), quick=True)
from_start("point", lambda x: x * 0, quick=True)
from_start("scaled 0.01", lambda x: x * 0.01)
from_start("scaled 10", lambda x: x * 10, quick=True)
from_start("dt 1 s", stretched, dt=1.0, quick=True)
for _seed in range(SEEDS):
    from_start(f"mirrored, seed {_seed}", mirrored(_seed), quick=_seed == 0)
    if _seed < 3:
        from_start(f"random, seed {_seed}", anywhere(_seed), quick=_seed == 0)


def turning(world: World, params, state) -> float:
    """The rate at which a body turns as a whole [rad/s]."""
    own = masses(world, params)
    _, _, angular, _ = momenta(world, params, state, own)
    places, _ = points(state)
    arms = places - own[0] @ places / own[0].sum()
    inertia = (
        own[0][:, None, None] * ((arms**2).sum(1)[:, None, None] * np.eye(3) - arms[:, :, None] * arms[:, None])
    ).sum(0)
    return float(np.linalg.norm(np.linalg.solve(inertia, angular)))


@case("spin from rest", "momentum", SOFT_ALL, quick=True)
def spin_from_rest(at: Setting) -> Told:
    """A flattened cube starts with no angular momentum, and must not turn when it is back in shape."""
    world = free_cube(at)
    state = world.moved(lambda x: x * (1, 1, 0) + 2e-3 * np.random.default_rng(1).standard_normal(x.shape))
    run = roll(world, DT, STEPS, state)
    return Told(
        [Wanted("turning at the end [rad/s]", turning(world, run.params, run.end), at.rounding(1e-6, 1e-3))], [run]
    )


@case("spin kept by a soft body", "momentum", SOFT_ALL, quick=True)
def soft_spin(at: Setting) -> Told:
    """A cube that turns at 5 rad/s keeps its angular momentum."""
    world = free_cube(at)
    speeds = 5.0 * np.cross((0, 0, 1), np.asarray(world.model.rest, float))
    state = world.state.replace(velocities=jnp.asarray(speeds, world.model.rest.dtype))
    run = roll(world, DT, STEPS, state)
    before, after = (np.linalg.norm(momenta(world, run.params, each)[2]) for each in (run.frames[0], run.end))
    lost = abs(1 - after / before) if np.isfinite(after) else np.nan
    kept = Wanted("angular momentum lost", lost, at.rounding(1e-9, 1e-3))
    wanted = [kept, Wanted("energy growth", run.energy_growth, 0.05)]
    return Told(wanted, [run], recovery=recovery(world, run.end))


@case("E jumps by 1e6 inside", "soft material", SOFT, quick=True)
def stiffness_jump(at: Setting) -> Told:
    """Half of the cube a million times stiffer."""
    world = free_cube(at)
    left = np.asarray(world.model.rest)[np.asarray(world.model.elements.cells)].mean(1)[:, 0] < 0
    young = jnp.asarray(np.where(left, 1e4, 1e10), world.model.rest.dtype)
    params = world.params.replace(young=young)
    return recovers(at, world, roll(world, DT, STEPS, world.moved(stretched), params), 0.02)


@case("E jumps by 1e6 in time", "soft material", SOFT)
def stiffness_changes(at: Setting) -> Told:
    """A stretched cube that becomes a million times stiffer: it springs back, and gains no more than it was given."""
    world = free_cube(at)
    params = world.params.replace(young=world.params.young * 1e6)
    return recovers(at, world, roll(world, DT, STEPS, world.moved(stretched), params))


@case("nu 0.4999 in a free cube", "soft material", SOFT)
def incompressible(at: Setting) -> Told:
    """Nearly incompressible, set in params."""
    world = free_cube(at)
    params = world.params.replace(poisson=jnp.asarray(0.4999, world.model.rest.dtype))
    return recovers(at, world, roll(world, DT, STEPS, world.moved(stretched), params))


def sag(world: World, params, steps: int = 40) -> tuple[float, Run]:
    """How far the end of the clamped brick hangs down at rest [m]."""
    run = roll(world, 10.0, steps, None, params)
    return float((np.asarray(world.model.rest, float) - np.asarray(run.end.positions, float))[:, 2].max()), run


@case("brick of 1 GPa", "soft material", SOFT)
def stiff_brick(at: Setting) -> Told:
    """A hundred times as stiff, a hundredth of the sag."""
    world = clamped_brick(at)
    soft, one = sag(world, world.params)
    stiff, other = sag(world, world.params.replace(young=jnp.asarray(1e9, world.model.rest.dtype)))
    off = abs(100 * stiff / soft - 1)
    return Told([Wanted("sag against that of 10 MPa", off, 0.02), Wanted("bad status", other.status, 0)], [one, other])


@case("nu 0.4999 in a bent brick, element rows", "soft material", SOFT[:1])
def locking(at: Setting) -> Told:
    """Plain tetrahedra lock: `build` must say so."""
    return bent_at(at, "element")


@case("nu 0.4999 in a bent brick, smoothed rows", "soft material", SOFT[:1])
def not_locking(at: Setting) -> Told:
    """Smoothed rows do not."""
    return bent_at(at, "smoothed")


def bent_at(at: Setting, strain: str) -> Told:
    usual, one = sag(clamped_brick(at, strain), None)
    near, other = sag(clamped_brick(at, strain, 0.4999), None)
    ratio = near / usual
    return Told(
        [Wanted("sag lost beside nu = 0.3", 1 - ratio, 0.15), Wanted("bad status", other.status, 0)], [one, other]
    )


def squeezed(mesh, share: float):
    """The cube with the middle node of its first cell at `share` of the cell's height above a face: slivers."""
    points = np.array(mesh.points)
    middle = int(np.argmin(np.linalg.norm(points - (points.min(0) + SIDE / 4), axis=1)))
    points[middle, 2] = points[:, 2].min() + share * SIDE / 4
    return jf.TetMesh(points, mesh.cells)


def of_mesh(at: Setting, mesh) -> Told:
    """A stretched cube of some mesh recovers."""
    world = built(jf.Scene([soft_cube(mesh)], gravity=(0, 0, 0)), at, free=True)
    return recovers(at, world, roll(world, DT, STEPS, world.moved(stretched)))


@case("sliver of 0.5 degrees", "soft mesh", SOFT)
def sliver(at: Setting) -> Told:
    """Elements as flat as half a degree."""
    return of_mesh(at, squeezed(cube_mesh(-SIDE / 2), float(np.tan(np.radians(0.5)))))


@case("sliver of 0.05 degrees", "soft mesh", SOFT)
def thin_sliver(at: Setting) -> Told:
    """Elements as flat as a twentieth of a degree."""
    return of_mesh(at, squeezed(cube_mesh(-SIDE / 2), float(np.tan(np.radians(0.05)))))


@case("tiny element", "soft mesh", SOFT)
def tiny(at: Setting) -> Told:
    """Cells graded in all directions: the smallest has a billionth of the largest's volume."""
    mesh = cube_mesh(-SIDE / 2)
    points = np.array(mesh.points) + SIDE / 2
    graded = np.where(points < SIDE / 2, points * 2e-3, points - (SIDE - points) * (1 - 2e-3))
    return of_mesh(at, jf.TetMesh(graded - SIDE / 2, mesh.cells))


@case("1 km from the origin", "precision", SOFT)
def far_away(at: Setting) -> Told:
    """A stretched cube a kilometre away."""
    world = free_cube(at, 1000.0)
    return recovers(at, world, roll(world, DT, STEPS, world.moved(stretched)))


@case("dt 1e-6 s, a soft body falls", "precision", SOFT, quick=True)
def tiny_steps(at: Setting) -> Told:
    """A thousand steps of a microsecond: places and speeds are those of the fall."""
    world = free_cube(at)
    params = world.params.replace(gravity=jnp.asarray((0, 0, -9.81), world.model.rest.dtype))
    steps, dt = 1000, 1e-6
    run = roll(world, dt, steps, None, params)
    moved = np.asarray(run.end.positions, float)[:, 2] - np.asarray(world.model.rest, float)[:, 2]
    fall = -9.81 * dt**2 * steps * (steps + 1) / 2
    return Told([Wanted("error of the fall", float(np.abs(moved / fall - 1).max()), 1e-2)], [run])


@case("1e5 steps, a soft body", "long", SOFT, long=True)
def long_soft(at: Setting) -> Told:
    """No energy from nothing, ever."""
    world = free_cube(at)
    run = roll(world, DT, 100_000, world.moved(stretched))
    return recovers(at, world, run)


@case("a batch with one bad lane", "batch", SOFT[:1])
def bad_lane(at: Setting) -> Told:
    """NaN in one lane of four: it says so, and the others are what they are alone."""
    world = free_cube(at)
    alone = roll(world, DT, CHUNK, world.moved(stretched))
    young = jnp.stack([world.params.young] * 4).at[2].set(jnp.nan)

    def run(lane):
        states, infos = jf.rollout(world.model, world.params.replace(young=lane), world.moved(stretched), DT, CHUNK)
        return states.positions[-1], infos.status

    places, status = jax.tree.map(np.asarray, jax.jit(jax.vmap(run))(young))
    off = np.abs(places[[0, 1, 3]] - np.asarray(alone.end.positions)).max() / SIDE
    wanted = [
        Wanted("good lanes beside one alone", float(off), at.rounding(1e-7, 1e-4)),
        Wanted("bad status of good lanes", int((status[[0, 1, 3]] != 0).any()), 0),
        Wanted("bad lanes without a status", int(not status[2].any()), 0),
    ]
    return Told(wanted, [alone])
