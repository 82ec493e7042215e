"""Declared joints as groups of rows: all parts of one kind and one pair of attachments in one set of arrays."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.building.bodies import BodyIndex
from jaxfem.building.joint_answers import check_alike, check_leaves, check_softness, checked_parts, signature
from jaxfem.declared.errors import SceneError
from jaxfem.declared.joints import Joint, Part
from jaxfem.pytrees import on_device


def joint_parts(joints: Sequence[Joint], index: BodyIndex, dtype: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Groups of joint rows and their values, both by name: a word and the kinds of attachment, "point rigid-world".

    In each group `names` says which joint each entry is of: its own name, or its place in the scene's list.
    """
    grouped: dict[str, list[tuple[str, Part]]] = {}
    known: set[Any] = set()
    signatures: dict[str, Any] = {}
    for number, joint in enumerate(joints):
        name = joint.name or str(number)
        where = f'joint "{name}"' if joint.name else f"joint {name} (a {type(joint).__name__})"
        if flaw := joint.flaw():
            raise SceneError(flaw)
        parts = checked_parts(joint, index, where)
        check_softness(joint, index, where, parts, known)
        for part in parts:
            label, own = f"{part.word} {part.rows.kind}", signature(part)
            group = grouped.setdefault(label, [])
            if signatures.setdefault(label, own) != own:
                check_alike(part, group[0][1], where, f'joint "{group[0][0]}"')
            group.append((name, part))
    rows, values = {}, {}
    for label, group in grouped.items():
        check_leaves(group[:1])
        try:
            stacked, own = (_stacked([part[k] for _, part in group], dtype) for k in (1, 2))
        except (TypeError, ValueError):
            check_leaves(group)
            raise
        rows[label] = stacked.replace(names=tuple(name for name, _ in group))
        values[label] = jax.tree.map(lambda leaf: leaf.astype(dtype), own)
    return rows, values


def _stacked(trees: list[Any], dtype: Any) -> Any:
    def stack(*leaves: Any) -> jax.Array:
        array = np.stack([np.asarray(leaf) for leaf in leaves])
        return on_device(array, device_type(array.dtype, dtype))

    return jax.tree.map(stack, *trees)


def device_type(given: Any, dtype: Any) -> Any:
    """The type on the device of what users give: indices, masks as they are, and real numbers."""
    if np.issubdtype(given, np.bool_):
        return jnp.bool_
    return jnp.int32 if np.issubdtype(given, np.integer) else dtype
