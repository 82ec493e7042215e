"""What `build` returns: the model (topology and configuration), params (what users fit and sweep), and the state."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, Self

import jax
import jax.numpy as jnp

from jaxfem.batching import one_program
from jaxfem.elements.domains import DomainMaterial, Domains
from jaxfem.elements.finite import material_of
from jaxfem.elements.mass import MassKind, SharedMass, consistent_share, is_diagonal
from jaxfem.elements.pattern import Pattern
from jaxfem.elements.reshaping import Shaped
from jaxfem.elements.tetra import Elements, RotationKind
from jaxfem.indexing import gather, scatter_add
from jaxfem.loads import ResolvedLoad
from jaxfem.materials.base import Material
from jaxfem.materials.constants import DENSITY, MASS_DAMPING, Constant
from jaxfem.motion import Motion
from jaxfem.pytrees import Pytree, static
from jaxfem.ranges import within
from jaxfem.rigid.dynamics import RigidParams, RigidSet
from jaxfem.schemes import Scheme
from jaxfem.state import Carry as Carry
from jaxfem.state import State as State
from jaxfem.state import StepInfo as StepInfo

Array = jax.Array


class Params(Pytree):
    """The numbers that users differentiate, fit and sweep.

    `constants`: name -> value of each constant of the bodies' material laws, and `density` [kg/m^3]: each a scalar (all
    bodies), an array (bodies,) or an array (elements,); where a body's law lacks a constant stands the others' mean.
    Each is an attribute too, and one that `replace` takes: `params.young`, `params.replace(young=2e5)`.
    `gravity` (3,) [m/s^2]; `loads` and `motions` hold one value for each that the scene declares.
    `rigid`: masses and motions of rigid bodies; `joints`, `contacts`: name of a group of rows -> its values
    (compliance, limits, motors, friction, ...), under the names of `Model.joints` and `Model.contacts`.
    """

    constants: dict[str, Any]
    gravity: Array = dataclasses.field(metadata=within())
    loads: tuple[Any, ...] = dataclasses.field(default=(), metadata=within())
    motions: tuple[Motion, ...] = ()
    rigid: RigidParams | None = None
    joints: dict[str, Any] = dataclasses.field(default_factory=dict)
    contacts: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __getattr__(self, name: str) -> Any:  # only for what is no field
        constants = vars(self).get("constants")
        if isinstance(constants, dict) and name in constants:
            return constants[name]
        raise AttributeError(f"params hold no {name!r}" + (f"; constants: {', '.join(constants)}" if constants else ""))

    def replace(self, **changes: Any) -> Self:
        """The same with some fields or constants changed."""
        own = {name: changes.pop(name) for name in list(changes) if name in self.constants}
        if own:
            changes["constants"] = {**changes.get("constants", self.constants), **own}
        return super().replace(**changes)


class AnyMethod(Protocol):
    """What `step` asks of a way to solve a step (see `methods/base.py`): static, hashable, without arrays."""

    @property
    def name(self) -> str:
        """Its word in `build` and scene files."""

    def prepare(self, model: "Model", params: Params, state: State, dt: Array) -> Any:
        """What pays to be made once for many steps of about `dt` [s]; None where there is nothing."""

    def start(self, model: "Model", params: Params, state: State) -> Any:
        """The first `State.memory`."""

    def step(
        self, model: "Model", params: Params, state: State, dt: Array, forces: Array | None, cache: Any
    ) -> tuple[State, "StepInfo"]:
        """One step."""

    @property
    def own_elasticity(self) -> bool:
        """Whether its elastic forces are its own, and not those of the materials on their elements."""

    def elasticity(self, model: "Model", params: Params, positions: Array, rates: Array) -> Any:
        """`energy`, `force` and `power` of those, None where they are the materials'."""

    def impulses(self, model: "Model", memory: Any) -> dict[str, Array]:
        """The impulses of the last step by the names of their groups of rows, as far as the memory holds them."""


class Choice(NamedTuple):
    """How a model came to its method: what was `asked` for ("auto", or a name), and the `reason` for what it got."""

    asked: str
    reason: str


class Drifting(Pytree):
    """Bodies that nothing holds, soft ones first, b in all. `body` (p,): that of each node, then each rigid body's own.

    `together` (b,): the least number among the bodies that joints or contacts may tie to each. `loose` (2 b,): 1 for
    bodies without fixed or driven nodes, then for groups, by that number, of nothing but such. `soft` (2 b,): 1 for
    soft bodies, then for groups of them alone.
    """

    body: Array
    together: Array
    loose: Array
    soft: Array


class Model(Shaped):
    """Topology and configuration of a built scene; arrays are leaves, only flags are static.

    `elements`: all tetrahedra; `domains`: where strain is taken, one entry a kind. `rest` (n, 3) undeformed nodes [m],
    `nodal_volumes` (n,) [m^3], `node_body` (n,), `free` (n,) 1 where a node moves by its own dynamics and 0 where it is
    fixed or driven, `driven`: node indices of each prescribed motion. `method`: how steps are solved, and `choice`: how
    it was chosen; `plan`: what the method made of the topology when the scene was built; `cache`: what `prepare` made
    for it, else None. `scheme`: the time scheme; `frequencies` [rad/s]: those whose damping by the scheme `info`
    reports. `rigid`: the rigid bodies, None without; `joints`, `contacts`: groups of rows by name. `size` [m]: the
    largest extent of a scene with joints, contacts or rigid bodies, or of a body in it. `node_group` (n,): a
    number that nodes share where joints or contacts may tie their bodies, where the scheme restarts at impacts.
    `laws`: the material law of each body, in the order of `bodies`. `islands` (b,): a number that rigid bodies share
    which joints tie, b where they are tied to soft bodies; None where nothing can strike. `drifting`: what nothing
    holds, None where there is no such soft body. `reshaped`: whether `rebuild` made it. `more_constants`: those beside
    the laws' and density, such as mass-proportional damping, of scenes or methods that have them. `load_units`: of the
    values in `params.loads`. `outline`: structure and shapes of what params hold beside constants, as steps expect it.
    """

    rest: Array
    elements: Elements
    domains: tuple[Domains, ...]
    nodal_volumes: Array
    node_body: Array
    free: Array
    pattern: Pattern
    loads: tuple[ResolvedLoad, ...]
    driven: tuple[Array, ...]
    tolerance: Array
    max_iterations: Array
    scheme: Scheme
    method: AnyMethod = static()
    choice: Choice = static()
    rotation_kind: RotationKind = static()
    mass: MassKind = static()
    bodies: tuple[str, ...] = static()
    plan: Any = None
    cache: Any = None
    frequencies: Array | None = None
    rigid: RigidSet | None = None
    joints: dict[str, Any] = dataclasses.field(default_factory=dict)
    contacts: dict[str, Any] = dataclasses.field(default_factory=dict)
    node_group: Array | None = None
    size: Array | None = None
    islands: Array | None = None
    drifting: Drifting | None = None
    laws: tuple[Material, ...] = static(default=())
    more_constants: tuple[Constant, ...] = static(default=())
    reshaped: bool = static(default=False)
    load_units: tuple[str, ...] = static(default=())
    outline: Any = static(default=None)

    @property
    def constants(self) -> dict[str, Constant]:
        """The constants that `Params` holds, by name: those of the bodies' laws, density, then `more_constants`."""
        laws = [each for law in dict.fromkeys(self.laws) for each in law.constants]
        return {each.name: each for each in (*laws, DENSITY, *self.more_constants)}

    @property
    def dragged(self) -> bool:
        """Whether a body has mass-proportional damping."""
        return MASS_DAMPING in self.more_constants

    @property
    def has_memory(self) -> bool:
        """Whether a body's material remembers what happened to it (`State.internal`)."""
        return any(law.remembers for law in self.laws)

    def bodies_of(self, wanted: Callable[[Material], bool]) -> str:
        """The bodies whose law is `wanted`, each with its law, in words for messages; empty where none is."""
        pairs = zip(self.bodies, self.laws, strict=True)
        return ", ".join(f'"{body}" ({type(law).__name__})' for body, law in pairs if wanted(law))

    @property
    def nonlinear(self) -> bool:
        """Whether a body's material is not linear in the step: its rows are then made anew at the solution."""
        return not all(law.linear for law in self.laws)

    @property
    def coupled(self) -> bool:
        """Whether anything but soft bodies takes part: rigid bodies, joints or contacts."""
        return self.rigid is not None or bool(self.joints) or bool(self.contacts)

    def unsolved(self) -> "Model":
        """The same without method, choice, plan and cache: functions that need none are traced once for all of them."""
        return self.replace(method=None, choice=None, plan=None, cache=None)

    @property
    def nodes(self) -> int:
        """Number of nodes of all bodies."""
        return self.rest.shape[0]

    def body_nodes(self, name: str) -> Array:
        """Indices of the nodes of the body `name`; host side."""
        return jnp.flatnonzero(self.node_body == self.bodies.index(name))


def per_element(model: Model, value: Array) -> Array:
    """A material value (scalar, one a body, or one an element) as one number an element, (E,)."""
    value = jnp.asarray(value)
    if value.ndim == 0 or value.shape == (1,):
        return jnp.broadcast_to(value.reshape(()), (model.elements.count,))
    return value if value.shape == (model.elements.count,) else gather(value, model.elements.body)


def elementwise(model: Model, value: Array) -> Array:
    """A material value as a scalar () where it is one, else as one number an element, (E,)."""
    value = jnp.asarray(value)
    return value.reshape(()) if value.size == 1 else per_element(model, value)


def element_constants(model: Model, params: Params) -> dict[str, Array]:
    """The laws' constants by name, each a scalar () where it is one, else one number an element, (E,)."""
    others = {DENSITY.name, *(each.name for each in model.more_constants)}
    return {name: elementwise(model, value) for name, value in params.constants.items() if name not in others}


def domain_materials(model: Model, params: Params) -> list[DomainMaterial]:
    """Stiffness and damping of each kind of domains, without what materials remember."""
    values = element_constants(model, params)
    return [material_of(each, values) for each in model.domains]


def element_stiffness(model: Model, params: Params) -> tuple[Array, Array]:
    """Volumetric and deviatoric stiffness (3K, 2 mu) of the elements, each () or (E,) [Pa]."""
    values = element_constants(model, params)
    if not model.laws:
        return jnp.zeros_like(model.elements.volumes), jnp.zeros_like(model.elements.volumes)
    law, *others = dict.fromkeys(model.laws)
    volumetric, deviatoric = law.stiffness(values)
    for other in others:
        its = jnp.array([each == other for each in model.laws])[model.elements.body]
        own = other.stiffness(values)
        volumetric, deviatoric = jnp.where(its, own[0], volumetric), jnp.where(its, own[1], deviatoric)
    return volumetric, deviatoric


def element_damping(model: Model, params: Params) -> Array:
    """Damping of the elements by their laws, () or (E,) [s]."""
    values = element_constants(model, params)
    law, *others = dict.fromkeys(model.laws)
    found = jnp.asarray(law.damping(values))
    for other in others:
        its = jnp.array([each == other for each in model.laws])[model.elements.body]
        found = jnp.where(its, other.damping(values), found)
    return found


def nodal_stiffness(model: Model, params: Params) -> Array:
    """What the material around each node holds it with at least, (n,) [N/m]: sums of mu V |grad N|^2."""
    elements = model.elements
    shear = element_stiffness(model, params)[1] / 2
    parts = shear * elements.volumes * jnp.sum(elements.gradients**2, 1)
    stiffness: Array = scatter_add(parts.T, elements.cells, model.nodes)
    return stiffness


def nodal_mass(model: Model, density: Array) -> Array:
    """Lumped mass of each node, (n,) [kg]: each element's mass shared by its four corners."""
    return _nodal_mass(jnp.asarray(density), model.nodal_volumes, model.node_body, model.elements)


@one_program
def _nodal_mass(density: Array, nodal_volumes: Array, node_body: Array, elements: Elements) -> Array:
    if density.ndim == 0 or density.shape == (1,):
        return density.reshape(()) * nodal_volumes
    if density.shape != (elements.count,):
        return density[node_body] * nodal_volumes
    quarter = density * elements.volumes / 4
    return jnp.zeros_like(nodal_volumes).at[elements.cells].add(quarter[:, None])


def shared_mass(model: Model, density: Array) -> SharedMass | None:
    """What the model's mass matrix has beside the lumped masses; None where it has nothing."""
    if is_diagonal(model.mass) or model.pattern.corner_pairs is None:
        return None
    element_mass = consistent_share(model.mass) * per_element(model, density) * model.elements.volumes
    return SharedMass(element_mass, model.elements.cells, model.pattern.corner_pairs)
