"""A method that this file alone defines: it counts its steps, and leaves them to another method."""

import dataclasses
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.io import load_scene
from jaxfem.methods import METHODS, Condensed, Method


@dataclasses.dataclass(frozen=True)
class Counted(Method):
    """Another method's steps, counted in the memory beside that method's own."""

    inner: Any = dataclasses.field(default_factory=Condensed)
    name: ClassVar[str] = "counted"

    def refuses(self, facts):
        return self.inner.refuses(facts)

    def plan(self, model, params, state):
        return self.inner.plan(model, params, state)

    def prepare(self, model, params, state, dt):
        return self.inner.prepare(model, params, state, dt)

    def start(self, model, params, state):
        return jnp.zeros((), model.rest.dtype), self.inner.start(model, params, state)

    def step(self, model, params, state, dt, forces, cache):
        count, memory = state.memory
        following, info = self.inner.step(model, params, state.replace(memory=memory), dt, forces, cache)
        return following.replace(memory=(count + 1, following.memory)), info

    def impulses(self, model, memory):
        return self.inner.impulses(model, memory[1])


def cube(solver):
    mesh = jf.mesh.box((0.1, 0.1, 0.1), 1, origin=(0, 0, 0.001))
    body = jf.SoftBody(mesh, young=1e5, poisson=0.3, density=1e3, damping=1e-3)
    return jf.build(jf.Scene([body], contacts=[jf.Contact(body, jf.Plane(), friction=0.0)]), solver=solver)


def test_it_steps_as_its_inner_method_and_remembers():
    (model, params, state), plain = cube("counted"), cube("condensed")
    assert isinstance(model.method, Counted) and model.choice == ("counted", "asked for")
    states, info = jf.rollout(model, params, state, 5e-3, 6)
    expected, other = jf.rollout(*plain, 5e-3, 6)
    np.testing.assert_allclose(states.positions, expected.positions, atol=1e-14)  # another program
    np.testing.assert_array_equal(info.iterations, other.iterations)
    np.testing.assert_array_equal(states.memory[0], np.arange(1, 7))
    pushed, wanted = jf.impulses(model, states), jf.impulses(plain[0], expected)
    assert list(pushed) == list(wanted) == ["contact smooth soft-ground plane"]
    impulses = (each["contact smooth soft-ground plane"] for each in (pushed, wanted))
    np.testing.assert_allclose(*impulses, rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_derivatives_and_lanes_go_through_it():
    model, params, state = cube("counted")
    model = model.replace(tolerance=jnp.asarray(1e-12))

    def height(young):
        states, _ = jf.rollout(model, params.replace(young=young), state, 5e-3, 6)
        return jnp.mean(states.positions[-1, :, 2])

    young, h = jnp.array([1e5, 2e5]), 1e2
    found = jax.jit(jax.vmap(jax.grad(height)))(young)
    differences = [(height(each + h) - height(each - h)) / (2 * h) for each in young]
    assert np.abs(differences).min() > 0
    np.testing.assert_allclose(found, differences, rtol=1e-5)


@pytest.mark.slow
def test_sweeps_take_it_with_contacts_whatever_it_remembers():
    model, params, state = cube("counted")
    young, options = np.array([1e5, 2e5]), {"outputs": {"x": "positions"}, "dt": 5e-3, "steps": 4}
    found = jf.sweep(model, params, state, {"young": young}, **options)
    for one, places in zip(young, found["x"], strict=True):
        states, _ = jf.rollout(model, params.replace(young=one), state, 5e-3, 4)
        np.testing.assert_allclose(np.asarray(places)[-1], states.positions[-1], atol=1e-12)
    with pytest.raises(jf.sweeping.SweepError, match='by a method that keeps their impulses alone, not "counted"'):
        jf.sweep(model, params, state, {"young": young}, engine="lanes", **options)


class Pushed(Condensed):
    """A method with a number of its own: a force on all nodes beside the loads."""

    name: ClassVar[str] = "pushed"
    push: float = 0.25

    def constants(self):
        return {jf.Constant("push", "N", "must be >= 0 N", low=0.0, closed=True): self.push}

    def step(self, model, params, state, dt, forces, cache):
        push = jnp.zeros_like(state.positions).at[:, 0].set(params.push)
        return super().step(model, params, state, dt, push if forces is None else forces + push, cache)


def test_its_constants_are_in_params_beside_those_of_the_material():
    model, params, state = cube("pushed")
    assert float(params.push) == 0.25 and model.constants["push"].unit == "N" and float(params.young) == 1e5
    plain = cube("condensed")
    for push in (0.25, 0.5):
        found, _ = jf.step(model, params.replace(push=push), state, 5e-3)
        forces = jnp.zeros_like(state.positions).at[:, 0].set(push)
        np.testing.assert_allclose(found.positions, jf.step(*plain, 5e-3, forces=forces)[0].positions, atol=1e-12)
    body = jf.SoftBody(jf.mesh.box((0.1, 0.1, 0.1), 1), young=1e5, poisson=0.3, density=1e3)
    named = type("Named", (Condensed,), {"name": None, "constants": Pushed.constants, "push": 0.75})
    assert float(jf.build(jf.Scene([body]), solver=named(), rotation_update="implicit")[1].push) == 0.75


def test_it_is_known_by_its_name_and_refuses_what_it_cannot_serve(tmp_path):
    assert METHODS["counted"].made is Counted
    file = tmp_path / "scene.toml"
    file.write_text(
        '[time]\nstep = 0.005\nsteps = 2\n[solver]\nmethod = "counted"\n'
        "[[body]]\nmesh = { box = [1, 1, 1], cells = 1 }\n"
        "young = 2e5\npoisson = 0.3\ndensity = 1000.0\n"
    )
    assert load_scene(file).build()[0].method == Counted()
    with pytest.raises(jf.SceneError, match='solver "counted" works on the nodes of soft bodies'):
        jf.build(jf.Scene([jf.RigidBody(jf.Sphere(1.0), mass=1.0)]), solver="counted")
