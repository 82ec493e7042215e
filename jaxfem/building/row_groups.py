"""Declared joints as groups of rows: all parts of one kind and one pair of attachments in one set of arrays."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.building.bodies import BodyIndex
from jaxfem.declared.errors import SceneError
from jaxfem.declared.joints import Joint, Part


def joint_parts(joints: Sequence[Joint], index: BodyIndex, dtype: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Groups of joint rows and their values, both by name: a word and the kinds of attachment, "point rigid-world".

    In each group `names` says which joint each entry is of: its own name, or its place in the scene's list.
    """
    grouped: dict[str, list[tuple[str, Part]]] = {}
    for number, joint in enumerate(joints):
        name = joint.name or str(number)
        where = f'joint "{name}"' if joint.name else f"joint {name} (a {type(joint).__name__})"
        if flaw := joint.flaw():
            raise SceneError(flaw)
        for part in joint.parts(index, where):
            group = grouped.setdefault(f"{part.word} {part.rows.kind}", [])
            if group and type(group[0][1].rows) is not type(part.rows):
                kinds = type(part.rows).__name__, type(group[0][1].rows).__name__
                raise SceneError(f'{where} calls its {kinds[0]} "{part.word}", as others call a {kinds[1]}: rename it')
            group.append((name, part))
    rows, values = {}, {}
    for label, parts in grouped.items():
        stacked = _stacked([part.rows for _, part in parts], dtype)
        rows[label] = stacked.replace(names=tuple(name for name, _ in parts))
        values[label] = jax.tree.map(
            lambda leaf: leaf.astype(dtype), _stacked([part.values for _, part in parts], dtype)
        )
    return rows, values


def _stacked(trees: list[Any], dtype: Any) -> Any:
    def stack(*leaves: Any) -> jax.Array:
        array = np.stack([np.asarray(leaf) for leaf in leaves])
        return jnp.asarray(array, jnp.int32 if np.issubdtype(array.dtype, np.integer) else dtype)

    return jax.tree.map(stack, *trees)
