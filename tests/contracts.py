"""Shapes of what the public functions take and return, checked at every call of every test by jaxtyping and beartype.

A contract is a function of the call's arguments by name and of its `result`, annotated with shapes. It is looked at
after the call, so that errors of the function's own come first; under jit, vmap and grad that is when JAX traces it.
"""

import functools
import inspect
import sys
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from beartype import beartype
from jaxtyping import Array, Float, Int, Integer, Num, jaxtyped

import jaxfem as jf
from jaxfem import rotation
from jaxfem.mesh import locate

CONTRACTS: dict[Callable[..., Any], Callable[..., None]] = {}


def contract(function: Callable[..., Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Declares the contract of a function."""

    def declare(shapes: Callable[..., None]) -> Callable[..., None]:
        CONTRACTS[function] = jaxtyped(typechecker=beartype)(shapes)
        return CONTRACTS[function]

    return declare


def checked(function: Callable[..., Any], shapes: Callable[..., None] | None = None) -> Callable[..., Any]:
    """`function`, which raises where a call does not keep to `shapes`: its own contract where none is given."""
    shapes = CONTRACTS[function] if shapes is None else shapes
    signature, wanted = inspect.signature(function), inspect.signature(shapes).parameters

    @functools.wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        result = function(*arguments, **named)
        bound = signature.bind(*arguments, **named)
        bound.apply_defaults()
        shapes(result=result, **{name: array(value) for name, value in bound.arguments.items() if name in wanted})
        return result

    return call


def install() -> None:
    """Puts the checked functions in the place of the plain ones, wherever the package has them."""
    for function in CONTRACTS:
        call = checked(function)
        for name, module in list(sys.modules.items()):
            if name.split(".")[0] == "jaxfem":
                for attribute in [key for key, value in vars(module).items() if value is function]:
                    setattr(module, attribute, call)


def array(value: Any) -> Any:
    """Numbers of the host as an array, as the functions themselves take them; all else as it is."""
    return jnp.asarray(value) if isinstance(value, list | tuple | float | np.ndarray | np.generic) else value


class Fields(type):
    """A type whose instances are those of another with fields of given types; shapes are bound as in a signature."""

    def __instancecheck__(cls, value: Any) -> bool:
        return isinstance(value, cls.whole) and all(
            isinstance(array(getattr(value, name)), kind) for name, kind in cls.kinds.items()
        )


class Values(type):
    """The type of dictionaries whose values, all of them, are of a given type."""

    def __instancecheck__(cls, value: Any) -> bool:
        return isinstance(value, dict) and all(isinstance(array(each), cls.kind) for each in value.values())


def fields(whole: type, **kinds: Any) -> Any:
    """The type of `whole` with fields of these kinds. Its name holds them: beartype takes equal names for one type."""
    return Fields(f"{whole.__name__}({kinds})", (), {"whole": whole, "kinds": kinds})


def rigid(lead: str) -> Any:
    poses = {"positions": "b 3", "orientations": "b 4", "velocities": "b 3", "angular_velocities": "b 3"}
    return fields(jf.RigidState, **{name: Float[Array, f"{lead} {own}"] for name, own in poses.items()})


def state(lead: str) -> Any:
    nodes = Float[Array, f"{lead} n 3"]
    kinds = {"positions": nodes, "velocities": nodes, "accelerations": nodes | None, "rigid": rigid(lead) | None}
    return fields(jf.State, **kinds, time=Num[Array, lead])


def step_info(lead: str) -> Any:
    whole, ratios = Int[Array, lead], Float[Array, f"{lead} *frequencies"] | None
    return fields(jf.StepInfo, **solve_kinds(lead), inverted=whole, scheme_damping=ratios)


def solve_kinds(lead: str) -> dict[str, Any]:
    whole = Int[Array, lead]
    return {"status": whole, "iterations": whole, "residual": Float[Array, lead], "weakly_active": whole}


State, StepInfo, SolveInfo = state(""), step_info(""), fields(jf.solvers.SolveInfo, **solve_kinds(""))
Frames, FrameInfos = state("{steps//every}"), step_info("{steps//every}")
Model = fields(
    jf.Model,
    rest=Float[Array, "n 3"],
    free=Float[Array, "n"],
    nodal_volumes=Float[Array, "n"],
    node_body=Integer[Array, "n"],
    frequencies=Float[Array, "*frequencies"] | None,
)
Params = fields(jf.Params, gravity=Num[Array, "3"])
Scalar, Forces = Num[Array, ""] | int, Num[Array, "n 3"] | None
Vectors, Quaternions, Matrices = Num[Array, "*b 3"], Num[Array, "*b 4"], Num[Array, "*b 3 3"]


@contract(jf.step)
def step(
    model: Model, params: Params, state: State, dt: Scalar, forces: Forces, result: tuple[State, StepInfo]
) -> None: ...


@contract(jf.rollout)
def rollout(
    model: Model,
    params: Params,
    state: State,
    dt: Scalar,
    steps: int,
    every: int,
    forces: Forces | Num[Array, "{steps} n 3"],
    result: tuple[Frames, FrameInfos],
) -> None: ...


@contract(jf.prepare)
def prepare(model: Model, params: Params, state: State, dt: Scalar, result: Model) -> None: ...


@contract(jf.equilibrium)
def equilibrium(model: Model, params: Params, state: State, forces: Forces, result: tuple[State, StepInfo]) -> None: ...


@contract(jf.modes)
def modes(
    model: Model,
    params: Params,
    state: State,
    count: int,
    result: tuple[Float[Array, "{count}"], Float[Array, "{count} n 3"]],
) -> None: ...


@contract(jf.energies)
def energies(
    model: Model,
    params: Params,
    state: State,
    result: fields(jf.Energies, **dict.fromkeys(("kinetic", "elastic", "gravity"), Float[Array, ""])),
) -> None: ...


@contract(jf.impulses)
def impulses(
    model: Model,
    state: fields(jf.State, positions=Float[Array, "*lead n 3"]),
    result: Values("Impulses", (), {"kind": Float[Array, "*lead _ _"]}),
) -> None: ...


@contract(jf.scheme_damping)
def scheme_damping(frequencies: Num[Array, "*k"] | int, result: Float[Array, "*k"]) -> None: ...


@contract(jf.solvers.pgs)
@contract(jf.solvers.mprgp)
def box_problem(
    A: Num[Array, "n n"] | Callable, b: Num[Array, "n"], result: tuple[Float[Array, "n"], SolveInfo]
) -> None: ...


@contract(rotation.gram_schmidt_rotation)
@contract(rotation.nearest_rotation)
def nearest_rotation(F: Matrices, result: Float[Array, "*b 3 3"]) -> None: ...


@contract(rotation.rotation_gap)
def rotation_gap(F: Matrices, R: Matrices, result: Float[Array, "*b"]) -> None: ...


@contract(rotation.quaternion_to_matrix)
def quaternion_to_matrix(q: Quaternions, result: Float[Array, "*b 3 3"]) -> None: ...


@contract(rotation.quaternion_from_rotation_vector)
def quaternion_from_rotation_vector(v: Vectors, result: Float[Array, "*b 4"]) -> None: ...


@contract(rotation.rotation_vector_to_matrix)
def rotation_vector_to_matrix(v: Vectors, result: Float[Array, "*b 3 3"]) -> None: ...


@contract(locate)
def place(
    mesh_points: Num[Array, "n 3"],
    cells: Integer[Array, "m 4"],
    result: tuple[Integer[np.ndarray, "q"], Float[np.ndarray, "q 4"], Float[np.ndarray, "q"]],
) -> None: ...
