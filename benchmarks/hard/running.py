"""Runs of hard cases, in chunks of one length, so that all lengths share a compiled program; and what is measured.

Sums are NumPy's in double precision, whatever the run's own.
"""

import dataclasses
import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxfem as jf
from jaxfem.diagnose import words
from jaxfem.methods import Condensed
from jaxfem.model import Choice, nodal_mass
from jaxfem.solvers.status import BYTE, Status

LOST = 1e-9  # share of its angular momentum that a body may lose in a step
CHUNK, EVERY = 20, 5  # steps of a call, steps of a saved frame
PATIENCE = 2  # chunks with a bad status after which a run is given up


@dataclasses.dataclass(frozen=True)
class World:
    """A built scene. `free`: nothing outside acts on it but gravity, so that momentum is known."""

    model: Any
    params: Any
    state: Any
    free: bool = False
    size: float = 0.1

    def moved(self, change: Any) -> Any:
        """The start with the nodes' places (n, 3) changed by a function."""
        places = change(np.asarray(self.model.rest, float))
        return self.state.replace(positions=jnp.asarray(places, self.model.rest.dtype))


@dataclasses.dataclass(frozen=True)
class Run:
    """Frames of a run (its start first), and what `info` said at each but the first."""

    world: World
    params: Any
    frames: list[Any]
    infos: list[Any]
    energies: np.ndarray  # (frames, 3): kinetic, elastic, gravity [J]

    @property
    def end(self) -> Any:
        """The last state."""
        return self.frames[-1]

    @property
    def status(self) -> int:
        """The first status that is not 0, without the cause that it may name."""
        return next((int(info.status) % BYTE for info in self.infos if info.status), 0)

    @property
    def iterations(self) -> int:
        """Most iterations of a step."""
        return max(int(info.iterations) for info in self.infos)

    @property
    def last_energy(self) -> float:
        """Energy at the end [J]."""
        return float(self.energies[-1].sum())

    @property
    def scale(self) -> float:
        """An energy to compare with [J]: what is moving and strained at the start, and weight times size."""
        mass = sum(each.sum() for each in masses(self.world, self.params))
        weight = np.linalg.norm(np.asarray(self.params.gravity, float))
        return float(self.energies[0, :2].sum() + mass * weight * self.world.size)

    @property
    def energy_growth(self) -> float:
        """Largest rise of energy above its start, over `scale`."""
        total = self.energies.sum(1)
        return float((total - total[0]).max() / self.scale) if np.isfinite(total).all() and self.scale else math.nan

    @property
    def linear_drift(self) -> float:
        """Change of linear momentum that gravity does not explain, over mass times the largest typical speed."""
        return self._drifts[0]

    @property
    def angular_drift(self) -> float:
        """Change of angular momentum about the centre of mass, over mass times that speed times its radius."""
        return self._drifts[1]

    @functools.cached_property
    def _drifts(self) -> tuple[float, float]:
        if not self.world.free:
            return math.nan, math.nan
        some = self.frames[:: max(1, len(self.frames) // 400)]
        own = masses(self.world, self.params)
        found = [momenta(self.world, self.params, state, own) for state in some]
        mass, linear, angular, radius = (np.array(each) for each in zip(*found, strict=True))
        times = np.array([float(state.time) for state in some])
        speed = np.sqrt(2 * self.energies[:, :2].sum(1).max() / mass[0])
        fall = mass[0] * np.outer(times - times[0], np.asarray(self.params.gravity, float))
        if not speed:
            return math.nan, math.nan
        one = np.linalg.norm(linear - linear[0] - fall, axis=1).max() / (mass[0] * speed)
        other = np.linalg.norm(angular - angular[0], axis=1).max() / (mass[0] * speed * radius.max())
        return float(one), float(other)

    def flags(self) -> list[str]:
        """What the run says of trouble: its first bad status, what `diagnose` makes of it, inverted elements."""
        bad = [info for info in self.infos if info.status]
        told = []
        if bad:
            first = self.infos.index(bad[0])
            found = jf.diagnose(self.world.model, self.params, self.frames[first + 1], bad[0])
            told.append(f"{said(int(bad[0].status))} (frame {first + 1} of {len(self.infos)})")
            told += [each.text for each in found.findings[:1]]
        if int(self.infos[-1].inverted):
            told.append(f"info.inverted = {int(self.infos[-1].inverted)} at the end")
        beyond = max((int(info.beyond_cone) for info in self.infos if info.beyond_cone is not None), default=0)
        if beyond:
            told.append(f"info.beyond_cone = {beyond} in a step")
        lost = max((float(info.spin_loss) for info in self.infos if info.spin_loss is not None), default=0.0)
        if self.world.free and lost > (LOST if self.world.model.rest.dtype.itemsize > 4 else 1e-5):
            told.append(f"info.spin_loss = {lost:.3g} in a step")
        return told


def said(code: int) -> str:
    """A status in words: the cause that it names, else its own name."""
    return jf.solvers.describe(code) if code >= BYTE else words(Status(code))


def roll(world: World, dt: float, steps: int, state: Any = None, params: Any = None) -> Run:
    """Take `steps` steps (whole chunks) of `dt` [s]; given up after `PATIENCE` chunks with a bad status."""
    params, state = world.params if params is None else params, world.state if state is None else state
    frames, infos, bad = [jax.tree.map(np.asarray, state)], [], 0
    energies = [_energies(world, params, jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], state))]
    for _ in range(math.ceil(steps / CHUNK)):
        made, told = jf.rollout(world.model, params, state, dt, CHUNK, every=EVERY)
        energies.append(_energies(world, params, made))
        made, told = jax.tree.map(np.asarray, (made, told))
        frames += [jax.tree.map(lambda leaf, k=k: leaf[k], made) for k in range(CHUNK // EVERY)]
        infos += [jax.tree.map(lambda leaf, k=k: leaf[k], told) for k in range(CHUNK // EVERY)]
        state = frames[-1]
        bad += bool(told.status.any())
        if bad >= PATIENCE or not np.isfinite(state.positions).all():
            break
    return Run(world, params, frames, infos, np.concatenate(energies))


def _energies(world: World, params: Any, states: Any) -> np.ndarray:
    bare = world.model.replace(method=Condensed(), choice=Choice("", ""), plan=None, cache=None)
    found = _energies_of(bare, params, states.replace(memory=None))
    return np.stack([np.asarray(each, float) for each in (found.kinetic, found.elastic, found.gravity)], -1)


@jax.jit
def _energies_of(model: Any, params: Any, states: Any) -> Any:
    return jax.vmap(lambda state: jf.energies(model, params, state))(states)


def masses(world: World, params: Any) -> tuple[np.ndarray, np.ndarray]:
    """Masses of nodes (n,) and of rigid bodies (b,) [kg]."""
    soft = np.asarray(nodal_mass(world.model, params.density), float) if world.model.nodes else np.zeros(0)
    return soft, np.zeros(0) if params.rigid is None else np.asarray(params.rigid.mass, float)


def momenta(
    world: World, params: Any, state: Any, own: tuple[np.ndarray, np.ndarray] | None = None
) -> tuple[float, np.ndarray, np.ndarray, float]:
    """Mass [kg], linear and angular momentum about the centre of mass (3,), root-mean-square radius [m].

    `own`: what `masses` says, where it is known.
    """
    mass = np.concatenate(own or masses(world, params))
    places, speeds = points(state)
    total = mass.sum()
    arms = places - mass @ places / total
    linear = mass @ speeds
    angular = (mass[:, None] * np.cross(arms, speeds - linear / total)).sum(0)
    spread = (mass * (arms**2).sum(1)).sum() / total
    if state.rigid is not None:
        inertia = inertias(world, params, state)
        angular = angular + np.einsum("bij,bj->i", inertia, np.asarray(state.rigid.angular_velocities, float))
        spread += np.trace(inertia, axis1=1, axis2=2).sum() / 2 / total
    return float(total), linear, angular, float(np.sqrt(spread))


def inertias(world: World, params: Any, state: Any) -> np.ndarray:
    """Inertia of rigid bodies in the world frame (b, 3, 3) [kg m^2]."""
    w, x, y, z = np.moveaxis(np.asarray(state.rigid.orientations, float), -1, 0)
    turn = np.moveaxis(
        np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        ),
        -1,
        0,
    )
    own = np.asarray(params.rigid.mass, float)[:, None, None] * np.asarray(world.model.rigid.inertia_per_mass, float)
    return turn @ own @ turn.transpose(0, 2, 1)


def points(state: Any) -> tuple[np.ndarray, np.ndarray]:
    """Places and velocities of nodes, then of rigid bodies."""
    places, speeds = np.asarray(state.positions, float), np.asarray(state.velocities, float)
    if state.rigid is not None:
        places = np.concatenate([places, np.asarray(state.rigid.positions, float)])
        speeds = np.concatenate([speeds, np.asarray(state.rigid.velocities, float)])
    return places, speeds


def recovery(world: World, state: Any) -> float:
    """How far nodes are from the undeformed shape, turned and moved as fits best, over the size (root mean square)."""
    rest, places = np.asarray(world.model.rest, float), np.asarray(state.positions, float)
    if not np.isfinite(places).all():
        return math.nan
    a, b = rest - rest.mean(0), places - places.mean(0)
    u, _, v = np.linalg.svd(a.T @ b)
    turn = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ v))]) @ v
    return float(np.sqrt(((a @ turn - b) ** 2).sum(1).mean()) / world.size)
