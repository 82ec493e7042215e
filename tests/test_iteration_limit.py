"""The iteration limit bounds a step, whatever loops are around its solves: of friction, rotations, active sets."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes
from standard import STANDARD

import jaxfem as jf
from jaxfem.solvers import Status

CASES = [("sliding box", "direct"), ("sliding box", "mprgp")]
DEAR = [
    ("doll", "direct"),
    ("block on plane", "condensed"),
    ("block on plane", "mprgp"),
    ("doll", "mprgp"),
    ("doll", "pgs"),
]


@pytest.mark.parametrize(("name", "method"), [*CASES, *[pytest.param(*case, marks=pytest.mark.slow) for case in DEAR]])
def test_no_step_takes_more_than_the_limit_and_one_that_would_says_so(name, method):
    case = STANDARD[name]
    model, params, state = jf.build(case.make(*case.arguments), solver=method, tolerance=case.tolerance)
    _, free = jf.rollout(model, params, state, 1e-2, case.steps)
    limit = int(free.iterations.max()) - 2  # met by no single solve of a round, only by their sum
    assert limit > 2
    _, bound = jf.rollout(model.replace(max_iterations=jnp.int32(limit)), params, state, 1e-2, case.steps)
    bound = jax.tree.map(np.asarray, bound)
    # The check after a round of the direct search is a product too.
    assert bound.iterations.max() <= limit + 1
    assert Status.ITERATION_LIMIT in bound.status and set(bound.status) <= {Status.CONVERGED, Status.ITERATION_LIMIT}


def test_rounds_of_rotations_share_the_limit():
    built = scenes.beam((2, 1, 1), build={"rotation_update": "implicit", "tolerance": 1e-10})
    _, info = jf.step(*built, 1e-2)
    limit = int(info.iterations) - 1
    assert info.status == 0
    _, bound = jf.step(built[0].replace(max_iterations=jnp.int32(limit)), *built[1:], 1e-2)
    assert bound.iterations <= limit and bound.status == Status.ITERATION_LIMIT


def test_directions_of_the_static_search_share_the_limit():
    built = scenes.beam((2, 1, 1))
    assert jf.equilibrium(*built)[1].status == 0
    assert jf.equilibrium(built[0].replace(max_iterations=jnp.int32(3)), *built[1:])[1].status == Status.ITERATION_LIMIT
