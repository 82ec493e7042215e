"""Wrong shapes are caught at the public functions, in every test: see `contracts.py`."""

import functools
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes

import jaxfem as jf

pytest.importorskip("jaxtyping", reason="shapes are checked by jaxtyping: install the extra `test`")
pytest.importorskip("beartype", reason="shapes are checked by beartype: install the extra `test`")

import contracts
from jaxtyping import TypeCheckError


def returning(function, result):
    """A stand-in of the public function that returns `result`, checked as all are."""
    plain = function.__wrapped__
    return contracts.checked(functools.wraps(plain)(lambda *_, **__: result), contracts.CONTRACTS[plain])


@pytest.fixture(scope="module", params=["float32", "float64"])
def taken(request):
    """A small scene and one step of it: (model, params, state), (next state, info)."""
    scene = scenes.beam((1, 1, 1), build={"dtype": request.param})
    return scene, jf.step(*scene, 1e-2)


def test_the_whole_package_calls_the_checked_functions():
    plain = set(contracts.CONTRACTS)
    left = {
        f"{name}.{attribute}"
        for name, module in sys.modules.items()
        if name.split(".")[0] == "jaxfem"
        for attribute, value in vars(module).items()
        if callable(value) and value in plain
    }
    assert not left
    assert jf.step.__wrapped__ in plain


@pytest.mark.parametrize("name", ["step", "equilibrium"])
def test_wrong_states_and_infos_are_caught(taken, name):
    scene, (state, info) = taken
    function, arguments = getattr(jf, name), (*scene, 1e-2)[: 4 if name == "step" else 3]
    returning(function, (state, info))(*arguments)
    wrong = [
        (state.replace(positions=state.positions.T), info),
        (state.replace(velocities=state.velocities[1:]), info),
        (state.replace(accelerations=state.time), info),
        (state.replace(time=np.arange(3.0)), info),
        (state, info.replace(residual=info.residual[None])),
        (state, info.replace(status=info.residual)),
        (state,),
    ]
    for each in wrong:
        with pytest.raises(TypeCheckError, match="parameter 'result'"):
            returning(function, each)(*arguments)


def test_as_many_frames_as_were_asked_for(taken):
    scene, found = taken
    four, two = (jax.tree.map(lambda leaf: jnp.stack([leaf] * count), found) for count in (4, 2))  # noqa: B023
    returning(jf.rollout, two)(*scene, 1e-2, 4, every=2)
    for wrong in (four, found, (two[0], four[1])):
        with pytest.raises(TypeCheckError, match="parameter 'result'"):
            returning(jf.rollout, wrong)(*scene, 1e-2, 4, every=2)


def test_wrong_energies_impulses_and_modes_are_caught(taken):
    scene, (state, _) = taken
    model, nodes = scene[0], scene[0].nodes
    energies = jf.Energies(state.time, state.time, state.time)
    frequencies, shapes = jnp.zeros(2, state.time.dtype), jnp.zeros((2, nodes, 3), state.time.dtype)
    calls = [
        (jf.energies, scene, energies, energies.replace(kinetic=state.velocities)),
        (
            jf.impulses,
            (model, state),
            {"contact": jnp.zeros((4, 1))},
            {"contact": jnp.zeros((4, 1)), "joint": jnp.ones(3)},
        ),
        (jf.modes, (*scene, 2), (frequencies, shapes), (frequencies[:-1], shapes)),
        (jf.modes, (*scene, 2), (frequencies, shapes), (frequencies, shapes.swapaxes(1, 2))),
    ]
    for function, arguments, right, wrong in calls:
        returning(function, right)(*arguments)
        with pytest.raises(TypeCheckError, match="parameter 'result'"):
            returning(function, wrong)(*arguments)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_wrong_vectors_and_matrices_are_caught(dtype):
    F, q, omega = jnp.eye(3, dtype=dtype)[None], jnp.ones((2, 4), dtype), jnp.ones(5, dtype)
    A, b = 2 * jnp.eye(4, dtype=dtype), jnp.ones(4, dtype)
    calls = [
        (jf.rotation.nearest_rotation, lambda R: R[0], (F,)),
        (jf.rotation.quaternion_to_matrix, lambda R: R[..., 0], (q,)),
        (jf.scheme_damping, jnp.sum, ("backward_euler", omega, 0.1)),
        (jf.solvers.mprgp, lambda pair: (pair[0][1:], pair[1]), (A, b)),
        (jf.solvers.pgs, lambda pair: (pair[0][:, None], pair[1]), (A, b)),
    ]
    for function, change, arguments in calls:
        found = function(*arguments)
        assert jax.tree.leaves(found)[0].dtype == dtype, function
        with pytest.raises(TypeCheckError, match="parameter 'result'"):
            returning(function, change(found))(*arguments)


@pytest.mark.parametrize("transform", [jax.jit, jax.vmap, jax.grad])
def test_wrong_shapes_are_caught_when_a_step_is_traced(taken, transform):
    (model, params, state), _ = taken
    plain = jf.step.__wrapped__

    @functools.wraps(plain)
    def short(*arguments):
        following, info = plain(*arguments)
        return following.replace(positions=following.positions[:-1]), info

    def reach(function, young):
        return function(model, params.replace(young=young), state, 1e-2)[0].positions.sum()

    young = jnp.full((2,) if transform is jax.vmap else (), 1e5, state.time.dtype)
    assert jax.eval_shape(transform(functools.partial(reach, jf.step)), young).shape == young.shape
    with pytest.raises(TypeCheckError, match="parameter 'result'"):
        wrong = contracts.checked(short, contracts.CONTRACTS[plain])
        jax.eval_shape(transform(functools.partial(reach, wrong)), young)


def test_errors_of_a_function_come_before_those_of_its_shapes(taken):
    with pytest.raises(jf.StepError, match="forces has shape"):
        jf.step(*taken[0], 1e-2, forces=jnp.ones((2, 3)))
