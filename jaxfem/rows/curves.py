"""Curves of rigid bodies against distance functions: edges, axes along which a ball is swept, rims.

A curve touches where the distance along it is least: where its slope, the cosine of the angle between normal and curve,
changes sign. Where it is flat (a rod along a face, a cylinder on its end) it touches from where the slope is -FLAT to
where it is FLAT, and the ends of that stretch carry. Signs of slopes are found by bisection, which is not
differentiated; one step of Newton's behind it makes the place exact and gives it the implicit derivative. (A search on
each element against a distance function: Macklin, Erleben, Mueller, Chentanez, Jeschke & Corse 2020.)

What rolls must touch with the place that is lowest, whichever part of the body that is: parts of a rim on the way down
would hold it up, for the rate of their gap is taken at the start of the step.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.pytrees import static
from jaxfem.rows.attachments import Configuration, RigidPoint, WorldPoint
from jaxfem.rows.candidates import Candidates, Pairs
from jaxfem.rows.contact import BURIED, ShapeContacts
from jaxfem.rows.nearby import chosen, nearest
from jaxfem.tensors import contract, inner

Array = jax.Array

FLAT = 1e-4
"""Slope (a sine) up to which a curve lies flat."""
STRETCH = 0.05
"""Of a curve's parameter, which is 2 long: the shortest stretch that counts as flat; on round things it is FLAT."""
BESIDE, SHARP = 1e-5, 1e-3
"""To both sides of a place, in the parameter, and the change of slope between that is a kink."""
HALFWAY = 0.2  # length of the mean of two gradients below which no edge is so thin
INWARDS = 1e-3  # of a flat stretch, by which its ends are drawn in
HALVINGS = 26
NUDGE = 1e-4
"""Longest step of Newton's, in the parameter; bisection is far nearer where the slope is smooth."""
SAMPLES = 16  # of a rim
AROUND = 2 / 3  # a third of a turn
FAR = 1e3  # gap of what takes no part, in sizes of the curve
SLIP = 3e-5
"""Of what a unit impulse moves a rim by: how its friction rows give. Five places of one rim hold what three would; what
they do not share would drift from round to round, with bounds that follow normal impulses as little shared."""
MOST_CURVES = 8
"""Curves of a body that take part in a step: those that may be nearest."""
SPOTS = 5  # along each of more curves than that, to tell which
TOUCHES = {False: 2, True: 5}
"""Candidates of a curve, open or closed: see `_on_segment` and `_on_rim`."""


class CurveContacts(Candidates):
    """Curves of rigid bodies `body` (m,), or of ground (None), against shapes as in `ShapeContacts`.

    `centre`, `first`, `second` (m, 3): centre + s first, from s = -1 to 1, where `second` is None; else the circle
    centre + cos(pi s) first + sin(pi s) second. From the bodies' centres of mass, in their frames. `radius` (m,) of the
    ball swept along each; `other` (m,), `offset` (m, 3): the shapes' bodies and their centres of mass. `most`: how many
    of the curves take part in a step, 0 for all, and `margin` (k most,).
    """

    body: Any
    centre: Any
    first: Any
    second: Any
    radius: Any
    shape: Any
    other: Any
    margin: Any
    rough: bool = static()
    shared: bool = static()
    most: int = static()
    offset: Any = dataclasses.field(default=None, kw_only=True)

    @property
    def kind(self) -> str:
        """Words for the kinds of partners."""
        curves = "edges" if self.second is None else "rims"
        whose = "ground" if self.body is None else "rigid"
        return f"{whose} {curves}-{'ground' if self.other is None else 'rigid'} {type(self.shape).__name__.lower()}"

    @property
    def alone(self) -> bool:
        """One shape serves one contact, and so do the `most` of its curves."""
        return self.shared or self.most > 0

    @property
    def slip(self) -> float:
        """That of rims."""
        return 0.0 if self.second is None else SLIP

    def pairs(self, at: Configuration) -> Pairs:
        """Those of the places found, which move with their bodies; k for each curve, side by side."""
        if self.most:
            return self._nearest(at).replace(most=0).pairs(at)
        count = TOUCHES[self.second is not None]
        search = jax.vmap(
            _on_segment if self.second is None else _on_rim, in_axes=(None if self.shared else 0, 0, 0, 0)
        )
        place, on, (kink, normal) = search(self.shape, *self._seen(at))
        local = _along(self.centre[:, None], self.first[:, None], _wide(self.second), place[..., None])

        def each(leaf: Any) -> Any:
            return None if leaf is None else jnp.repeat(leaf, count, 0)

        local = local.reshape(-1, 3)
        contacts = ShapeContacts(
            WorldPoint(local) if self.body is None else RigidPoint(each(self.body), local),
            each(self.radius),
            self.shape if self.shared else jax.tree.map(each, self.shape),
            each(self.other),
            self.margin,
            self.rough,
            self.shared,
            offset=each(self.offset),
        )
        pairs = contacts.pairs(at)
        kink, normal, radius = kink.reshape(-1), normal.reshape(-1, 3), each(self.radius)
        kink = kink & (pairs.gap > -BURIED * self.margin)
        if self.other is not None:
            normal = contract("mij,mj->mi", at.rotations[each(self.other)], normal)
        short = jnp.sqrt(jnp.where(kink, jnp.sum(normal**2, -1), 1))
        gap = jnp.where(kink, (pairs.gap + radius) / short - radius, pairs.gap)
        normal = jnp.where(kink[:, None], normal / short[:, None], pairs.normal)
        far = FAR * each(jnp.linalg.norm(self.first, axis=-1))
        return pairs.replace(gap=jnp.where(on.reshape(-1), gap, far), normal=normal)

    def _nearest(self, at: Configuration) -> "CurveContacts":
        """The `most` curves that may be nearest, in their order: no distance changes faster than its place."""

        def least(shape: Any, centre: Array, first: Array, second: Array) -> Array:
            s = jnp.linspace(-1, 1, SPOTS, dtype=first.dtype)[:, None]
            places = _along(centre, first, None if self.second is None else second, s)
            bound: Array = jnp.min(jax.vmap(shape.distance)(places)) - jnp.linalg.norm(first) / (SPOTS - 1)
            return bound

        fixed: CurveContacts = jax.lax.stop_gradient(self)
        seen = fixed._seen(jax.lax.stop_gradient(at))
        bound = jax.vmap(least, in_axes=(None if self.shared else 0, 0, 0, 0))(fixed.shape, *seen) - fixed.radius
        kept = {"margin": self.margin} | ({"shape": self.shape} if self.shared else {})
        fewer: CurveContacts = chosen(self, nearest(bound, self.most), **kept)
        return fewer

    def _seen(self, at: Configuration) -> tuple[Array, Array, Array]:
        """The curves in the frames of the shapes."""
        vectors = jnp.stack([self.first, self.first if self.second is None else self.second], 1)
        centre = self.centre
        if self.body is not None:
            turn = at.rotations[self.body]
            centre = at.centers[self.body] + contract("mij,mj->mi", turn, centre)
            vectors = contract("mij,mkj->mki", turn, vectors)
        if self.other is not None:
            turn = at.rotations[self.other]
            centre = contract("mji,mj->mi", turn, centre - at.centers[self.other])
            vectors = contract("mji,mkj->mki", turn, vectors)
            if self.offset is not None:
                centre = centre + self.offset
        return centre, vectors[:, 0], vectors[:, 1]


def _wide(vectors: Array | None) -> Array | None:
    return None if vectors is None else vectors[:, None]


def _along(centre: Array, first: Array, second: Array | None, s: Array) -> Array:
    if second is None:
        return centre + s * first
    return centre + jnp.cos(jnp.pi * s) * first + jnp.sin(jnp.pi * s) * second


def _on_segment(*curve: Any) -> tuple[Array, Array, tuple[Array, Array]]:
    """Parameters (2,), whether they take part, and kinks: the nearest place between the ends, or both ends of a flat
    stretch.

    Of a `curve`: shape, centre, first, second. The segment's own ends are left to points of the body.
    """

    def distance(curve: Any, s: Array) -> Array:
        shape, centre, first, _ = curve
        found: Array = shape.distance(_along(centre, first, None, s))
        return found

    fixed = jax.lax.stop_gradient(curve)
    one = jnp.ones((), fixed[2].dtype)
    low, middle, high = _places(distance, curve, jnp.linalg.norm(fixed[2]), (-one, one), (-one, one))
    flat = high - low > STRETCH
    place = jnp.stack([jnp.where(flat, low, middle), high])
    between = jax.lax.stop_gradient(jnp.abs(place)) < 1 - NUDGE
    return place, between & jnp.stack([jnp.bool_(True), flat]), jax.vmap(lambda s: _kink(curve, s))(place)


def _on_rim(*curve: Any) -> tuple[Array, Array, tuple[Array, Array]]:
    """Parameters (5,), whether they take part, and kinks: the nearest place, both ends of a flat stretch, a third of a
    turn to both sides. The latter see what the rim tips over to, and carry where all of it lies flat."""

    def distance(curve: Any, s: Array) -> Array:
        shape, centre, first, second = curve
        found: Array = shape.distance(_along(centre, first, second, s))
        return found

    fixed = jax.lax.stop_gradient(curve)
    size = jnp.linalg.norm(fixed[2])
    start, step = _lowest(lambda s: distance(fixed, s), size), 2 / SAMPLES
    least, around = (start - step, start + step), (start - AROUND, start + AROUND)
    low, middle, high = _places(distance, curve, jnp.pi * size, least, around)
    stretch = high - low
    flat = stretch > STRETCH
    middle = jnp.where(flat, (low + high) / 2, middle)
    part = flat & (stretch < 1.8 * AROUND)
    always = jnp.bool_(True)
    place = jnp.stack([middle, low, high, middle - AROUND, middle + AROUND])
    return place, jnp.stack([always, part, part, always, always]), jax.vmap(lambda s: _kink(curve, s, True))(place)


def _kink(curve: Any, s: Array, closed: bool = False) -> tuple[Array, Array]:
    """Whether the distance along a curve has a kink at its least value, and then its gradient (3,) across the curve.

    That is where it runs through the edge of a solid: of the gradients on both sides the mean that is at right angles
    to the curve is so to the edge too, the common perpendicular of the two, and shorter than one.
    """
    shape, centre, first, second = curve

    def side(s: Array) -> tuple[Array, Array]:
        def place(s: Array) -> Array:
            return _along(centre, first, second if closed else None, s)

        gradient: Array = jax.grad(shape.distance)(place(s))
        return gradient, inner(gradient, jax.jvp(place, (s,), (jnp.ones_like(s),))[1])

    (before, falls), (after, rises) = side(s - BESIDE), side(s + BESIDE)
    speed = jax.lax.stop_gradient(jnp.linalg.norm(first))
    kink = (falls < 0) & (rises > 0) & (rises - falls > SHARP * speed)
    share = rises / jnp.where(kink, rises - falls, 1)
    across = share * before + (1 - share) * after
    # Gradients that cancel are those of opposite faces, halfway between them, and of no edge.
    return kink & (jnp.sum(jax.lax.stop_gradient(across) ** 2) > HALFWAY**2), across


def _lowest(distance: Any, size: Array) -> Array:
    """Where to look on a rim: the least of its samples; of several alike the middle, if that is as low."""
    places = jnp.arange(SAMPLES, dtype=size.dtype) * (2 / SAMPLES)
    values = jax.vmap(distance)(places)
    near = (values <= values.min() + FLAT * size).astype(size.dtype)
    x, y = jnp.sum(near * jnp.cos(jnp.pi * places)), jnp.sum(near * jnp.sin(jnp.pi * places))
    clear = x**2 + y**2 > (0.3 * jnp.sum(near)) ** 2
    middle = jnp.arctan2(y, jnp.where(clear, x, 1)) / jnp.pi
    level = values.max() - values.min() < 2 * FLAT * size
    least = jnp.where(level, 0, places[jnp.argmin(values)])
    return jnp.where(clear & (distance(middle) <= values.min() + FLAT * size), middle, least)


def _places(
    distance: Any, curve: Any, speed: Array, least: tuple[Array, Array], ends: tuple[Array, Array]
) -> tuple[Array, Array, Array]:
    """Where the slope passes -FLAT, 0 and FLAT; an end where it does not. Differentiable in the curve.

    `least`: the ends between which the least distance is looked for.
    """
    fixed = jax.lax.stop_gradient(curve)

    def slope(curve: Any, s: Array) -> Array:
        rate: Array = jax.jvp(lambda s: distance(curve, s), (s,), (jnp.ones_like(s),))[1]
        return rate / speed

    def found(target: Array, ends: tuple[Array, Array]) -> Array:
        def halved(_: Any, ends: tuple[Array, Array]) -> tuple[Array, Array]:
            low, high = ends
            middle = (low + high) / 2
            above = slope(fixed, middle) > target
            return jnp.where(above, low, middle), jnp.where(above, middle, high)

        between: tuple[Array, Array] = jax.lax.fori_loop(0, HALVINGS, halved, ends)
        return (between[0] + between[1]) / 2

    def exact(s: Array, target: Array) -> Array:
        rise: Array = jax.jvp(lambda s: slope(fixed, s), (s,), (jnp.ones_like(s),))[1]
        safe = jnp.where(rise > 0, rise, 1)
        good = (rise > 0) & (jnp.abs(slope(fixed, s) - target) < NUDGE * safe)
        place: Array = s - jnp.where(good, (slope(curve, s) - target) / safe, 0)
        return place

    targets = FLAT * jnp.array([-1.0, 0.0, 1.0], speed.dtype)
    middle = found(targets[1], least)
    starts, stops = jnp.stack([ends[0], middle]), jnp.stack([middle, ends[1]])
    low, high = jax.vmap(found)(targets[::2], (starts, stops))
    # A little inwards from where it ceases to be flat: the normal there is that of what it lies on.
    low, high = low + INWARDS * (middle - low), high + INWARDS * (middle - high)
    low, middle, high = jax.vmap(exact)(jnp.stack([low, middle, high]), targets)
    return low, middle, high
