"""Whether what a contact shape of one's own answers can be used: asked on the host, before anything is compiled."""

import functools
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.answers import asked, described, is_exact, is_number, numbers, odd_leaf, static_flaw
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
    edges: Any = shape.edges()
    if edges is not None and not (_numbers([edges], (3,)) and (np.asarray(edges) > 0).all()):
        yield f"`edges` gives {described(edges)}; it must give three halves (3,) of sizes, above 0 m, or None"
    if type(shape).extent is not Shape.extent and not _numbers(shape.extent(), (3,)):
        yield f"`extent` gives {described(shape.extent())}; it must give points (k, 3), in m"
    if type(shape).thickness is not Shape.thickness and not is_number(shape.thickness()):
        yield f"`thickness` gives {described(shape.thickness())}; it must give one number, in m"
    if not _numbers(shape.circles(), (3, 3)):
        yield f"`circles` gives {described(shape.circles())}; it must give centres and two radii (k, 3, 3), in m"


def mass_flaw(properties: Any) -> str:
    """What is wrong with the `mass_properties` of a solid: no three values of those shapes; empty where nothing is."""
    shapes = [(), (3,), (3, 3)]
    good = isinstance(properties, tuple | list) and len(properties) == len(shapes)
    arrays = [numbers(each) for each in properties] if good else []
    if good and all(each is not None and each.shape == shape for each, shape in zip(arrays, shapes, strict=True)):
        return ""
    return (
        f"`mass_properties` gives {described(properties)}; it must give three values, a volume [m^3], a centre (3,) "
        "[m], and an inertia per mass (3, 3) [m^2]"
    )


def _numbers(given: Any, inner: tuple[int, ...]) -> bool:
    """Whether it is finite numbers (k, *inner)."""
    array = numbers(given)
    if array is None:
        return False
    return array.ndim == 1 + len(inner) and array.shape[1:] == inner and bool(np.isfinite(array).all())


def measured_flaw(measured: Any) -> str:
    """What is wrong with what contact is to take distances from; empty where nothing is."""
    if callable(getattr(measured, "distance", None)) and odd_leaf(measured) is None:
        return ""
    return f"`measured` gives {described(measured)}; it must give a pytree of arrays with `distance`, such as itself"


def distance_flaw(shape: Any, dtype: Any) -> str:
    """What is wrong with the distance of what contact takes it from, a pytree of numbers, which are of `dtype` in the
    model; empty where nothing is."""
    leaves, kind = jax.tree.flatten(shape)
    if flaw := static_flaw(shape):
        return flaw
    types = [dtype if jnp.issubdtype(jnp.result_type(leaf), jnp.floating) else jnp.result_type(leaf) for leaf in leaves]
    return _distance_flaw(kind, tuple(zip(map(jnp.shape, leaves), types, strict=True)), dtype)


@functools.lru_cache(maxsize=256)
def _distance_flaw(kind: Any, leaves: tuple[Any, ...], dtype: Any) -> str:
    shape = jax.tree.unflatten(kind, [jax.ShapeDtypeStruct(*leaf) for leaf in leaves])

    def look(found: Any) -> str:
        wanted = f"one number of the type {dtype}, in m"
        good = is_exact(found, [()], dtype)
        return "" if good else f"`distance` gives {described(found)} for a point (3,); it must give {wanted}"

    return asked(look, lambda own, point: own.distance(point), shape, jax.ShapeDtypeStruct((3,), dtype))
