"""Bodies on slopes: what they do follows from Coulomb's law. Gravity is turned, not the ground."""

import numpy as np

from hard.case import Setting, Told, Wanted, case
from hard.running import Run, roll
from hard.worlds import DT, RIGID, SOFT, changed, floor_cube, ground, smooth_ground, tilted

STEPS = 60
G = 9.81


def pulled(run: Run, path: np.ndarray, towards: float, steps: int) -> float:
    """Acceleration down the slope [m/s^2], from the way in `steps` steps from rest."""
    a = np.radians(towards)
    way = float(path @ (np.cos(a), np.sin(a), 0))
    return 2 * way / (DT**2 * steps * (steps + 1))


def on_slope(name: str, degrees: float, friction: float, towards: float = 0.0, quick: bool = False) -> None:
    """A soft and a rigid case of a body on a slope: what it should do follows from Coulomb's law."""
    angle = np.radians(degrees)
    right = G * max(0.0, np.sin(angle) - friction * np.cos(angle))

    def judge(run: Run, path: np.ndarray) -> Told:
        off = abs(pulled(run, path, towards, STEPS) - right)
        return Told(
            [Wanted("error of the acceleration [m/s^2]", off, 0.03 * G), Wanted("bad status", run.status, 0)], [run]
        )

    @case(f"soft cube, {name}", "slopes", SOFT)
    def soft(at: Setting) -> Told:
        world = floor_cube(at)
        run = roll(world, DT, STEPS, None, changed(tilted(world.params, degrees, G, towards), friction=friction))
        return judge(run, (np.asarray(run.end.positions, float) - np.asarray(world.model.rest, float)).mean(0))

    @case(f"rigid box, {name}", "slopes", RIGID, quick=quick)
    def rigid(at: Setting) -> Told:
        world = ground(at)
        run = roll(world, DT, STEPS, None, changed(tilted(world.params, degrees, G, towards), friction=friction))
        return judge(run, np.asarray(run.end.rigid.positions - run.frames[0].rigid.positions, float)[0])


on_slope("slope of 20 degrees, friction 0.5: holds", 20, 0.5, quick=True)
on_slope("slope of 35 degrees, friction 0.5: slides", 35, 0.5, quick=True)
on_slope("slope of 30 degrees along the diagonal, friction 0.5: slides", 30, 0.5, 45.0)
on_slope("slope of 40 degrees, friction 10: holds", 40, 10.0)
on_slope("slope of 40 degrees, friction 1e6: holds", 40, 1e6, quick=True)


@case("friction declared 0, 0.5 in params", "slopes", RIGID)
def set_later(at: Setting) -> Told:
    """It holds on a slope of 10 degrees as if it had been declared, or `params` refuse it."""
    world = smooth_ground(at)
    run = roll(world, DT, STEPS, None, changed(tilted(world.params, 10), friction=0.5))
    way = float(np.abs(np.asarray(run.end.rigid.positions - run.frames[0].rigid.positions, float)).max())
    return Told([Wanted("slid [m]", way, 1e-3)], [run])
