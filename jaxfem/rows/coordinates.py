"""Joint coordinates (an angle, a travel, a distance) and what acts on them: limits, motors, ropes.

Each coordinate has a value s (m,) and a rate J v, J (m, 1, 3 k). Bounded rows act along it.
"""

import math
from dataclasses import field
from typing import Any, ClassVar, Protocol

import jax
import jax.numpy as jnp

from jaxfem.materials.quantities import positive, signed
from jaxfem.pytrees import Pytree, static
from jaxfem.ranges import Range, within
from jaxfem.rows.attachments import Configuration, Frame, Point, difference, relative_spin
from jaxfem.rows.locks import JointRows, Softness, along_axes, idle_damping, spring_rows
from jaxfem.rows.points import PointRows
from jaxfem.schemes import Stage
from jaxfem.tensors import contract

Array = jax.Array


class Measured(Pytree):
    """Values (m,) of a coordinate, and rates as jacobian (m, 1, 3 k) on triples (m, k)."""

    value: Array
    triples: Array
    jacobian: Array


class Coordinate(Protocol):
    """m coordinates of one kind. `length`, where they have it, says whether they are lengths, else angles; `turn`,
    after how much they are the same again."""

    def measured(self, at: Configuration) -> Measured:
        """Where they are."""


class Angle(Pytree):
    """Angle [rad] of frame `b` about the common third axis, from frame `a`; between -pi and pi."""

    a: Frame
    b: Frame

    @property
    def length(self) -> bool:
        """An angle."""
        return False

    @property
    def turn(self) -> float:
        """A whole one [rad]."""
        return 2 * math.pi

    def measured(self, at: Configuration) -> Measured:
        """atan2 of b's first axis along a's second and first."""
        axes, other = self.a.axes(at), self.b.axes(at)
        triples, spin = relative_spin(self.a, self.b, at)
        along = contract("mij,mi->mj", axes, other[:, :, 0])
        rate = contract("mi,mik->mk", axes[:, :, 2], spin)
        return Measured(jnp.arctan2(along[:, 1], along[:, 0]), triples, rate[:, None])


class Travel(Pytree):
    """How far [m] point `b` is from point `a` along the third axis of `frame`."""

    a: Point
    b: Point
    frame: Frame

    @property
    def length(self) -> bool:
        """A length."""
        return True

    def measured(self, at: Configuration) -> Measured:
        """The third component."""
        value, triples, jacobian = along_axes(self.a.placed(at), self.b.placed(at), self.frame, at)
        return Measured(value[:, 2], triples, jacobian[:, 2:])


class Separation(Pytree):
    """Distance [m] between points `a` and `b`."""

    a: Point
    b: Point

    @property
    def length(self) -> bool:
        """A length."""
        return True

    def measured(self, at: Configuration) -> Measured:
        """Its rate: the difference of velocities along the line; zero where the points coincide."""
        gap = difference(self.a.placed(at), self.b.placed(at))
        square = jnp.sum(gap.position**2, -1)
        size = jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)
        direction = gap.position / jnp.where(size > 0, size, 1)[:, None]
        return Measured(size, gap.triples, contract("mi,mik->mk", direction, gap.jacobian)[:, None])


class CoordinateRows(JointRows):
    """Rows that act along a coordinate."""

    coordinate: Coordinate

    @property
    def length(self) -> bool:
        """As the coordinate; of one that does not say, a length."""
        return bool(getattr(self.coordinate, "length", True))

    @property
    def kind(self) -> str:
        """Words for what the coordinate is between."""
        ends: Any = self.coordinate
        return f"{ends.a.kind}-{ends.b.kind}"

    def near(self, value: Array, place: Array) -> Array:
        """A value (m,) less whole turns, so that it is no further than half of one from `place` (m,)."""
        turn = getattr(self.coordinate, "turn", None)
        return value if turn is None else value - turn * jnp.round((value - place) / turn)


class LengthValues(Pytree):
    """`length` (m,) [m] of distance joints and ropes, beside their softness."""

    length: Any = field(metadata=within(low=0) | positive("length", "m", "length"))
    compliance: Any = field(metadata=within(low=0) | positive("compliance", "m/N", "compliance"))
    damping: Any = field(metadata=within(low=0) | positive("damping", "N s/m", "damping"))


class Distance(CoordinateRows):
    """The coordinate is held at its length; a `rope` only pulls, when it is longer."""

    valued: ClassVar[Any] = LengthValues
    rope: bool = static(default=False)

    @property
    def one_sided(self) -> bool:
        """A rope only pulls."""
        return self.rope

    def idle(self, values: Any) -> dict[str, tuple[Any, str]]:
        """Damping of rigid ones."""
        return idle_damping(values)

    def rows(self, at: Configuration, values: LengthValues, stage: Stage) -> PointRows:
        """One row; a rope's impulse is at most zero."""
        s = self.coordinate.measured(at)
        gap = (s.value - values.length)[:, None]
        rows = spring_rows(gap, s.triples, s.jacobian, Softness(values.compliance, values.damping), at, stage)
        if not self.rope:
            return rows
        return rows.replace(lower=jnp.full_like(gap, -jnp.inf), upper=jnp.zeros_like(gap))


class LimitValues(Pytree):
    """`low` and `high` (m,) [rad or m], beside the limits' softness."""

    low: Any = field(metadata=within(infinite=True) | signed("low", "m", "lower limit", "rad"))
    high: Any = field(metadata=within(infinite=True) | signed("high", "m", "upper limit", "rad"))
    compliance: Any = field(
        metadata=within(low=0) | positive("limit_compliance", "m/N", "compliance of limits", "rad/(N m)")
    )
    damping: Any = field(metadata=within(low=0) | positive("limit_damping", "N s/m", "damping of limits", "N m s"))


WITHIN_A_TURN = Range(
    -math.pi, math.pi, advice="must be within -pi and pi, as angles are, or infinite where there is no limit"
)
"""Of limits of an angle that are finite."""
UNCROSSED = Range(low=0, infinite=True, advice="must not be negative: these limits cross")
"""Of the upper less the lower limit."""


class Limit(CoordinateRows):
    """The coordinate stays between its limits: one row for each, pushing only inwards."""

    valued: ClassVar[Any] = LimitValues

    @property
    def one_sided(self) -> bool:
        """A limit only pushes."""
        return True

    def idle(self, values: Any) -> dict[str, tuple[Any, str]]:
        """Damping of rigid ones."""
        return idle_damping(values)

    def combined(self, values: LimitValues) -> dict[str, tuple[Any, Range]]:
        """Limits do not cross, and those of angles are where angles are."""
        apart = jnp.where(values.high >= values.low, 0, values.high - values.low)
        found: dict[str, tuple[Any, Range]] = {"high - low": (apart, UNCROSSED)}
        if getattr(self.coordinate, "turn", None) is not None:
            both = {"low": values.low, "high": values.high}
            found |= {name: (jnp.where(jnp.isinf(each), 0, each), WITHIN_A_TURN) for name, each in both.items()}
        return found

    def rows(self, at: Configuration, values: LimitValues, stage: Stage) -> PointRows:
        """Rows (m, 2): s - low with impulse >= 0, s - high with impulse <= 0. An infinite limit is off.

        An angle between two that is beyond one of them is beyond the nearer one, also past a half turn.
        """
        s = self.coordinate.measured(at)
        low, high = values.low, values.high
        on = jnp.stack([jnp.isfinite(low), jnp.isfinite(high)], -1)
        both = on.all(-1)
        value = jnp.where(both, self.near(s.value, jnp.where(both, (low + high) / 2, 0)), s.value)
        gap = jnp.where(on, value[:, None] - jnp.where(on, jnp.stack([low, high], -1), 0), 0)
        jacobian = s.jacobian * on[:, :, None]
        rows = spring_rows(gap, s.triples, jacobian, Softness(values.compliance, values.damping), at, stage)
        zero, far = jnp.zeros_like(gap[:, :1]), jnp.full_like(gap[:, :1], jnp.inf)
        lower, upper = jnp.concatenate([zero, -far], -1), jnp.concatenate([far, zero], -1)
        return rows.replace(lower=jnp.where(on, lower, 0), upper=jnp.where(on, upper, 0))


class DriveValues(Pytree):
    """`target` (m,) [rad/s or m/s; rad or m of a position motor], `strength` (m,) [N m or N], at most; softness."""

    target: Any = field(metadata=within() | signed("motor_target", "m or m/s", "target of the motor", "rad or rad/s"))
    strength: Any = field(
        metadata=within(low=0, infinite=True) | positive("motor_strength", "N", "strength of the motor", "N m")
    )
    compliance: Any = field(
        metadata=within(low=0) | positive("motor_compliance", "m/N", "compliance of the motor", "rad/(N m)")
    )
    damping: Any = field(metadata=within(low=0) | positive("motor_damping", "N s/m", "damping of the motor", "N m s"))


UNDAMPED = Range(
    low=0,
    high=0,
    advice="must be 0: these motors drive a rate, with the gain 1 / compliance; position motors have damping",
)
"""Of the damping of motors that drive a rate."""


class Drive(CoordinateRows):
    """Drives the coordinate to a target rate or, with `position`, to a target value, with bounded force.

    `around`: an angle goes to its target the short way round, else never through a half turn.
    """

    valued: ClassVar[Any] = DriveValues
    position: bool = static(default=False)
    around: bool = static(default=False)

    @property
    def holds(self) -> bool:
        """What it drives to it need not reach."""
        return False

    def combined(self, values: DriveValues) -> dict[str, tuple[Any, Range]]:
        """A motor that drives a rate has no damping beside its compliance."""
        return {} if self.position else {"damping": (values.damping, UNDAMPED)}

    def idle(self, values: DriveValues) -> dict[str, tuple[Any, str]]:
        """Damping of rate motors, and of rigid ones."""
        if self.position:
            return idle_damping(values)
        return {"damping": (values.damping != 0, "whose motor drives a rate: its gain is 1 / compliance")}

    def rows(self, at: Configuration, values: DriveValues, stage: Stage) -> PointRows:
        """One row, impulse between -strength dt and strength dt (with the scheme's own weight for dt).

        A rate motor's compliance is 1 / its damping gain: J v + C lam = target with C = compliance / dt.
        """
        s = self.coordinate.measured(at)
        weight = stage.numbers(s.triples[:, :1])[2]
        bound = weight * values.strength[:, None]
        if self.position:
            value = self.near(s.value, values.target) if self.around else s.value
            gap = (value - values.target)[:, None]
            rows = spring_rows(gap, s.triples, s.jacobian, Softness(values.compliance, values.damping), at, stage)
        else:
            compliance = values.compliance[:, None] / weight
            rows = PointRows(s.triples, s.jacobian, compliance, values.target[:, None], unknowns=at.unknowns)
        return rows.replace(lower=-bound, upper=bound)
