"""build: scene -> (model, params, state). Everything is checked and indexed here, once, on the host."""

import difflib
import inspect
from collections import Counter
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.building.choose import ROTATION_UPDATES, Built, method_asked, with_method
from jaxfem.building.coupled import with_coupling
from jaxfem.building.drifting import drifting_bodies
from jaxfem.building.far import warn_of_far
from jaxfem.building.opened import warn_of_open
from jaxfem.building.pattern import solver_order, sparsity
from jaxfem.building.soft import body_constants, body_domains, check_answers, check_body, check_laws, more_constants
from jaxfem.building.unused import warn_of_unused
from jaxfem.declared.errors import checked_choice, refuse_traced
from jaxfem.declared.scene import Scene, SceneError, SoftBody
from jaxfem.elements.mass import MASSES, MassKind, is_diagonal
from jaxfem.elements.tetra import Elements, shape_gradients
from jaxfem.mesh.groups import body_groups
from jaxfem.methods import Condensed, Facts, Method
from jaxfem.model import Choice, Model, Params, State
from jaxfem.motion import Motion
from jaxfem.pytrees import on_device, outline
from jaxfem.schemes import Scheme, scheme_of
from jaxfem.schemes.answers import scheme_flaw
from jaxfem.system.carry import first_carry
from jaxfem.system.memory import first_memory

# Groups of the preconditioner's coarse space: six rigid modes each. Smaller groups save iterations, but the coarse
# matrix is dense: its product may cost as much as the fine one's, so their number grows with the root of the nodes'.
GROUP_NODES = 12
MOST_GROUPS = 96
TOLERANCES = {True: 1e-8, False: 1e-5}  # relative residuals in double and single precision


def build(
    scene: Scene,
    *,
    solver: str | Method = "auto",
    scheme: str | Scheme = "backward_euler",
    mass: MassKind = "lumped",
    rotation_update: str = "explicit",
    dtype: Any = None,
    tolerance: float | None = None,
    max_iterations: int = 20_000,
    **numbers: Any,
) -> tuple[Model, Params, State]:
    """Turn a scene into the model, params and initial state that `step` takes.

    `solver`: "condensed" (conjugate gradients on the nodes), "direct" (rows of rigid bodies, eliminated), "mprgp" (all
    rows), "pgs" (all rows, Gauss-Seidel), a `Method` object, or "auto": the first where there are soft bodies, the
    second for rigid bodies alone, the third where either would be too dear; `model.method` and `model.choice` say what
    was taken and why. `scheme`: "backward_euler" (first order, damps what moves fast), "generalized_alpha" (second
    order), or a `Scheme` object with numbers of its own, like GeneralizedAlpha(rho_inf=0.5); its `numbers` may stand
    beside its name too, scheme="generalized_alpha", rho_inf=0.5. `mass`: "lumped", "consistent" or "averaged" (the mean
    of both; often the best frequencies); "mprgp" needs the first. Scenes with rigid bodies take the first scheme, those
    with joints or contacts the first mass.
    `rotation_update`: the elements' rotations are "explicit" (those at the start of the step, or where the second-order
    scheme expects its forces: one linear solve) or "implicit" (iterated to the end of the step: several solves, for
    steps in which the body turns
    far). `dtype`: float32 or float64; JAX's default when None. `tolerance`: relative residual of each step's solve,
    1e-8 in float64 and 1e-5 in float32 when None. Raises SceneError with the body and the remedy; warns
    (AccuracyWarning) of known bias, and (UnusedWarning) of numbers that change nothing.
    """
    if not isinstance(scene, Scene):
        raise SceneError(f"build takes a Scene, not a {type(scene).__name__}: write build(Scene([body]))")
    refuse_traced({"tolerance": tolerance, "max_iterations": max_iterations, **numbers})
    checked_choice("mass", mass, MASSES)
    checked_choice("rotation_update", rotation_update, ROTATION_UPDATES)
    asked = method_asked(solver, rotation_update)
    dtype = jnp.dtype(jnp.zeros(()).dtype if dtype is None else dtype)
    _check_numbers(dtype, tolerance, max_iterations)
    every = _names(scene.bodies)
    bodies, names = scene.soft, [n for n, b in zip(every, scene.bodies, strict=True) if isinstance(b, SoftBody)]
    check_answers(bodies, names, dtype)
    for body, name in zip(bodies, names, strict=True):
        check_body(body, name)
    made = _scheme(scheme, dtype, numbers, asked)
    check_laws(bodies, names)
    _check_same(bodies, "rotation")
    offsets = np.cumsum([0] + [len(b.mesh.points) for b in bodies])
    model = _model(bodies, names, offsets, dtype, tolerance, max_iterations, made, mass)
    params = _params(scene, bodies, dtype)
    starts = [np.broadcast_to(np.asarray(b.velocity, float), b.mesh.points.shape) for b in bodies]
    velocities = np.concatenate([np.zeros((0, 3)), *starts])
    state = State(model.rest, on_device(velocities, dtype), on_device(0.0, dtype))
    state = state.replace(internal=first_memory(model.domains, dtype))
    model, params, state = with_coupling(scene, every, model, params, state)
    warn_of_unused(scene, every, model, params)
    warn_of_far(scene.bodies, every, dtype)
    warn_of_open(scene.joints)
    model = model.replace(drifting=drifting_bodies(scene, every, model), outline=outline(params.replace(constants={})))
    if flaw := scheme_flaw(made, dtype):
        raise SceneError(f'scheme "{made.name}", a {type(made).__name__}: {flaw}')
    state = state.replace(carry=first_carry(state, _points(bodies)))
    return with_method(Built(_facts(scene, model), model, params, state), asked, rotation_update, solver)


def _facts(scene: Scene, model: Model) -> Facts:
    """What decides which methods can serve a scene."""
    return Facts(
        soft=bool(scene.soft),
        rigid=bool(scene.rigid),
        tied=bool(model.joints or model.contacts),
        mass=model.mass,
        strains=tuple(dict.fromkeys(body.strain for body in scene.soft)),
        scheme=model.scheme,
        nonlinear=tuple(dict.fromkeys(type(law).__name__ for law in model.laws if not law.linear)),
    )


def _scheme(scheme: str | Scheme, dtype: Any, numbers: dict[str, Any], method: Method | None) -> Scheme:
    try:
        return scheme_of(scheme, dtype, **numbers)
    except ValueError as problem:
        known = [name for name, each in inspect.signature(build).parameters.items() if each.kind is each.KEYWORD_ONLY]
        near = [word for name in numbers for word in difflib.get_close_matches(name, known, n=1)]
        hint = f"; did you mean build's `{near[0]}`?" if near else ""
        own = [] if method is None else [name for name in numbers if name in vars(method)]
        if own:
            hint = f"; it is one of the method: give solver={type(method).__name__}({own[0]}=...)"
        raise SceneError(f"{problem}{hint}") from None


def _model(
    bodies: Sequence[SoftBody],
    names: Sequence[str],
    offsets: np.ndarray,
    dtype: Any,
    tolerance: float | None,
    max_iterations: int,
    scheme: Scheme,
    mass: MassKind,
) -> Model:
    points = _points(bodies)
    own = [b.mesh.cells + o for b, o in zip(bodies, offsets[:-1], strict=True)]
    cells = np.concatenate([np.zeros((0, 4), np.int64), *own])
    gradients, volumes = shape_gradients(points, cells)
    nodal_volumes = np.bincount(cells.ravel(), np.repeat(volumes / 4, 4), minlength=len(points))
    free, driven = _supports(bodies, offsets)
    node_body = np.repeat(np.arange(len(bodies)), np.diff(offsets))
    body_of_element = np.repeat(np.arange(len(bodies)), [len(b.mesh.cells) for b in bodies])
    groups = _groups(points, node_body)
    place = solver_order(len(points), groups)[2] if bodies else np.zeros(0, np.int64)
    domains = body_domains(bodies, cells, gradients, volumes, body_of_element, place, points, dtype)
    return Model(
        rest=on_device(points, dtype),
        elements=Elements(
            on_device(cells, jnp.int32),
            on_device(gradients.transpose(1, 2, 0), dtype),
            on_device(volumes, dtype),
            on_device(body_of_element, jnp.int32),
        ),
        domains=domains,
        nodal_volumes=on_device(nodal_volumes, dtype),
        node_body=on_device(node_body, jnp.int32),
        free=on_device(free, dtype),
        pattern=sparsity(points, domains, groups, dtype, None if is_diagonal(mass) else cells) if bodies else None,  # type: ignore[arg-type]
        loads=tuple(
            load.entered(b, int(o), dtype) for b, o in zip(bodies, offsets[:-1], strict=True) for load in b.loads
        ),
        driven=tuple(on_device(d, jnp.int32) for d in driven),
        tolerance=jnp.asarray(TOLERANCES[dtype.itemsize > 4] if tolerance is None else tolerance, dtype),
        max_iterations=on_device(max_iterations, jnp.int32),
        scheme=scheme,
        method=Condensed(),  # until all is known: see `choose.py`
        choice=Choice("auto", "not chosen yet"),
        rotation_kind=bodies[0].rotation if bodies else "polar",
        mass=mass,
        bodies=tuple(names),
        laws=tuple(body.made_of.law for body in bodies),
        more_constants=more_constants(bodies),
        load_units=tuple(load.unit for b in bodies for load in b.loads),
    )


def _points(bodies: Sequence[SoftBody]) -> np.ndarray:
    """Nodes of all bodies, (n, 3)."""
    return np.concatenate([np.zeros((0, 3)), *(body.mesh.points for body in bodies)])


def _groups(points: np.ndarray, node_body: np.ndarray) -> list[np.ndarray]:
    """Nodes of each group of the preconditioner's coarse space."""
    if not len(points):
        return []
    return body_groups(points, node_body, GROUP_NODES, max(MOST_GROUPS, round(1.5 * len(points) ** 0.5)))


def _supports(bodies: Sequence[SoftBody], offsets: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """1 for each node (n,) that moves by its own dynamics, else 0; the nodes of each prescribed motion."""
    pairs = list(zip(bodies, offsets[:-1], strict=True))
    driven = [body.nodes_of("driven", each.nodes) + offset for body, offset in pairs for each in body.driven]
    held = [body.nodes_of("fixed", body.fixed) + offset for body, offset in pairs]
    _check_disjoint(driven)
    free = np.ones(offsets[-1])
    free[np.concatenate([np.zeros(0), *held, *driven]).astype(int)] = 0
    return free, driven


def _params(scene: Scene, bodies: Sequence[SoftBody], dtype: Any) -> Params:
    def cast(motion: Motion) -> Motion:
        made: Motion = jax.tree.map(
            lambda v: jnp.asarray(v, dtype), motion, is_leaf=lambda v: isinstance(v, tuple | list | np.ndarray)
        )
        return made

    return Params(
        constants=body_constants(bodies, dtype),
        gravity=on_device(scene.gravity, dtype),
        loads=tuple(jnp.asarray(load.value, dtype) for b in bodies for load in b.loads),
        motions=tuple(cast(d.motion) for b in bodies for d in b.driven),
    )


def _check_same(bodies: Sequence[SoftBody], what: str) -> None:
    if len({getattr(b, what) for b in bodies}) > 1:
        raise SceneError(f"bodies of one scene must share `{what}`; got {[getattr(b, what) for b in bodies]}")


def _check_disjoint(driven: Sequence[np.ndarray]) -> None:
    together = np.concatenate([np.zeros(0, int), *driven])
    unique, counts = np.unique(together, return_counts=True)
    if (counts > 1).any():
        raise SceneError(f"node {unique[counts > 1][0]} follows two prescribed motions; give each node at most one")


def _check_numbers(dtype: Any, tolerance: float | None, max_iterations: int) -> None:
    if dtype not in (jnp.float32, jnp.float64):
        raise SceneError(f"dtype is {dtype}; use float32 or float64")
    if dtype == jnp.float64 and not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        raise SceneError("float64 needs jax.config.update('jax_enable_x64', True) before the first JAX call")
    if tolerance is not None and not 0 < tolerance < 1:
        raise SceneError(f"tolerance is {tolerance}; it is a relative residual between 0 and 1, like 1e-6")
    if max_iterations < 1:
        raise SceneError(f"max_iterations is {max_iterations}; give at least 1")


def _names(bodies: Sequence[Any]) -> list[str]:
    """Labels made unique by numbering repeated ones."""
    counts, seen = Counter(b.label for b in bodies), Counter[str]()
    names = []
    for body in bodies:
        seen[body.label] += 1
        names.append(body.label if counts[body.label] == 1 else f"{body.label}_{seen[body.label]}")
    return names
