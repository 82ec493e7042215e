"""Newton (on Warp, single precision, CPU): XPBD, VBD and its MuJoCo solver; the best outcome counts.

Limits that rounding decides are those of our cases in single precision.
"""

from functools import partial

import newton
import numpy as np
import warp as wp
from hard.wanted import Wanted

from hard_others.shared import BAD_START, CHAINS, SIDE, SLOPES, TIMES, cells, pull, recovery, slid

wp.config.quiet = True
NAME, VERSION = "Newton", newton.__version__
STEPS = {"1/60 s": 1 / 60, "1/600 s, its own": 1 / 600}
SOFT = {
    "XPBD": lambda model: newton.solvers.SolverXPBD(model, iterations=20),
    "VBD": lambda model: newton.solvers.SolverVBD(model, iterations=20),
}
RIGID = {
    "XPBD": lambda model: newton.solvers.SolverXPBD(model, iterations=20),
    "MuJoCo": lambda model: newton.solvers.SolverMuJoCo(model),
}


def builder(gravity) -> newton.ModelBuilder:
    """An empty scene with gravity (3,) [m/s^2], set after it is finished."""
    made = newton.ModelBuilder()
    made.custom_gravity = tuple(float(each) for each in gravity)
    return made


def simulated(made: newton.ModelBuilder, solver, dt: float, duration: float, change=None, each=None):
    """The state after `duration` [s]; `change(state)` spoils the start, `each(state)` looks at every step."""
    made.color()
    model = made.finalize(device="cpu")
    model.set_gravity(made.custom_gravity)
    one, other, control = model.state(), model.state(), model.control()
    newton.eval_fk(model, model.joint_q, model.joint_qd, one)
    if change:
        change(model, one)
    stepping, contacts = solver(model), model.contacts()
    for _ in range(round(duration / dt)):
        one.clear_forces()
        model.collide(one, contacts)
        stepping.step(one, other, control, contacts, dt)
        one, other = other, one
        if each:
            each(one)
    return one


def soft(made: newton.ModelBuilder, young: float = 1e5, poisson: float = 0.3, height: float = 0.0) -> np.ndarray:
    """A soft cube of 1 dm and 1 kg; its rest shape."""
    points, tets = cells()
    points = points + np.array([0, 0, height])
    made.add_soft_mesh(
        pos=wp.vec3(0, 0, 0),
        rot=wp.quat_identity(),
        scale=1.0,
        vel=wp.vec3(0, 0, 0),
        vertices=[wp.vec3(*point) for point in points],
        indices=tets.ravel().tolist(),
        density=1000.0,
        k_mu=young / (2 + 2 * poisson),
        k_lambda=young * poisson / ((1 + poisson) * (1 - 2 * poisson)),
        k_damp=0.01,
        particle_radius=1e-3,
    )
    return points


def soft_start(change, solver, dt: float):
    """A free soft cube from a bad start."""
    made = builder((0, 0, 0))
    rest = soft(made)
    state = simulated(
        made, solver, dt, TIMES["free"], lambda _, s: s.particle_q.assign(change(rest).astype(np.float32))
    )
    back = recovery(rest, state.particle_q.numpy())
    return [Wanted("distance from its shape over size", back, 1e-2)], []


def on_floor(speed, lift: float, solver, dt: float):
    """A soft cube that strikes the ground."""
    made = builder((0, 0, -9.81))
    rest, low = soft(made, height=SIDE / 2 + 0.002 + lift), [0.0]
    made.add_ground_plane()

    def start(_, state):
        state.particle_qd.assign(np.tile(np.float32(speed), (len(rest), 1)))

    state = simulated(
        made, solver, dt, TIMES["free"], start, lambda s: low.append(float(s.particle_q.numpy()[:, 2].min()))
    )
    back = recovery(rest, state.particle_q.numpy())
    return [Wanted("distance from its shape over size", back, 0.03), Wanted("deepest node [m]", -min(low), 2e-3)], []


def box(made: newton.ModelBuilder, half, mass: float, height: float, friction: float = 0.5) -> int:
    """A free rigid box."""
    volume = 8 * float(np.prod(half))
    body = made.add_body(xform=wp.transform((0, 0, height), wp.quat_identity()))
    cfg = newton.ModelBuilder.ShapeConfig(density=mass / volume, mu=friction)
    made.add_shape_box(body, hx=half[0], hy=half[1], hz=half[2], cfg=cfg)
    return body


def tumbling(spin, solver, dt: float):
    """A free box, as long as 1e4 steps of 1/60 s."""
    made = builder((0, 0, 0))
    box(made, (0.05, 0.1, 0.15), 1.0, 0.0)
    own = np.diag([0.13, 0.1, 0.05]) / 12.0
    kinetic, momenta = [], []

    def start(model, state):
        speeds = np.array([[0, 0, 0, *spin]], np.float32)
        state.body_qd.assign(speeds)
        model.joint_qd.assign(speeds.ravel())
        state.joint_qd.assign(speeds.ravel())

    def look(state):
        x, y, z, w = state.body_q.numpy()[0, 3:].astype(float)
        turn = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        omega = state.body_qd.numpy()[0, 3:].astype(float)
        momenta.append(turn @ own @ turn.T @ omega)
        kinetic.append(omega @ momenta[-1] / 2)

    simulated(made, solver, dt, TIMES["tumble"], start, look)
    off = np.abs(np.array(kinetic) / kinetic[0] - 1).max()
    lost = np.linalg.norm(momenta[-1] - momenta[0]) / np.linalg.norm(momenta[0])
    return [Wanted("energy off", float(off), 0.05), Wanted("angular momentum off", float(lost), 2e-3)], []


def slope(degrees: float, friction: float, towards: float, solver, dt: float):
    """A box on a slope."""
    made = builder(pull(degrees, towards))
    box(made, (0.1, 0.1, 0.1), 1.0, 0.1, friction)
    made.add_ground_plane(cfg=newton.ModelBuilder.ShapeConfig(mu=friction))
    state = simulated(made, solver, dt, TIMES["slope"])
    moved = state.body_q.numpy()[0, :3].astype(float) - (0, 0, 0.1)
    return slid(moved, degrees, friction, towards, TIMES["slope"]), []


def dropped(height: float, speed, duration: float, fastest_allowed: float | None, solver, dt: float):
    """A box that strikes the ground, or starts in it."""
    made = builder((0, 0, -9.81))
    box(made, (0.1, 0.1, 0.1), 1.0, height)
    made.add_ground_plane()
    low, fastest = [height], [0.0]

    def start(model, state):
        speeds = np.array([[*speed, 0, 0, 0]], np.float32)
        state.body_qd.assign(speeds)
        state.joint_qd.assign(speeds.ravel())

    def look(state):
        low.append(float(state.body_q.numpy()[0, 2]))
        fastest.append(float(np.abs(state.body_qd.numpy()[0, :3]).max()))

    state = simulated(made, solver, dt, duration, start, look)
    if fastest_allowed is None:
        return [Wanted("under the floor [m]", max(0.0, 0.1 - min(low)), 1e-3)], []
    under = max(0.0, 0.1 - float(state.body_q.numpy()[0, 2]))
    return [
        Wanted("fastest [m/s]", max(fastest), fastest_allowed),
        Wanted("under the ground at the end [m]", under, 1e-3),
    ], []


def chain(mass: float, gravity: float, solver, dt: float):
    """Ten links and a ball, let go horizontally."""
    made = builder((0, 0, -gravity))
    apart = newton.ModelBuilder.ShapeConfig(density=1e-3 / (0.1 * 0.02 * 0.02), has_shape_collision=False)
    ball = newton.ModelBuilder.ShapeConfig(density=mass / (4 / 3 * np.pi * 0.05**3), has_shape_collision=False)
    before, joints = -1, []
    for k in range(11):
        link = made.add_link(xform=wp.transform((0.1 * k + 0.05, 0, 0), wp.quat_identity()))
        if k < 10:
            made.add_shape_box(link, hx=0.05, hy=0.01, hz=0.01, cfg=apart)
        else:
            made.add_shape_sphere(link, radius=0.05, cfg=ball)
        at = wp.transform((0.05 if k else 0.0, 0, 0), wp.quat_identity())
        joints.append(
            made.add_joint_ball(
                before, link, parent_xform=at, child_xform=wp.transform((-0.05, 0, 0), wp.quat_identity())
            )
        )
        before = link
    made.add_articulation(joints)
    gaps, tops = [0.0], [0.0]

    def look(state):
        poses, speeds = state.body_q.numpy().astype(float), state.body_qd.numpy().astype(float)
        tops.append(mass * (gravity * poses[-1, 2] + speeds[-1, :3] @ speeds[-1, :3] / 2))
        gaps.append(float(np.linalg.norm(poses[-1, :3])) - 1.05)

    simulated(made, solver, dt, TIMES["chain"], None, look)
    growth = max(tops) / (mass * gravity) if np.isfinite(tops).all() else float("nan")
    return [Wanted("energy growth", growth, 1e-2), Wanted("longer than it is [m]", max(gaps), 1e-2)], []


def lost(solver, dt: float):
    """NaN in the start."""
    made = builder((0, 0, -9.81))
    box(made, (0.1, 0.1, 0.1), 1.0, 0.1)
    made.add_ground_plane()

    def start(model, state):
        spoilt = state.body_q.numpy()
        spoilt[0, 0] = np.nan
        state.body_q.assign(spoilt)

    state = simulated(made, solver, dt, 0.1, start)
    return [Wanted("not finite", float(not np.isfinite(state.body_q.numpy()).all()), 0)], []


def best(solvers, function, dt: float):
    """The best outcome of several solvers."""
    found, errors = [], []
    for solver in solvers.values():
        try:
            found.append(function(solver, dt))
        except Exception as refusal:  # whatever a solver says it cannot do
            errors.append(refusal)
            continue
        if all(each.holds for each in found[-1][0]):
            break
    if not found:
        raise errors[0]
    return found[-1] if all(each.holds for each in found[-1][0]) else found[0]


CASES = {
    **{name: partial(best, SOFT, partial(soft_start, change)) for name, change in BAD_START.items()},
    "soft cube strikes at 100 m/s": partial(best, SOFT, partial(on_floor, (50, 0, -100), 1.0)),
    **{f"rigid box, {name}": partial(best, RIGID, partial(slope, *values)) for name, values in SLOPES.items()},
    "rigid box strikes at 100 m/s": partial(best, RIGID, partial(dropped, 1.1, (50, 0, -100), 100 / 60, None)),
    "rigid box half a metre under the ground": partial(best, RIGID, partial(dropped, -0.4, (0, 0, 0), 5.0, 3.0)),
    **{name: partial(best, RIGID, partial(chain, *values)) for name, values in CHAINS.items()},
    "1e4 steps of tumbling": partial(best, RIGID, partial(tumbling, (0.1, 100.0, 0.0))),
    "NaN in the start": partial(best, RIGID, lost),
}
