"""Locks: rows that hold points together or frames aligned. Joints are built of them (see `declared/joints`).

Each lock measures a gap g (m, r) with rate J v and holds it as a spring of compliance alpha and damping d, implicitly
at the step's stage x_a = base + ahead + reach v, v_a = before + follow v (see `schemes`), with g taken at `base`:
    lam = -weight (g + J ahead + reach J v) / alpha - weight d (J before + follow J v)
    => J v + C lam = c,  s = reach + follow alpha d,  C = alpha / (weight s),  c = -(g + J ahead + alpha d J before) / s
For backward Euler C = alpha / (dt (dt + alpha d)), c = -g / (dt + alpha d). alpha = 0 is a rigid joint whose drift is
taken back within the step (Baumgarte 1972 with the whole gap a step).
"""

import math
from dataclasses import field
from typing import Any, ClassVar, Protocol, Self, runtime_checkable

import jax
import jax.numpy as jnp

from jaxfem.materials.quantities import positive
from jaxfem.pytrees import Pytree, static
from jaxfem.ranges import Range, within
from jaxfem.rows.attachments import (
    Configuration,
    Frame,
    Placed,
    Point,
    Reshaping,
    RigidPoint,
    difference,
    relative_spin,
)
from jaxfem.rows.points import PointRows
from jaxfem.schemes import Stage
from jaxfem.tensors import contract

Array = jax.Array


SMALL = 1e-4
"""Square of a sine below which an angle is a series, or next to a half turn."""


class Softness(Pytree):
    """What users differentiate of m joints: `compliance` (m,) [m/N or rad/(N m)] and `damping` (m,) [N s/m, N m s]."""

    compliance: Any = field(metadata=within(low=0) | positive("compliance", "m/N", "compliance", "rad/(N m)"))
    damping: Any = field(metadata=within(low=0) | positive("damping", "N s/m", "damping", "N m s"))


class JointRows(Pytree):
    """m joint parts of one kind: what the step asks of each. A subclass holds on to something at `a` and at `b`.

    `names` (m): the joints that they are of.
    """

    names: tuple[str, ...] = static(default=(), kw_only=True)
    valued: ClassVar[Any] = None
    """The class whose fields their values have, None where nothing is asked of them; who defines `rows` says it."""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if "rows" in cls.__dict__:
            cls.valued = cls.__dict__.get("valued")

    @property
    def kind(self) -> str:
        """Words for what it holds on to, part of a group's name: "rigid-world"."""
        ends: Any = self
        return f"{ends.a.kind}-{ends.b.kind}"

    @property
    def holds(self) -> bool:
        """Whether their gap is to be closed: all but motors."""
        return True

    @property
    def length(self) -> bool:
        """Whether their gap is a length, else an angle."""
        return True

    @property
    def turns_over(self) -> bool:
        """Whether their gap is a turn of half a one at most: bent further, a spring pushes the other way."""
        return False

    @property
    def one_sided(self) -> bool:
        """Whether they only push or only pull, and may strike: limits and ropes."""
        return False

    def combined(self, values: Any) -> dict[str, tuple[Any, Range]]:
        """What must hold of the values beside the range of each, by what it is called: numbers (m,) and their range."""
        return {}

    def idle(self, values: Any) -> dict[str, tuple[Any, str]]:
        """Values that change nothing beside the others, by name: which of the joints (m,) have such, and why."""
        return {}

    def rows(self, at: Configuration, values: Any, stage: Stage) -> PointRows:
        """Their rows; `at` is where the stage's `base` is."""
        raise NotImplementedError(f"{type(self).__name__} has no rows: define them")

    def reshaped(self, change: Reshaping) -> Self:
        """The same between bodies of a new rest shape: what it holds on to in soft bodies rides with their nodes."""
        return self


@runtime_checkable
class Pulling(Protocol):
    """Joint rows whose pull has to be felt as geometric stiffness."""

    def tension_stiffness(self, force: Array, at: Configuration) -> Array:
        """What forces (m, r) [N] add to the angular mass of the bodies that they pull on, (b, 3, 3)."""


def idle_damping(values: Any) -> dict[str, tuple[Any, str]]:
    """For `JointRows.idle` of rows made by `spring_rows`: damping beside a compliance of 0."""
    return {"damping": ((values.damping > 0) & (values.compliance == 0), "whose compliance is 0, so that it is rigid")}


def spring_rows(
    gap: Array, triples: Array, jacobian: Array, values: Softness, at: Configuration, stage: Stage
) -> PointRows:
    """Rows (m, r) that hold a gap (m, r) at zero, as the head of this file says."""
    alpha, damping = values.compliance[:, None], values.damping[:, None]
    reach, follow, weight = stage.numbers(triples[:, :1])
    slack = reach + follow * alpha * damping
    compliance = jnp.broadcast_to(alpha / (weight * slack), gap.shape)
    rows = PointRows(triples, jacobian, compliance, -gap / slack, unknowns=at.unknowns)
    if stage.ahead is None or stage.before is None:
        return rows
    known = gap + rows.apply(stage.ahead) + alpha * damping * rows.apply(stage.before)
    return rows.replace(bias=-known / slack)


class PointLock(JointRows):
    """Points `a` and `b` coincide: three rows along the world axes, impulses on b."""

    valued: ClassVar[Any] = Softness
    a: Point
    b: Point

    def idle(self, values: Any) -> dict[str, tuple[Any, str]]:
        """Damping of rigid ones."""
        return idle_damping(values)

    def rows(self, at: Configuration, values: Softness, stage: Stage) -> PointRows:
        """Gap: from a to b."""
        gap = difference(self.a.placed(at), self.b.placed(at))
        return spring_rows(gap.position, gap.triples, gap.jacobian, values, at, stage)

    def reshaped(self, change: Reshaping) -> Self:
        """The other end comes along with a soft one, so that the joint is closed at the start."""
        if (by := self.a.drift(change)) is not None:
            return self.replace(b=self.b.carried(by, change))
        if (by := self.b.drift(change)) is not None:
            return self.replace(a=self.a.carried(by, change))
        return self

    def tension_stiffness(self, force: Array, at: Configuration) -> Array:
        """What its last forces (m, 3) [N] add to the angular mass of the bodies that it pulls on, (b, 3, 3)."""
        return tension_stiffness(self, force, at)


class LineLock(JointRows):
    """Point `b` stays on the line through `a` along the third axis of `frame`: two rows along the other axes."""

    valued: ClassVar[Any] = Softness
    a: Point
    b: Point
    frame: Frame

    def idle(self, values: Any) -> dict[str, tuple[Any, str]]:
        """Damping of rigid ones."""
        return idle_damping(values)

    def rows(self, at: Configuration, values: Softness, stage: Stage) -> PointRows:
        """Gap: from a to b along the axes across the line."""
        gap, triples, jacobian = along_axes(self.a.placed(at), self.b.placed(at), self.frame, at)
        return spring_rows(gap[:, :2], triples, jacobian[:, :2], values, at, stage)


class FrameLock(JointRows):
    """Frames `a` and `b` stay aligned: as many rows as turns are `held`, about a's first axes.

    With 3 all axes stay aligned; with 2 the third ones do, about which b turns freely.
    """

    valued: ClassVar[Any] = Softness
    a: Frame
    b: Frame
    held: int = static(default=3)

    @property
    def length(self) -> bool:
        """An angle."""
        return False

    @property
    def turns_over(self) -> bool:
        """Beyond half a turn the shortest way back is the other one."""
        return True

    def idle(self, values: Any) -> dict[str, tuple[Any, str]]:
        """Damping of rigid ones."""
        return idle_damping(values)

    def rows(self, at: Configuration, values: Softness, stage: Stage) -> PointRows:
        """Gap: the turn from a's axes to b's, up to half a one; its rate is the relative spin to first order.

        A spring's torque is along that turn, in whose direction the rate is exact: its work is that of its energy.
        """
        axes, other = self.a.axes(at), self.b.axes(at)
        triples, spin = relative_spin(self.a, self.b, at)
        if self.held == 3:  # sum of the axes' cross products: 2 sin(angle) times the direction of the turn
            sine = 0.5 * jnp.sum(jnp.cross(axes, other, axis=1), -1)
            cosine = 0.5 * (jnp.sum(axes * other, (1, 2)) - 1)
            spare = _half_turn_axis(contract("mik,mjk->mij", other, axes))
        else:
            sine = jnp.cross(axes[:, :, 2], other[:, :, 2])
            spare = jnp.where(jnp.sum(sine**2, -1, keepdims=True) > 0, sine, axes[:, :, 0])
            cosine = jnp.sum(axes[:, :, 2] * other[:, :, 2], -1)
        gap = _turn(sine, cosine, spare)
        about = axes[:, :, : self.held]
        return spring_rows(
            contract("mij,mi->mj", about, gap), triples, contract("mij,mik->mjk", about, spin), values, at, stage
        )


def _turn(sine: Array, cosine: Array, spare: Array) -> Array:
    """Rotation vectors (m, 3) from sin(angle) times their directions (m, 3) and cos(angle) (m,).

    `spare` (m, 3): their directions, of either sign, near half a turn, where the sine has none.
    """
    square, ahead = jnp.sum(sine**2, -1), cosine > 0
    small, back = ahead & (square < SMALL), ~ahead & (square < SMALL)
    size = jnp.sqrt(jnp.where(small | back, 1, square))
    longer = jnp.arctan2(size, cosine) / size
    series = 1 + square / 6 * (1 + square * 9 / 20 * (1 + square * 25 / 42))
    spare = jax.lax.stop_gradient(spare / _safe(spare))
    along = jnp.sum(spare * sine, -1)
    half = jnp.where(along < 0, -math.pi, math.pi) - along
    found = jnp.where(small, series, longer)[:, None] * sine
    return jnp.where(back[:, None], half[:, None] * spare, found)


def _half_turn_axis(rotation: Array) -> Array:
    """Axes (m, 3), of any sign and length, of turns (m, 3, 3) by about a half: columns of (R + R' - 2 cos I) / 2."""
    even = 0.5 * (rotation + jnp.swapaxes(rotation, 1, 2))
    diagonal = jnp.diagonal(even, axis1=1, axis2=2)
    longest = jnp.argmax(diagonal, axis=1)
    column = jnp.take_along_axis(even, longest[:, None, None], 2)[:, :, 0]
    cosine = 0.5 * (jnp.sum(diagonal, 1) - 1)
    return column - cosine[:, None] * (jnp.arange(3) == longest[:, None])


def along_axes(a: Placed, b: Placed, frame: Frame, at: Configuration) -> tuple[Array, Array, Array]:
    """From a to b along a frame's axes: values (m, 3), triples, and rates (m, 3, 3 k).

    d/dt (axis . e) = axis . de/dt + w . (axis x e), w the frame's spin.
    """
    gap, axes = difference(a, b), frame.axes(at)
    spinning, spin = frame.spin(at)
    own = contract("mij,mik->mjk", axes, gap.jacobian)
    arms = jnp.cross(axes, gap.position[:, :, None], axis=1)
    turning = contract("mij,mik->mjk", arms, spin)
    triples = jnp.concatenate([gap.triples, spinning], -1)
    return contract("mij,mi->mj", axes, gap.position), triples, jnp.concatenate([own, turning], -1)


def tension_stiffness(lock: PointLock, force: Array, at: Configuration) -> Array:
    """Geometric stiffness of point joints against turning the bodies they pull on, (b, 3, 3) [N m/rad].

    A force f at the arm r gives the torque r x f; turning the body changes it by -(f.r I - (r f' + f r')/2) a radian
    (symmetric part; Tournier et al. 2015). With u = sqrt(|r||f|) (r/|r| + f/|f|) a quarter of |u|^2 I - u u' bounds the
    positive part of that matrix from above, is equal to it where f is along r, and needs no eigenvectors.
    """
    total = jnp.zeros_like(at.rotations)
    for end, pull in ((lock.a, -force), (lock.b, force)):
        if isinstance(end, RigidPoint):
            arm = end.arm(at)
            size = _norm(arm) * _norm(pull)
            u = jnp.sqrt(jnp.where(size > 0, size, 1)) * (arm / _safe(arm) + pull / _safe(pull))
            square = jnp.sum(u * u, -1)[:, None, None] * jnp.eye(3, dtype=u.dtype)
            part = 0.25 * (square - u[:, :, None] * u[:, None, :]) * (size > 0)[:, :, None]
            total = total.at[end.body].add(part)
    return total


def _norm(vector: Array) -> Array:
    square = jnp.sum(vector**2, -1, keepdims=True)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)


def _safe(vector: Array) -> Array:
    norm = _norm(vector)
    return jnp.where(norm > 0, norm, 1)
