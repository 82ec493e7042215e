"""MuJoCo: rigid bodies, joints, and flex for soft ones (its own grid of tetrahedra, 27 vertices).

Chains are given as trees of ball joints, its own way of joints; contradictory ones as equality constraints. Every case
is tried with all of its integrators, and the best outcome counts.
"""

from functools import partial

import mujoco
import numpy as np
from hard.wanted import Wanted

from hard_others.shared import BAD_START, CHAINS, SIDE, SLOPES, TIMES, pull, recovery, slid

NAME, VERSION = "MuJoCo", mujoco.__version__
STEPS = {"1/60 s": 1 / 60, "2 ms, its own": 2e-3}
INTEGRATORS = ("discrete", "implicit", "implicitfast", "Euler", "RK4")


class Scene:
    """A model from XML, and what it warned of."""

    integrator = INTEGRATORS[0]

    def __init__(self, body: str, dt: float, gravity=(0, 0, -9.81), more: str = ""):
        pull = " ".join(f"{each:.9g}" for each in gravity)
        self.model = mujoco.MjModel.from_xml_string(
            f'<mujoco><option timestep="{dt:.9g}" gravity="{pull}" integrator="{Scene.integrator}" cone="elliptic"/>'
            f"<worldbody>{body}</worldbody>{more}</mujoco>"
        )
        self.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
        self.data = mujoco.MjData(self.model)
        self.dt = dt

    def run(self, duration: float, each=None):
        """Steps to `duration` [s]; `each` is called after every step."""
        mujoco.mj_forward(self.model, self.data)
        for _ in range(round(duration / self.dt)):
            mujoco.mj_step(self.model, self.data)
            if each:
                each()
        mujoco.mj_forward(self.model, self.data)

    @property
    def energy(self) -> float:
        """Kinetic and potential [J]."""
        return float(self.data.energy.sum())

    @property
    def flags(self) -> list[str]:
        """Its own warnings, by name."""
        names = [name for name in mujoco.mjtWarning.__members__ if name.startswith("mjWARN")]
        return [f"{name} {one.number} times" for name, one in zip(names, self.data.warning, strict=False) if one.number]


def flex(young=1e5, poisson=0.3, pos="0 0 0", pin="", contact=True, mass=1.0, damping=0.01, count="3 3 3") -> str:
    """A soft cube of 1 dm."""
    touching = "" if contact else 'contype="0" conaffinity="0"'
    return (
        f'<flexcomp name="cube" type="grid" dim="3" count="{count}" spacing=".05 .05 .05" radius=".001" mass="{mass}" '
        f'pos="{pos}"><elasticity young="{young}" poisson="{poisson}" damping="{damping}"/>'
        f'<contact selfcollide="none" {touching}/>{pin}</flexcomp>'
    )


def soft_start(change, dt: float):
    """A free soft cube from a bad start."""
    scene = Scene(flex(contact=False), dt, (0, 0, 0))
    mujoco.mj_forward(scene.model, scene.data)
    rest = scene.data.flexvert_xpos.copy()
    scene.data.qpos[:] = (change(rest) - rest).ravel()
    scene.run(TIMES["free"])
    back = recovery(rest, scene.data.flexvert_xpos)
    return [Wanted("distance from its shape over size", back, 1e-2)], scene.flags


def on_floor(dt: float, duration: float, speed=(0, 0, 0), lift=0.0, gravity=9.81, then: float = 0.0):
    """A soft cube on a plane; with `then` [s] more under usual gravity."""
    plane = '<geom type="plane" size="50 50 1" friction=".5 .005 .0001"/>'
    scene = Scene(plane + flex(pos=f"0 0 {SIDE / 2 + 0.001}"), dt, (0, 0, -gravity))
    mujoco.mj_forward(scene.model, scene.data)
    rest, low = scene.data.flexvert_xpos.copy(), [0.0]
    scene.data.qpos[2::3] += lift
    scene.data.qvel[:] = np.tile(speed, len(rest))

    def watch():
        low[0] = min(low[0], float(scene.data.flexvert_xpos[:, 2].min()))

    scene.run(duration, watch)
    if then:
        scene.model.opt.gravity[2] = -9.81
        scene.run(then, watch)
    back = recovery(rest, scene.data.flexvert_xpos)
    wanted = [Wanted("distance from its shape over size", back, 0.03), Wanted("deepest node [m]", -low[0], 2e-3)]
    return wanted, scene.flags


def brick(dt: float):
    """Sag of a clamped brick at 1 GPa against that at 10 MPa."""
    sags, flags = [], []
    for young in (1e7, 1e9):
        pin = '<pin id="' + " ".join(str(k) for k in range(9)) + '"/>'
        scene = Scene(flex(young=young, pin=pin, contact=False, mass=4.0, count="9 3 3"), dt)
        mujoco.mj_forward(scene.model, scene.data)
        rest = scene.data.flexvert_xpos.copy()
        scene.run(5.0)
        sags.append(float((rest - scene.data.flexvert_xpos)[:, 2].max()))
        flags += scene.flags
    return [Wanted("sag against that of 10 MPa", abs(100 * sags[1] / sags[0] - 1), 0.02)], flags


def tower(dt: float):
    """1000 kg on a soft cube of 1 g."""
    plane = '<geom type="plane" size="50 50 1"/>'
    block = f'<body pos="0 0 {1.5 * SIDE + 0.002}"><freejoint/><geom type="box" size=".05 .05 .05" mass="1000"/></body>'
    scene = Scene(plane + flex(young=1e8, mass=1e-3, damping=0.02, pos=f"0 0 {SIDE / 2 + 0.001}") + block, dt)
    scene.run(1.0)
    place = scene.data.xpos[-1]
    wanted = [
        Wanted("height of the block off 0.149 [m]", abs(float(place[2]) - 0.149), 4e-3),
        Wanted("aside [m]", float(np.abs(place[:2]).max()), 5e-3),
    ]
    return wanted, scene.flags


def chain(mass: float, gravity: float, dt: float):
    """Ten links and a ball, let go horizontally."""
    inner = (
        f'<body pos=".1 0 0"><joint type="ball"/><geom type="sphere" size=".05" pos=".05 0 0" mass="{mass}"/></body>'
    )
    for k in range(10):
        at = "0 0 0" if k == 9 else ".1 0 0"
        link = '<joint type="ball"/><geom type="box" size=".05 .01 .01" pos=".05 0 0" mass=".001"/>'
        inner = f'<body pos="{at}">{link}{inner}</body>'
    scene = Scene(inner.replace("<geom", '<geom contype="0" conaffinity="0"'), dt, (0, 0, -gravity))
    mujoco.mj_forward(scene.model, scene.data)
    start, most = scene.energy, [0.0]
    scene.run(TIMES["chain"], lambda: most.append(scene.energy - start))
    growth = max(most) / (mass * gravity) if np.isfinite(most).all() else float("nan")
    return [Wanted("energy growth", growth, 1e-3)], scene.flags


def tumbling(spin, dt: float):
    """A free box, 10,000 steps of 1/60 s."""
    box = '<body><freejoint/><geom type="box" size=".05 .1 .15" mass="1"/></body>'
    scene = Scene(box, dt, (0, 0, 0))
    scene.data.qvel[3:] = spin
    mujoco.mj_forward(scene.model, scene.data)
    start, off = scene.energy, [0.0]

    def momentum():
        turn = scene.data.ximat[1].reshape(3, 3)
        return turn @ (scene.model.body_inertia[1] * (turn.T @ scene.data.cvel[1, :3]))

    before = momentum()
    scene.run(TIMES["tumble"], lambda: off.append(abs(scene.energy / start - 1)))
    lost = np.linalg.norm(momentum() - before) / np.linalg.norm(before)
    return [Wanted("energy off", max(off), 0.05), Wanted("angular momentum off", float(lost), 1e-9)], scene.flags


def box_on(dt: float, gravity=(0, 0, -9.81), friction=0.5, height=0.1, solref="0.02 1") -> Scene:
    """A box of 1 kg on a plane."""
    material = f'friction="{friction} .005 .0001" solref="{solref}"'
    plane = f'<geom type="plane" size="50 50 1" {material}/>'
    box = f'<body pos="0 0 {height}"><freejoint/><geom type="box" size=".1 .1 .1" mass="1" {material}/></body>'
    return Scene(plane + box, dt, gravity)


def slope(degrees: float, friction: float, towards: float, dt: float):
    """A box on a slope."""
    scene = box_on(dt, pull(degrees, towards), friction)
    scene.run(TIMES["slope"])
    moved = scene.data.qpos[:3] - (0, 0, 0.1)
    return slid(moved, degrees, friction, towards, TIMES["slope"]), scene.flags


def impact(dt: float):
    """A box at 100 m/s down and 50 m/s aside."""
    scene = box_on(dt, height=1.1)
    scene.data.qvel[:3] = (50, 0, -100)
    mujoco.mj_forward(scene.model, scene.data)
    start, most, low = scene.energy, [0.0], [1.0]

    def watch():
        most.append(scene.energy - start)
        low.append(float(scene.data.qpos[2]))

    scene.run(100 / 60, watch)
    wanted = [
        Wanted("energy growth", max(most) / start, 1e-3),
        Wanted("under the floor [m]", max(0.0, 0.1 - min(low)), 1e-3),
    ]
    return wanted, scene.flags


def buried(dt: float):
    """A box half a metre under the ground."""
    scene, fastest = box_on(dt, height=-0.4), [0.0]
    scene.run(5.0, lambda: fastest.append(float(np.abs(scene.data.qvel[:3]).max())))
    under = max(0.0, 0.1 - float(scene.data.qpos[2]))
    return [
        Wanted("fastest [m/s]", max(fastest), 3.0),
        Wanted("under the ground at the end [m]", under, 1e-3),
    ], scene.flags


def contradictory(dt: float):
    """One point of a box connected to two places."""
    box = '<body name="box"><freejoint/><geom type="box" size=".25 .05 .05" mass="1"/><site name="middle"/></body>'
    places = '<site name="one" pos="0 0 .7"/><site name="two" pos="0 0 .4"/>'
    pairs = '<connect site1="middle" site2="one"/><connect site1="middle" site2="two"/>'
    scene = Scene(box + places, dt, more=f"<equality>{pairs}</equality>")
    scene.run(1.0)
    gap = max(abs(float(scene.data.qpos[2]) - 0.7), abs(float(scene.data.qpos[2]) - 0.4))
    return [Wanted("joints open [m]", gap, 1e-3)], scene.flags


def motor(dt: float):
    """A velocity servo of 1e6 N m on a link of 1 g, 1 kg at its end."""
    shape = '<geom type="box" size=".05 .01 .01" pos=".05 0 0"'
    load = f'<body pos=".1 0 0"><joint type="ball"/>{shape} mass="1"/></body>'
    link = f'<body><joint name="h" axis="0 0 1"/>{shape} mass=".001"/>{load}</body>'
    servo = '<actuator><velocity joint="h" kv="1e6" forcerange="-1e6 1e6"/></actuator>'
    scene = Scene(link.replace("<geom", '<geom contype="0" conaffinity="0"'), dt, (0, 0, 0), servo)
    scene.data.ctrl[:] = 5.0
    scene.run(2.0)
    return [Wanted("rate off 5 rad/s", abs(float(scene.data.qvel[0]) - 5), 0.05)], scene.flags


def lost(dt: float):
    """NaN in the start."""
    scene = box_on(dt)
    scene.data.qpos[0] = np.nan
    scene.run(0.1)
    return [Wanted("not finite", float(not np.isfinite(scene.data.qpos).all() or bool(scene.flags)), 0)], scene.flags


def best(function, dt: float):
    """The best outcome of all integrators: all that is wanted, else a flag, else the first."""
    found, errors = [], []
    for Scene.integrator in INTEGRATORS:
        try:
            found.append(function(dt))
        except ValueError as refusal:
            errors.append(refusal)
            continue
        if all(each.holds for each in found[-1][0]):
            return found[-1]
    if not found:
        raise errors[0]
    return next((each for each in found if each[1]), found[0])


ASKED = {
    **{name: partial(soft_start, change) for name, change in BAD_START.items()},
    "brick of 1 GPa": brick,
    "200 g and back": lambda dt: on_floor(dt, 1 / 3, gravity=200 * 9.81, then=10 / 3),
    "soft cube strikes at 100 m/s": lambda dt: on_floor(dt, 10 / 3, (50, 0, -100), 1.0),
    "1000 kg on 1 g": tower,
    **{name: partial(chain, *values) for name, values in CHAINS.items()},
    "1e4 steps of tumbling": partial(tumbling, (0.1, 100.0, 0.0)),
    **{f"rigid box, {name}": partial(slope, *values) for name, values in SLOPES.items()},
    "rigid box strikes at 100 m/s": impact,
    "rigid box half a metre under the ground": buried,
    "joints that contradict each other": contradictory,
    "motor of 1e6 N m on 1 g": motor,
    "NaN in the start": lost,
}
CASES = {name: partial(best, function) for name, function in ASKED.items()}
