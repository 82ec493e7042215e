"""Bad numbers: NaN and infinity in every input, and values that cannot be, given where only compiled code sees them."""

import jax
import jax.numpy as jnp
import numpy as np

from hard.case import Setting, Told, Wanted, case
from hard.jointed import motor
from hard.running import CHUNK, EVERY, World
from hard.worlds import DT, LOOSE, RIGID, SOFT, chain, changed, floor_cube, free_cube, ground, loose_box
from jaxfem.stepping.entering import typed
from jaxfem.stepping.step import _rollout


def outcome(world: World, params, state, dt=DT) -> tuple[bool, bool]:
    """Whether a few steps end with a status (or are refused), and whether they end in finite numbers."""
    # What `rollout` compiles, past its checks on the host: values inside jit cannot be refused there.
    params, state, dt = typed(world.model, params, state, dt)
    made, told = _rollout(world.model, params, state, dt, None, CHUNK, EVERY, None, None)
    moving = (made.positions, made.velocities, made.rigid)
    finite = all(np.isfinite(np.asarray(leaf)).all() for leaf in jax.tree.leaves(moving))
    return bool(np.asarray(told.status).any()), finite


def inputs(tree) -> list[tuple[str, int]]:
    """Names and numbers of a tree's leaves that are floats and hold something."""
    leaves = jax.tree_util.tree_flatten_with_path(tree)[0]
    named = [(jax.tree_util.keystr(path), k, leaf) for k, (path, leaf) in enumerate(leaves)]
    return [(name, k) for name, k, leaf in named if jnp.issubdtype(leaf.dtype, jnp.floating) and leaf.size]


def spoilt(tree, number: int, value: float):
    """The tree with the first entry of one leaf replaced."""
    leaves, structure = jax.tree.flatten(tree)
    leaf = leaves[number]
    leaves[number] = leaf.ravel().at[0].set(value).reshape(leaf.shape)
    return jax.tree.unflatten(structure, leaves)


def in_every_input(name: str, value: float, world, routes, quick: bool) -> None:
    @case(name, "bad values", routes, quick=quick)
    def found(at: Setting) -> Told:
        """NaN anywhere must give a status; infinity anywhere a status or finite numbers (a limit may be infinite)."""
        scene = world(at)
        state = scene.state.replace(memory=scene.state.memory)
        silent, tried = [], 0
        for where, number in inputs((scene.params, state)):
            if ".memory" in where:
                continue
            params, start = spoilt((scene.params, state), number, value)
            told, finite = outcome(scene, params, start)
            tried += 1
            if not told and (np.isnan(value) or not finite):
                silent.append(where.replace("[0]", "params", 1).replace("[1]", "state", 1))
        return Told([Wanted(f"silent of {tried} inputs ({', '.join(silent)})", len(silent), 0)])


for _value, _word in ((np.nan, "NaN"), (np.inf, "infinity")):
    in_every_input(f"{_word} in every input, soft cube", _value, free_cube, SOFT, _word == "NaN")
    in_every_input(f"{_word} in every input, soft cube on the floor", _value, floor_cube, SOFT, False)
    in_every_input(f"{_word} in every input, rigid box", _value, loose_box, LOOSE, True)
    in_every_input(f"{_word} in every input, rigid bodies on the ground", _value, ground, RIGID, True)
    in_every_input(f"{_word} in every input, chain", _value, chain, RIGID, False)
    in_every_input(f"{_word} in every input, motor", _value, motor, RIGID, False)


def impossible(name: str, world, routes, change, quick: bool = False) -> None:
    """A case of one value that cannot be: right is a status, or a refusal."""

    @case(name, "bad values", routes, quick=quick)
    def found(at: Setting) -> Told:
        scene = world(at)
        params, state, dt = change(scene)
        told, finite = outcome(scene, params, state, dt)
        wanted = Wanted("steps without a status", int(not told), 0)
        return Told([wanted], note="" if finite else "not finite")


def constant(name: str, value: float):
    return lambda w: (w.params.replace(**{name: jnp.full_like(w.params.constants[name], value)}), w.state, DT)


def of_rigid(change):
    return lambda w: (w.params, w.state.replace(rigid=change(w.state.rigid)), DT)


impossible("dt of 0 inside jit", free_cube, SOFT, lambda w: (w.params, w.state, 0.0), True)
impossible("negative dt inside jit", free_cube, SOFT, lambda w: (w.params, w.state, -DT), True)
impossible("dt of 0 inside jit, rigid", loose_box, LOOSE, lambda w: (w.params, w.state, 0.0), True)
impossible("negative dt inside jit, rigid", loose_box, LOOSE, lambda w: (w.params, w.state, -DT), True)
impossible("negative damping inside jit", free_cube, SOFT, constant("damping", -0.01), True)
impossible("young of 0 inside jit", free_cube, SOFT, constant("young", 0.0), True)
impossible("negative young inside jit", free_cube, SOFT, constant("young", -1e5), True)
impossible("poisson of 0.6 inside jit", free_cube, SOFT, constant("poisson", 0.6), True)
impossible("poisson of infinity inside jit", free_cube, SOFT, constant("poisson", np.inf), True)
impossible("density of 0 inside jit", free_cube, SOFT, constant("density", 0.0), True)
impossible("negative friction", ground, RIGID, lambda w: (changed(w.params, friction=-1.0), w.state, DT), True)
impossible("restitution of 2", ground, RIGID, lambda w: (changed(w.params, restitution=2.0), w.state, DT), True)
impossible(
    "rigid mass of 0",
    loose_box,
    LOOSE,
    lambda w: (w.params.replace(rigid=w.params.rigid.replace(mass=w.params.rigid.mass * 0)), w.state, DT),
    True,
)
impossible(
    "negative rigid mass",
    ground,
    RIGID,
    lambda w: (w.params.replace(rigid=w.params.rigid.replace(mass=-w.params.rigid.mass)), w.state, DT),
    True,
)
impossible(
    "quaternion of zeros", loose_box, LOOSE, of_rigid(lambda r: r.replace(orientations=r.orientations * 0)), True
)
impossible(
    "quaternion of length 2", ground, RIGID, of_rigid(lambda r: r.replace(orientations=r.orientations * 2)), True
)
impossible(
    "negative compliance of a joint",
    chain,
    RIGID,
    lambda w: (
        w.params.replace(
            joints={
                name: own.replace(compliance=own.compliance - 1e-3) if hasattr(own, "compliance") else own
                for name, own in w.params.joints.items()
            }
        ),
        w.state,
        DT,
    ),
)
