"""Few rows by elimination of their whole matrix."""

from collections import OrderedDict
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import standard

import jaxfem as jf
from jaxfem.methods.allrows import condition, dense
from jaxfem.methods.allrows.dense import by_elimination
from jaxfem.solvers.status import SolveInfo, Status
from jaxfem.system.coupled import coupled_system


@pytest.mark.parametrize(("dtype", "together"), [(jnp.float64, 512), (jnp.float64, 5), (jnp.float32, 512)])
def test_a_matrix_without_symmetry_that_is_nearly_singular_is_solved(dtype, together, monkeypatch):
    monkeypatch.setattr(dense, "TOGETHER", together)  # columns of larger ones are made some at a time
    random = np.random.default_rng(0)
    matrix = np.eye(12) + 0.3 * random.standard_normal((12, 12))
    matrix[5] = matrix[4] + (1e-9 if dtype == jnp.float64 else 1e-4) * random.standard_normal(12)
    known = random.standard_normal(12)
    whole = jnp.asarray(matrix, dtype)

    def parted(flat):
        return OrderedDict(a=flat[:6].reshape(2, 3), b=flat[6:].reshape(6, 1))

    def product(rows):
        return parted(whole @ jnp.concatenate([leaf.ravel() for leaf in rows.values()]))

    right = product(parted(jnp.asarray(known, dtype)))
    weights = parted(jnp.abs(jnp.diag(whole)) + 0.1)
    found, info = jax.jit(lambda right: by_elimination(product, right, weights))(right)
    exact = np.linalg.solve(matrix, np.concatenate([np.ravel(leaf) for leaf in right.values()]).astype(float))
    np.testing.assert_allclose(
        np.concatenate([np.ravel(leaf) for leaf in found.values()]), exact, atol=1e-5 if dtype == jnp.float64 else 3e-2
    )
    assert float(info.residual) < (1e-12 if dtype == jnp.float64 else 1e-5)


@pytest.mark.parametrize("broken", [False, True])
def test_of_two_tries_that_is_taken_which_leaves_less(broken):
    """However small the first said that its residual is: it measures another thing. What is not finite is not taken."""
    right, weights = OrderedDict(a=jnp.array([[1.0, 2.0]])), OrderedDict(a=jnp.array([[2.0, 0.5]]))
    matrix = jnp.array([[2.0, 0.3], [0.1, 0.5]])
    left = partial(dense.left_over, lambda rows: OrderedDict(a=rows["a"] @ matrix.T), right, weights)
    good = OrderedDict(a=jnp.linalg.solve(matrix, right["a"][0])[None])
    assert float(left(good)) < 1e-15 and abs(float(left(OrderedDict(a=0 * right["a"]))) - 1) < 1e-15
    first = SolveInfo(jnp.int32(Status.ITERATION_LIMIT), jnp.int32(9), jnp.asarray(1e-9), jnp.int32(0))
    second = SolveInfo(jnp.int32(0), jnp.int32(2), jnp.asarray(1e-8), jnp.int32(0))
    other = OrderedDict(a=good["a"] * (jnp.nan if broken else 1))
    checked = condition._checked(OrderedDict(a=1.5 * good["a"]), first, left, jnp.asarray(1e-8))
    found, info = condition._retried(*checked, left, lambda: (other, second))
    np.testing.assert_allclose(found["a"], good["a"] * (1.5 if broken else 1))
    assert int(info.status) == (Status.ITERATION_LIMIT if broken else Status.CONVERGED)
    assert float(info.residual) > 0.1 if broken else float(info.residual) < 1e-15


@pytest.mark.parametrize(("told", "off", "status"), [(0, 1e-3, 1), (0, 1e-9, 0), (2, 1e-9, 2), (1, 1e-9, 1)])
def test_a_solve_has_converged_where_it_says_so_and_leaves_little(told, off, status):
    right, weights = OrderedDict(a=jnp.array([[1.0, 2.0]])), OrderedDict(a=jnp.ones((1, 2)))
    left = partial(dense.left_over, lambda rows: rows, right, weights)
    own = SolveInfo(jnp.int32(told), jnp.int32(9), jnp.asarray(1e-12), jnp.int32(0))
    solution = OrderedDict(a=right["a"] * (1 + off))
    found, info = condition._checked(solution, own, left, jnp.asarray(1e-8))
    assert found is solution and int(info.status) == status and abs(float(info.residual) - off) < 1e-12


def test_few_rows_need_no_iterations_for_what_these_find(monkeypatch):
    """Backwards too, by a matrix without symmetry: corners of a box that slides push as their normal impulses do."""
    model, params, state = jf.build(standard.sliding_box(), solver="direct")
    system = coupled_system(model, params, state, jnp.asarray(1e-2))
    impulses = {name: jnp.zeros_like(each.bias) for name, each in system.rows.items()}
    impulses = OrderedDict(impulses)
    sides = OrderedDict(
        (name, jnp.full_like(each, name in system.friction, jnp.int32)) for name, each in impulses.items()
    )
    assert sum(each.size for each in impulses.values()) <= dense.FEW
    random = np.random.default_rng(0)
    vector = OrderedDict((name, jnp.asarray(random.standard_normal(each.shape))) for name, each in impulses.items())

    def tangent(backwards):
        def product(change):
            return jax.jvp(partial(condition._condition, system, sides, False, False), (impulses,), (change,))[1]

        matvec = (lambda rows: jax.linear_transpose(product, impulses)(rows)[0]) if backwards else product
        found = condition._tangent(system, model.plan, sides, matvec, vector)
        return found, matvec(found)

    for backwards in (False, True):
        monkeypatch.setattr(condition, "bicgstab", None)
        found, made = jax.jit(lambda backwards=backwards: tangent(backwards))()
        monkeypatch.undo()
        monkeypatch.setattr(condition, "FEW", 0)
        other, _ = jax.jit(lambda backwards=backwards: tangent(backwards))()
        monkeypatch.undo()
        for name in vector:
            np.testing.assert_allclose(made[name], vector[name], atol=1e-7)
            np.testing.assert_allclose(found[name], other[name], rtol=1e-5, atol=1e-7)
    nothing = condition._tangent(
        system, model.plan, sides, lambda rows: {name: 0 * rows[name] for name in rows}, vector
    )
    assert all(np.isnan(each).all() for each in nothing.values())  # of a matrix that is singular


@pytest.mark.slow
@pytest.mark.parametrize("velocity", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 0.0)])
def test_a_coefficient_of_zero_has_the_derivative_of_what_slides(velocity):
    """It was half as large, of one sign whichever way the ball slid, and across its way too; with status 0."""
    ball = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(0, 0, 0.1))
    scene = jf.Scene([ball], contacts=[jf.Contact(ball, jf.Plane(), friction=0.3)])
    model, params, state = jf.build(scene, solver="direct", tolerance=1e-12)
    ((name, values),) = params.contacts.items()
    start = state.replace(rigid=state.rigid.replace(velocities=jnp.asarray([velocity])))

    def after(friction):
        rubbed = values.replace(friction=jnp.full_like(values.friction, 1.0) * friction)
        return jf.step(model, params.replace(contacts={name: rubbed}), start, 1e-2)[0].rigid.velocities[0, :2]

    wanted = -9.81e-2 * np.asarray(velocity)[:2]
    np.testing.assert_allclose(jax.jit(jax.jacrev(after))(0.0), wanted, atol=1e-9)
    np.testing.assert_allclose(jax.jit(jax.jacfwd(after))(0.0), wanted, atol=1e-9)
