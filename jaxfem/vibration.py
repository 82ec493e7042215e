"""modes: natural frequencies and mode shapes about any shape, with their derivatives."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.elements.domains import domain_strains
from jaxfem.elements.elasticity import elastic_force
from jaxfem.elements.mass import MASSES, MassKind, mass_product
from jaxfem.elements.tetra import has_energy
from jaxfem.materials.moduli import ratio_and_modulus
from jaxfem.methods.base import refused_elasticity
from jaxfem.methods.nodes.tangent import tangent_and_preconditioner
from jaxfem.model import Model, Params, State, domain_materials, element_stiffness, nodal_mass, per_element
from jaxfem.pytrees import Pytree
from jaxfem.solvers.eigen import lowest_eigenpairs
from jaxfem.solvers.implicit import or_nan
from jaxfem.solvers.pcg import pcg
from jaxfem.stepping import StepError, check_call, typed
from jaxfem.tensors import array_of, contract

Array = jax.Array
Eigenpairs = tuple[Array, Array, Array]

# Values closer than this (relative) count as one repeated value: their shapes may turn into each other at no cost.
_REPEATED = 1e-6


class _Inputs(Pytree):
    model: Model
    params: Params
    positions: Array


def modes(
    model: Model, params: Params, state: State, count: int = 6, mass: MassKind | None = None
) -> tuple[Array, Array]:
    """The `count` lowest natural frequencies (count,) [rad/s], ascending, and shapes (count, n, 3) [kg^-1/2].

    Small vibrations about `state.positions`, prestress included, fixed and driven nodes at rest, damping left out.
    `mass`: the model's when None; "lumped", "consistent" or "averaged" (their mean: often the most accurate). Shapes s
    have s'Ms = 1, their largest entry positive. A free body's rigid motions have frequency 0. NaN: modes that did not
    converge (both), and frequencies of a shape that would buckle. Differentiable in params and state.positions;
    vmappable. Frequencies that repeat have any basis of their space as shapes: derivatives there are those of this
    basis, without its turning; for a frequency, exact where the perturbation does not mix the basis.
    Raises StepError. Source: Knyazev 2001 (solver); Nelson 1976, Fox & Kapoor 1968 (derivatives).
    """
    mass = model.mass if mass is None else mass
    if mass not in MASSES:
        raise StepError(f"mass is {mass!r}; known: {', '.join(MASSES)}")
    if model.coupled:
        raise StepError("modes takes soft bodies alone, without rigid bodies, joints or contacts")
    if not has_energy(model.rotation_kind):
        raise StepError(
            f'rotation = "{model.rotation_kind}" has no energy, hence no modes: build with rotation = "polar"'
        )
    if not (isinstance(count, int) and 1 <= count <= 3 * model.nodes):
        raise StepError(f"count is {count}; give an integer from 1 to {3 * model.nodes}, three a node")
    if refused := refused_elasticity(model):
        raise StepError(f"modes {refused}")
    remembering = model.bodies_of(lambda law: law.remembers)
    if remembering:
        raise StepError(
            f"modes takes materials without a memory, which {remembering} has: such a body has no frequencies of its "
            "own. Give it the Linear law of its stiffness at the frequency asked for: of what flows the elastic "
            "constants, of Viscoelastic the modulus that storage_and_loss tells"
        )
    params, state = typed(model, params, state)
    check_call(model, params, state, 1.0)
    found: tuple[Array, Array] = _modes(model, params, state.positions, count, mass)
    return found


@partial(jax.jit, static_argnums=(3, 4))
def _modes(model: Model, params: Params, positions: Array, count: int, mass: MassKind) -> tuple[Array, Array]:
    inputs = _Inputs(model, params, positions)
    values, shapes, errors = _eigenpairs(count, mass, inputs)
    still = jnp.sqrt(model.tolerance) * _shift(inputs)
    moving = values > still
    frequencies = jnp.where(moving, jnp.sqrt(jnp.where(moving, values, 1)), 0)
    good = errors <= model.tolerance
    frequencies = jnp.where(good & (values > -still), frequencies, jnp.nan)
    return frequencies, jnp.where(good[:, None, None], shapes, jnp.nan)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _eigenpairs(count: int, mass: MassKind, inputs: _Inputs) -> Eigenpairs:
    """Squared frequencies (count,), shapes (count, n, 3), and relative errors of the shapes (count,)."""
    pattern = inputs.model.pattern
    apply, precondition, largest = _operators(inputs)
    block = min(count + max(4, count // 3), 3 * inputs.model.nodes)
    free = pattern.gathered(inputs.model.free)[:, None]
    start = jax.random.normal(jax.random.key(0), (block, *free.shape[:1], 3), inputs.positions.dtype) * free

    def flat(operator: Any) -> Any:
        return lambda vectors: jax.vmap(operator)(vectors.reshape(-1, *start.shape[1:])).reshape(vectors.shape)

    def masses(vector: Array) -> Array:
        return pattern.gathered(_mass(mass, inputs, pattern.scattered(vector)))

    settings = {"shift": _shift(inputs), "largest": largest, "tol": inputs.model.tolerance}
    begun = flat(precondition)(start.reshape(block, -1))
    with jax.default_matmul_precision("highest"):  # accelerators otherwise multiply with fewer digits
        found = lowest_eigenpairs(flat(apply), flat(masses), flat(precondition), begun, count, **settings)
    shapes = jax.vmap(pattern.scattered)(found.vectors[:count].reshape(count, *start.shape[1:]))
    # By differences within elements: float32 keeps more digits than in the assembled product.
    values = _inner(shapes, jax.vmap(partial(_stiffness, inputs))(shapes))
    values /= _inner(shapes, jax.vmap(partial(_mass, mass, inputs))(shapes))
    entries = shapes.reshape(count, -1)
    peak = jnp.take_along_axis(entries, jnp.argmax(jnp.abs(entries), axis=1, keepdims=True), axis=1)
    return values, shapes * jnp.sign(peak)[:, :, None], found.errors[:count]


@_eigenpairs.defjvp
def _eigenpairs_jvp(
    count: int, mass: MassKind, primals: tuple[_Inputs], tangents: tuple[_Inputs]
) -> tuple[Eigenpairs, Eigenpairs]:
    (inputs,), (change,) = primals, tangents
    values, shapes, errors = _eigenpairs(count, mass, inputs)

    def products(given: _Inputs) -> tuple[Array, Array]:
        return jax.vmap(partial(_stiffness, given))(shapes), jax.vmap(partial(_mass, mass, given))(shapes)

    # With s'Ms = 1:  d lambda = s'(dK - lambda dM) s,  and  (K - lambda M) ds = -(dK - lambda dM - d lambda M) s.
    (_, momenta), (stiff_change, mass_change) = jax.jvp(products, (inputs,), (change,))
    force = stiff_change - values[:, None, None] * mass_change
    mixed = contract("iak,jak->ij", force, shapes)  # s_j'(dK - lambda_i dM) s_i
    gap = values[:, None] - values[None]
    size = jnp.abs(values)[:, None] + jnp.abs(values)[None] + _shift(inputs)
    apart = jnp.abs(gap) > _REPEATED * size
    weights = jnp.where(apart, mixed / jnp.where(apart, gap, 1), 0)
    weights -= 0.5 * jnp.diag(_inner(shapes, mass_change))
    within = contract("ij,jak->iak", weights, shapes)
    outside = force - contract("ij,jak->iak", mixed, momenta)
    beyond = _beyond(mass, inputs, values, shapes, momenta, outside)
    return (values, shapes, errors), (jnp.diagonal(mixed), within - beyond, jnp.zeros_like(errors))


def _beyond(mass: MassKind, inputs: _Inputs, values: Array, shapes: Array, momenta: Array, right: Array) -> Array:
    """Solve (K - lambda_i M) x_i = right_i (count, n, 3) among fields that are M-orthogonal to the shapes.

    There it is positive definite; on the shapes themselves it is made so by top M S S'M.
    """
    top = jax.lax.stop_gradient(jnp.abs(values[-1]) + _shift(inputs))

    def operator(value: Array, vector: Array) -> Array:
        inner = _without(vector, shapes, momenta)
        product = _stiffness(inputs, inner) - value * _mass(mass, inputs, inner)
        onto = contract("jak,ak->j", momenta, vector)
        return _without(product, momenta, shapes) + top * contract("j,jak->ak", onto, momenta)

    def solve(_: Any, vectors: Array) -> Array:
        known = jax.lax.stop_gradient((inputs, values, shapes, momenta))
        return _solve_beyond(mass, *known, top, vectors)

    found: Array = jax.lax.custom_linear_solve(
        partial(jax.vmap(operator), values), right, solve, transpose_solve=solve, symmetric=True
    )
    return found


def _solve_beyond(
    mass: MassKind, inputs: _Inputs, values: Array, shapes: Array, momenta: Array, top: Array, rights: Array
) -> Array:
    """`_beyond` by conjugate gradients on the assembled matrix, in solver order; NaN where they fail."""
    apply, precondition, _ = _operators(inputs)
    model, pattern = inputs.model, inputs.model.pattern
    s, ms = jax.vmap(pattern.gathered)(shapes), jax.vmap(pattern.gathered)(momenta)

    def one(value: Array, right: Array) -> Array:
        def matvec(x: Array) -> Array:
            inner = _without(x, s, ms)
            product = apply(inner) - value * pattern.gathered(_mass(mass, inputs, pattern.scattered(inner)))
            return _without(product, ms, s)

        def invert(residual: Array) -> Array:
            return _without(precondition(_without(residual, ms, s)), s, ms)

        vector = pattern.gathered(right)
        # What was 0 but for rounding stays 0.
        floor = jnp.finfo(s.dtype).eps * jnp.linalg.norm(vector)
        limits = {"tol": model.tolerance, "max_iterations": model.max_iterations, "absolute": floor}
        found = or_nan(*pcg(matvec, _without(vector, ms, s), invert, **limits))
        onto = contract("jak,ak->j", s, vector) / top
        return pattern.scattered(found + contract("j,jak->ak", onto, s))

    return jax.vmap(one)(values, rights)


def _without(vector: Array, basis: Array, dual: Array) -> Array:
    """A field less its part along `basis` (count, n, 3), told by products with `dual`."""
    return vector - contract("j,jak->ak", contract("jak,ak->j", dual, vector), basis)


def _operators(inputs: _Inputs) -> tuple[Any, Any, Array]:
    """Products with the exact tangent and a preconditioner of it, shifted, in solver order; largest eigenvalue."""
    model, positions = inputs.model, inputs.positions
    rotations = [array_of(rotation) for _, rotation, _ in domain_strains(model.domains, positions)]
    lumped = nodal_mass(model, inputs.params.density)
    shift = _shift(inputs)
    pad = jnp.where(model.free > 0, 0.0, shift * lumped)
    matrix, precondition = tangent_and_preconditioner(
        model, inputs.params, positions, rotations, pad, shift * lumped * model.free
    )
    weights = jnp.where(model.free > 0, lumped, jnp.inf)
    largest = jnp.max(jnp.trace(model.pattern.scattered(matrix.diagonal_blocks), axis1=1, axis2=2) / weights)
    return matrix.apply, precondition, largest


def _stiffness(inputs: _Inputs, vector: Array) -> Array:
    """Exact tangent times (n, 3), zero on fixed nodes: minus the rate of the elastic force."""
    model = inputs.model
    materials = domain_materials(model, inputs.params)
    free = model.free[:, None]

    def force(positions: Array) -> Array:
        return -elastic_force(model.domains, positions, materials)

    force_rate: Array = free * jax.jvp(force, (inputs.positions,), (free * vector,))[1]
    return force_rate


def _mass(kind: MassKind, inputs: _Inputs, vector: Array) -> Array:
    """Mass matrix times (n, 3), zero on fixed nodes."""
    model, density = inputs.model, inputs.params.density
    element_mass = per_element(model, density) * model.elements.volumes
    free = model.free[:, None]
    return free * mass_product(kind, nodal_mass(model, density), element_mass, model.elements.cells, free * vector)


def _shift(inputs: _Inputs) -> Array:
    """A squared frequency well below the first elastic ones, by which rigid motions are told from them [1/s^2]."""
    model, params = inputs.model, inputs.params
    length = jnp.linalg.norm(jnp.max(model.rest, axis=0) - jnp.min(model.rest, axis=0))
    _, young = ratio_and_modulus(*element_stiffness(model, params))
    shift: Array = jax.lax.stop_gradient(0.01 * jnp.mean(young) / (jnp.mean(params.density) * length**2))
    return shift


def _inner(a: Array, b: Array) -> Array:
    return jnp.sum(a * b, axis=(1, 2))
