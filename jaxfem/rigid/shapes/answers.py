"""Whether what a contact shape of one's own answers can be used: asked on the host, before anything is compiled."""

import functools
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.answers import STATIC, asked, described, hashable, is_array
from jaxfem.rigid.shapes.base import Shape


def touching_flaw(shape: Shape) -> str:
    """What is wrong with the points and curves with which a solid touches others; empty where nothing is."""
    return next((flaw for flaw in _touching_flaws(shape) if flaw), "")


def _touching_flaws(shape: Shape) -> Iterator[str]:
    for hook, inner, wanted in (
        ("features", (3,), "points (k, 3) and the radius (k,) of the ball around each, in m"),
        ("segments", (2, 3), "ends (k, 2, 3) and the radius (k,) of the ball swept along each, in m"),
    ):
        found: Any = getattr(shape, hook)()
        if not isinstance(found, tuple | list) or len(found) != 2 or not _numbers(found[0], inner):
            yield f"`{hook}` gives {described(found)}; it must give {wanted}"
        elif not _numbers(found[1], ()) or len(found[0]) != len(found[1]) or np.any(np.asarray(found[1]) < 0):
            yield f"`{hook}` gives {described(found)}; it must give {wanted}, 0 for none"
    if not _numbers(shape.circles(), (3, 3)):
        yield f"`circles` gives {described(shape.circles())}; it must give centres and two radii (k, 3, 3), in m"


def _numbers(given: Any, inner: tuple[int, ...]) -> bool:
    """Whether it is finite numbers (k, *inner)."""
    try:
        array = np.asarray(given, float)
    except (TypeError, ValueError):
        return False
    return array.ndim == 1 + len(inner) and array.shape[1:] == inner and bool(np.isfinite(array).all())


def distance_flaw(shape: Any) -> str:
    """What is wrong with the distance of what contact takes it from, a pytree of numbers; empty where nothing is."""
    leaves, kind = jax.tree.flatten(shape)
    if not hashable(kind):
        return STATIC
    return _distance_flaw(kind, tuple((jnp.shape(leaf), jnp.result_type(leaf)) for leaf in leaves))


@functools.lru_cache(maxsize=256)
def _distance_flaw(kind: Any, leaves: tuple[Any, ...]) -> str:
    shape = jax.tree.unflatten(kind, [jax.ShapeDtypeStruct(*leaf) for leaf in leaves])
    dtype = jnp.zeros(()).dtype

    def look(found: Any) -> str:
        good = is_array(found, [()], dtype)
        return "" if good else f"`distance` gives {described(found)} for a point (3,); it must give one number, in m"

    return asked(look, lambda own, point: own.distance(point), shape, jax.ShapeDtypeStruct((3,), dtype))
