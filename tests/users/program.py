"""A user's program, as `mypy --strict` sees it: checked by `test_typing.py`, never imported.

Each `type: ignore` stands where a mistake must be found: strict mypy complains of one that nothing needs.
"""

from typing import assert_type

import jax
import jax.numpy as jnp
import numpy as np

import jaxfem as jf
from jaxfem.solvers import describe, mprgp


def beam(young: float) -> tuple[jf.Model, jf.Params, jf.State]:
    """A scene, built."""
    mesh = jf.mesh.box((0.1, 0.03, 0.03), cells=(4, 2, 2))
    shaken = jf.Driven("x+", jf.Motion(amplitude=(0.0, 0.0, 1e-3), frequency=3.0))
    weight = jf.NodalForce(mesh.points[:, 2] > 0.02, (0.0, 0.0, -0.1))
    body = jf.SoftBody(
        mesh, young=young, poisson=0.4, density=1070.0, rotation="polar", fixed="x-", driven=[shaken], loads=[weight]
    )
    ball = jf.RigidBody(jf.Sphere(0.01), mass=0.1, position=(0.0, 0.0, 0.1))
    ground = jf.Contact(ball, jf.Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)), friction=0.3)
    rope = jf.DistanceJoint(body, ball, anchor=(0.1, 0.0, 0.0), anchor_b=(0.0, 0.0, 0.1))
    scene = jf.Scene([body, ball], gravity=(0.0, 0.0, -9.81), joints=[rope], contacts=[ground])
    return jf.build(scene, solver="auto", mass="lumped", tolerance=1e-6)


def height(young: jax.Array) -> jax.Array:
    """What is differentiated."""
    model, params, state = beam(2e5)
    prepared = jf.prepare(model, params, state, 1e-2)
    states, infos = jf.rollout(prepared, params.replace(young=young), state, 1e-2, 20, every=5, checkpoint=10)
    assert_type(states, jf.State)
    assert_type(infos, jf.StepInfo)
    assert_type(states.positions, jax.Array)
    return states.positions[-1, :, 2].mean()


def sweep(youngs: jax.Array) -> jax.Array:
    """Lanes and their gradients."""
    lanes: jax.Array = jax.vmap(jax.grad(height))(youngs)
    return lanes


def single() -> float:
    """One step, its energies and impulses, and what went wrong."""
    model, params, state = beam(2e5)
    state, info = jf.step(model, params, state, 1e-2, forces=np.zeros((model.nodes, 3)))
    found = jf.energies(model, params, state)
    assert_type(found.elastic, jax.Array)
    pulls = jf.impulses(model, state)
    assert_type(pulls, dict[str, jax.Array])
    if state.rigid is not None:
        assert_type(state.rigid.positions, jax.Array)
    print(describe(info.status), model.method.name, sum(float(jnp.abs(pull).max()) for pull in pulls.values()))
    return float(found.kinetic)


def static() -> jax.Array:
    """Rest, natural frequencies, and the scheme's damping of them."""
    model, params, state = beam(2e5)
    rest, _ = jf.equilibrium(model, params, state)
    frequencies, shapes = jf.modes(model, params, rest, count=4, mass="averaged")
    assert_type(shapes, jax.Array)
    return jf.scheme_damping(jf.GeneralizedAlpha(0.8), frequencies, 1e-2)


def on_arrays() -> jax.Array:
    """Solvers and rotations on plain arrays."""
    x, info = mprgp(jnp.eye(3), jnp.ones(3), lower=0.0)
    assert_type(info, jf.solvers.SolveInfo)
    return jf.rotation.nearest_rotation(jnp.eye(3)) @ x


def meshed(file: str) -> jf.TetMesh:
    """A mesh of a file, mended; what is wrong with a file is an error of the package."""
    try:
        mesh = jf.mesh.read(file, scale=1e-3, merge=True)
    except (jf.MeshError, FileNotFoundError) as problem:
        print(jf.__version__, problem)
        mesh = jf.mesh.from_cells(np.zeros((8, 3)), {"hexahedron": np.arange(8)[None]})
    assert_type(mesh, jf.TetMesh)
    assert_type(mesh.notes, tuple[str, ...])
    return mesh.merged().scaled(2.0)


def recorded(file: str) -> np.ndarray:
    """Markers of a recording [m]."""
    recording = jf.read_recording(file)
    assert_type(recording, jf.Recording)
    places: np.ndarray = recording.positions
    return places


def mistakes() -> None:
    """Wrong order, misspelt words, what is None without rigid bodies, frozen fields, pairs taken for one."""
    model, params, state = beam(2e5)
    jf.step(params, model, state, 1e-2)  # type: ignore[arg-type]
    jf.rollout(model, params, state, 1e-2, steps=2.5)  # type: ignore[arg-type]
    jf.modes(model, params, state, mass="lumpy")  # type: ignore[arg-type]
    jf.build(jf.Scene([]), mass="lumpy")  # type: ignore[arg-type]
    jf.step(model, params, state, 1e-2, force=None)  # type: ignore[call-arg]
    print(state.rigid.positions)  # type: ignore[union-attr]
    print(jf.equilibrium(model, params, state).positions)  # type: ignore[attr-defined]
    state.time = jnp.zeros(())  # type: ignore[misc]
