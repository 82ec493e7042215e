"""What all lanes share of a model: connectivity, shape gradients, and the modes at rest."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.elements.mass import consistent_share
from jaxfem.model import Model, Params, element_stiffness, nodal_mass, per_element
from jaxfem.pytrees import Pytree, on_device, static
from jaxfem.sweeping.lanes.loose import Loose, loose_of
from jaxfem.sweeping.lanes.modes import ALL, Rest, all_modes, group_modes

Array = jax.Array
RUNS = 4  # rectangles of equal width that padded sums are cut into
OVERHEAD = 12  # of a rectangle, in rows
AROUND = 4  # elements whose mean rotation a node's frame is


class Body(Pytree):
    """Shared by all lanes; free nodes stand first, in `order` (n,). Arrays end in an axis of length 1 for the lanes.

    `corners` (E + 1, 4): one more element that is nothing pads the sums, with F = I by `nothing` (E + 1, 3, 3, 1).
    `gradients` (E + 1, 4, 3, 1), `volumes` (E + 1, 1). `touch`: rows 4 e + a of the corners that meet at each node, in
    rectangles, `touch_back` (n,): where each node is in them. `around` (nf, 4): elements around each free node.
    `frequencies` (m, 1) squared and `shapes` (3 nf, m), in single precision, of the modes at rest of the `stiffness`
    and `density` () that a lane's are compared with, and of a `bulk` () 3K / 2 mu; `complete`: whether they are all, so
    that nothing is needed beside them. `sure` (): true, which the compiler does not know; None on accelerators, which
    need no fences. `loose`: which bodies nothing holds, None without such.
    """

    corners: Array
    gradients: Array
    volumes: Array
    nothing: Array
    touch: tuple[Array, ...]
    touch_back: Array
    around: Array
    order: Array
    back: Array
    frequencies: Array
    shapes: Array
    stiffness: Array
    density: Array
    bulk: Array
    sure: Array | None
    loose: Loose | None
    free_count: int = static()
    complete: bool = static()

    def fence(self, values: Any) -> Any:
        """`values()`, computed once and stored.

        XLA's CPU fusion repeats what is cheap for each of its readers, without bound, and drops `optimization_barrier`
        before it fuses. It does not look across a branch, which costs 0.2 us; on accelerators far more.
        """
        if self.sure is None:
            return values()
        made = jax.eval_shape(values)
        return jax.lax.cond(self.sure, values, lambda: jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), made))


def body_of(model: Model, params: Params) -> Body:
    """The shared parts of a scene, on the host in double precision; `params`: those that lanes are compared with."""
    free = np.asarray(model.free) > 0
    order = np.argsort(~free, kind="stable")
    back, count, dtype = np.argsort(order), int(free.sum()), model.rest.dtype
    cells = back[np.asarray(model.elements.cells)]
    gradients = np.moveaxis(np.asarray(model.elements.gradients, np.float64), -1, 0)
    volumes = np.asarray(model.elements.volumes, np.float64)
    pair = [np.broadcast_to(np.asarray(v, np.float64), volumes.shape) for v in element_stiffness(model, params)]
    volumetric, deviatoric = pair
    mass = np.asarray(nodal_mass(model, params.density), np.float64)[order]
    shear = float((deviatoric * volumes).sum() / volumes.sum())
    density = float((np.asarray(per_element(model, params.density)) * volumes).sum() / volumes.sum())
    moduli = volumetric / shear, deviatoric / shear
    rest = Rest(gradients, volumes, cells, mass / density, count, *moduli, consistent_share(model.mass))
    if 3 * count <= ALL:
        squared, shapes = all_modes(rest)
    else:
        squared, shapes = group_modes(
            rest, np.asarray(model.rest, np.float64)[order], np.asarray(model.node_body)[order]
        )
    elements, nodes = len(cells), len(order)
    owner = cells.ravel()
    by_count = np.argsort(-np.bincount(owner, minlength=nodes), kind="stable")
    touch = padded(np.argsort(by_count)[owner], np.arange(4 * elements), nodes, 4 * elements)
    nothing = (np.arange(elements + 1) == elements)[:, None, None, None] * np.eye(3)[..., None]
    around = np.split(np.argsort(owner, kind="stable") // 4, np.cumsum(np.bincount(owner, minlength=nodes))[:-1])[
        :count
    ]
    spread = [each[np.linspace(0, len(each) - 1, AROUND).round().astype(int)] for each in around]
    return Body(
        corners=on_device(np.concatenate([cells, 0 * cells[:1]]), np.int32),
        gradients=on_device(np.concatenate([gradients, 0 * gradients[:1]])[..., None], dtype),
        volumes=on_device(np.concatenate([volumes, 0 * volumes[:1]])[..., None], dtype),
        nothing=on_device(nothing, dtype),
        touch=tuple(on_device(each, np.int32) for each in touch),
        touch_back=on_device(np.argsort(by_count), np.int32),
        around=on_device(np.array(spread), np.int32),
        order=on_device(order, np.int32),
        back=on_device(back, np.int32),
        frequencies=on_device(squared[:, None], dtype),
        shapes=on_device(shapes, np.float32),
        stiffness=on_device(shear, dtype),
        density=on_device(density, dtype),
        bulk=on_device(float((volumetric * volumes).sum() / (deviatoric * volumes).sum()), dtype),
        sure=jnp.bool_(True) if _on_cpu(model) else None,
        loose=loose_of(model, order),
        free_count=count,
        complete=3 * count <= ALL,
    )


def _on_cpu(model: Model) -> bool:
    """Where its arrays are."""
    return {device.platform for device in model.rest.devices()} == {"cpu"}


def padded(owner: np.ndarray, item: np.ndarray, rows: int, pad: int) -> list[np.ndarray]:
    """Items of each row as at most `RUNS` rectangles of equal width, rows in order of falling count, few pads."""
    order = np.argsort(owner, kind="stable")
    owner, item = owner[order], item[order]
    counts, first = np.bincount(owner, minlength=rows), np.searchsorted(owner, np.arange(rows))
    cuts = [0, *(np.flatnonzero(np.diff(counts)) + 1).tolist(), rows]
    best: dict[int, tuple[float, list[tuple[int, int]]]] = {0: (0.0, [])}
    for end in cuts[1:]:
        before = [(a, *best[a]) for a in cuts if a < end and a in best and len(best[a][1]) < RUNS]
        options = [(c + (end - a) * int(counts[a]) + OVERHEAD, [*runs, (a, end)]) for a, c, runs in before]
        best[end] = min(options, key=lambda option: option[0])
    made = []
    for start, end in best[rows][1]:
        index = np.full((end - start, counts[start]), pad, np.int32)
        for row in range(start, end):
            index[row - start, : counts[row]] = item[first[row] : first[row] + counts[row]]
        made.append(index)
    return made
