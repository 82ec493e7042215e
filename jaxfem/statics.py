"""equilibrium: where a scene rests, by Newton's method on the corotated energy; differentiable by the implicit rule."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.elements.elasticity import elastic_response
from jaxfem.elements.tetra import has_energy
from jaxfem.materials.moduli import ratio_and_modulus
from jaxfem.methods.base import refused_elasticity
from jaxfem.methods.ending import inverted_elements
from jaxfem.methods.nodes.tangent import tangent_and_preconditioner
from jaxfem.model import Model, Params, State, StepInfo, domain_materials, element_stiffness
from jaxfem.pytrees import Pytree
from jaxfem.solvers.implicit import implicit_solution, or_nan
from jaxfem.solvers.newton import Evaluation, Operator, minimize_newton
from jaxfem.solvers.pcg import pcg
from jaxfem.stepping import StepError, check_call, typed
from jaxfem.stepping.values import judged, value_status
from jaxfem.system.carry import without_carry
from jaxfem.system.memory import memory_at
from jaxfem.system.soft import elastic_rounding, external_force
from jaxfem.tensors import array_of

Array = jax.Array

NOISE = 3.0  # times the forces that rounding makes of positions at the start: what it may make on the way


class _StaticInputs(Pytree):
    model: Model
    params: Params
    held: Array  # positions (n, 3) that fixed nodes keep
    forces: Array | None
    noise: Array  # force [N] that the rounding of positions makes


@dataclasses.dataclass(frozen=True)
class _Equilibrium:
    """f_elastic(x) + f_external(x) = 0 on free nodes; `symmetric` where a potential exists."""

    symmetric: bool

    def gradient(self, inputs: _StaticInputs, unknown: Array) -> Array:
        """Minus the force on free nodes (n, 3) [N]; fixed ones have a spring to zero, so the Hessian is regular."""
        return _evaluate(inputs, unknown).gradient

    def solve(self, inputs: _StaticInputs, guess: Array) -> tuple[Array, Any]:
        return minimize_newton(
            lambda x: _evaluate(inputs, x),
            lambda x, rotation: _tangent(inputs, x, rotation),
            guess * inputs.model.free[:, None],
            tol=inputs.model.tolerance,
            max_inner=inputs.model.max_iterations,
        )

    def tangent_solve(self, inputs: _StaticInputs, unknown: Array, right: Array, matvec: Any) -> Array:
        hessian, precondition = _tangent(inputs, unknown, _evaluate(inputs, unknown).aux)
        tol, limit = inputs.model.tolerance, inputs.model.max_iterations
        if self.symmetric:
            return or_nan(*pcg(hessian, right, precondition, tol=tol, max_iterations=limit))
        found, _ = jax.scipy.sparse.linalg.gmres(matvec, right, M=precondition, tol=tol, restart=60, maxiter=200)
        good = jnp.linalg.norm(matvec(found) - right) <= 1e3 * tol * jnp.linalg.norm(right)
        return jnp.where(good, found, jnp.nan)


def equilibrium(model: Model, params: Params, state: State, *, forces: Any = None) -> tuple[State, StepInfo]:
    """Where the scene rests under its loads: (state at rest, info).

    Starts from `state.positions`; fixed and driven nodes stay where `state` has them; velocities come out zero.
    Materials that relax, such as `Viscoelastic`, are at rest with their relaxed stiffness, and remember it; those that
    flow are refused: where they rest depends on the way there.
    `forces` (n, 3) [N]: extra nodal forces. Differentiable in params, the fixed nodes' positions and forces. Every body
    needs enough fixed nodes to be held: otherwise the status says that no equilibrium was found.
    """
    if model.coupled:
        raise StepError(
            "equilibrium takes soft bodies alone: a scene with rigid bodies, joints or contacts comes to rest by steps"
        )
    if not has_energy(model.rotation_kind):
        raise StepError(f'rotation = "{model.rotation_kind}" has no energy to minimise: build with rotation = "polar"')
    if refused := refused_elasticity(model):
        raise StepError(f"equilibrium {refused}")
    flowing = model.bodies_of(lambda law: law.remembers and not law.relaxes)
    if flowing:
        raise StepError(
            f"equilibrium cannot tell where {flowing} comes to rest: that depends on the way there. Apply the load "
            "little by little in `step` or `rollout`, with damping, until it rests; materials without a memory, and "
            "those that relax to their stiffness, are served"
        )
    params, state, forces = typed(model, params, state, forces, others=("forces",))
    check_call(model, params, state, 1.0, forces)
    found: tuple[State, StepInfo] = _equilibrium(model, params, state, forces)
    return found


@jax.jit
def _equilibrium(model: Model, params: Params, state: State, forces: Array | None) -> tuple[State, StepInfo]:
    symmetric = all(getattr(load, "symmetric", False) for load in model.loads)
    given = value_status(model, params, state, forces=forces)
    noise = NOISE * elastic_rounding(model, *jax.lax.stop_gradient((params, state.positions)))
    inputs = _StaticInputs(model, params, state.positions, forces, noise)
    guess = jax.lax.stop_gradient(state.positions)
    unknown, info = implicit_solution(_Equilibrium(symmetric), inputs, guess)
    positions = jnp.where(model.free[:, None] > 0, unknown, state.positions)
    rest = without_carry(state).replace(positions=positions, velocities=jnp.zeros_like(positions), accelerations=None)
    if model.has_memory:
        rest = rest.replace(internal=memory_at(model, params, positions, at_once=False))
    inverted = inverted_elements(model, positions)
    found = StepInfo(info.status, info.iterations, info.residual, info.weakly_active, inverted)
    return rest, judged(found, rest, given)


def _evaluate(inputs: _StaticInputs, unknown: Array) -> Evaluation:
    model = inputs.model
    free = model.free[:, None] > 0
    positions = jnp.where(free, unknown, inputs.held)
    energy, force, turns = elastic_response(model.domains, positions, domain_materials(model, inputs.params))
    load = external_force(model, inputs.params, positions, inputs.forces)
    gradient = jnp.where(free, -(force + load), unknown * _typical_stiffness(inputs))
    # What has to balance: loads, and the elastic forces that supports and neighbours take.
    scale = jnp.linalg.norm(load) + jnp.linalg.norm(force)
    rotations = tuple(array_of(turn) for turn in turns)
    return Evaluation(energy, gradient, jnp.where(free, load, 0.0), scale + inputs.noise, inputs.noise, rotations)


def _typical_stiffness(inputs: _StaticInputs) -> Array:
    """Stiffness of an average node [N/m], so that fixed nodes do not spoil the scaling."""
    length = jnp.mean(inputs.model.elements.volumes) ** (1 / 3)
    _, young = ratio_and_modulus(*element_stiffness(inputs.model, inputs.params))
    return jax.lax.stop_gradient(jnp.mean(young) * length)


def _tangent(inputs: _StaticInputs, unknown: Array, rotations: tuple[Array, ...]) -> tuple[Operator, Operator]:
    """Products with the exact Hessian, and a preconditioner from the warped stiffness, which is always SPD."""
    model, pattern = inputs.model, inputs.model.pattern
    positions = jnp.where(model.free[:, None] > 0, unknown, inputs.held)
    pad = jnp.where(model.free > 0, 0.0, _typical_stiffness(inputs)).astype(positions.dtype)
    exact, precondition = tangent_and_preconditioner(model, inputs.params, positions, rotations, pad)

    def outside(operator: Operator) -> Operator:
        return lambda vector: pattern.scattered(operator(pattern.gathered(vector)))

    return outside(exact.apply), outside(precondition)
