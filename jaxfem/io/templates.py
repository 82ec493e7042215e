"""A commented scene file that holds every key there is: made from the declarations, so that none is left out.

What kinds take (materials, loads, joints, shapes, schemes), their classes say; keys of the files themselves are
explained here, and one without an explanation is a KeyError that the tests meet first.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from jaxfem.declared import Contact, RigidBody
from jaxfem.declared.joints import JOINTS
from jaxfem.declared.loads import LOADS
from jaxfem.elements.mass import MASSES
from jaxfem.elements.strains import PLAIN, STRAINS
from jaxfem.inputs import Input, Nested, Nodes, Number, Text, Vector, inputs_of
from jaxfem.io import scene_bodies, scene_coupling, scene_files
from jaxfem.io.fields import FIELDS
from jaxfem.materials.base import LAWS
from jaxfem.materials.constants import Constant
from jaxfem.materials.linear import Linear
from jaxfem.methods import METHODS
from jaxfem.rigid.shapes.base import obstacles, solids
from jaxfem.schemes import SCHEMES

Line = tuple[str, str]
"""The value in TOML and a comment; behind "instead of KEY" in it, KEY must go where this line comes in."""

TIME: dict[str, Line] = {
    "step": ("0.005", "s"),
    "duration": ("0.1", "s, a whole number of steps"),
    "steps": ("20", "instead of duration"),
    "save_every": ("2", "steps a written frame; 1 without it"),
    "halvings": ("3", "a step that fails is taken again in 2, 4 and 8 parts before the run ends"),
    "scheme": ('"backward_euler"', ""),
    "mass": ('"lumped"', f"or {', '.join(each for each in MASSES if each != 'lumped')}"),
    "rotation_update": ('"explicit"', 'of the elements; or "implicit", for steps in which bodies turn far'),
}
SOLVER: dict[str, Line] = {
    "method": ('"auto"', ""),
    "tolerance": ("1e-8", "relative residual of each step's solve; 1e-5 without it in float32"),
    "max_iterations": ("20000", "of each step's solve"),
    "precision": ('"float64"', 'or "float32"'),
}
OUTPUT: dict[str, Line] = {
    "folder": ('"results"', "beside this file; NAME_results without it"),
    "points": ("{ middle = [0.1, 0.05, 0.15] }", "m, of the undeformed bodies: their paths go to points.csv"),
    "tensors": ("true", "frames hold stress and strain as tensors"),
    "fields": ('["displacement", "von_mises"]', ""),
}
COMPARE: dict[str, Line] = {
    "methods": ('["corotated", { method = "groupwise", groups = 2 }]', "settings as in [solver]"),
    "step_factors": ("[1, 0.5]", "times the scene's step"),
    "tolerances": ("[1e-4, 1e-8]", "each with each method and step"),
    "finer": ("8", "steps of the converged run in one of the scene's; at least two in the shortest step"),
}
MESHES: dict[str, Line] = {
    "box": ("{ box = [0.2, 0.1, 0.1], cells = [2, 1, 1], tets_per_cell = 6, origin = [0, 0, 0.1] }", "m"),
    "beam": ("{ beam = [0.2, 0.1, 0.1], cells_along = 2, tets_per_cell = 6, origin = [0, 0, 0.1] }", "instead of mesh"),
    "ball": ("{ ball = 0.05, cells = 2, center = [0, 0, 0.2] }", "m, instead of mesh"),
    "surface": ('{ surface = "scan.stl", scale = 1e-3, size = 0.005 }', "instead of mesh: filled, edges of 5 mm"),
    "cad": ('{ cad = "part.step", size = 0.005, finest = 0.001 }', "instead of mesh: in m, finer where it is curved"),
    "cage": ('{ cage = "scan.stl", scale = 1e-3, elements = 1500 }', "instead of mesh: grid cells around it"),
    "file": ('{ file = "part.msh", scale = 1e-3, merge = true }', "instead of mesh: in mm, doubled nodes joined"),
}
BODY: dict[str, Line] = {
    "name": ('"block"', "others refer to it"),
    "position": ("[0.0, 0.0, 0.0]", "m, moved by this"),
    "rotate": ("{ axis = [0, 0, 1], degrees = 0, center = [0, 0, 0] }", "turned first"),
    "material": ('"linear"', "or one of those below"),
    "density": ("1000.0", "kg/m^3"),
    "mass_damping": ("1.0", "1/s, alpha of C = alpha M"),
    "fixed": ("{ below = { x = 0.01 } }", 'or a group, "x-", { box = [[..], [..]] }, { nodes = [0] }, a list of these'),
    "surface": ('{ file = "skin.stl", scale = 1e-3 }', "carried along in the frames; a cage shows its own"),
    "velocity": ("[0.0, 0.0, 0.0]", "m/s, at the start"),
    "strain": (f'"{PLAIN}"', f"or {', '.join(each for each in STRAINS if each != PLAIN)}: where Poisson's is high"),
    "rotation": ('"polar"', 'of the elements; or "gram_schmidt"'),
}
MOTION: dict[str, Line] = {
    "velocity": ("[0.0, 0.0, 0.0]", "m/s"),
    "amplitude": ("[0.0, 0.0, 0.005]", "m, of a sine"),
    "frequency": ("5.0", "Hz"),
    "phase": ("0.0", "rad"),
    "angular_velocity": ("[0.0, 0.0, 0.0]", "rad/s"),
    "center": ("[0.0, 0.0, 0.0]", "m, that it turns about"),
}
NUMBERS = {"young": "2e5", "poisson": "0.3", "damping": "0.002"}
"""Of a soft silicone; other constants stand there with what they are by default."""


def scene_template() -> str:
    """A scene that runs, with all other keys in comments."""
    time, solver, output = dict(TIME), dict(SOLVER), dict(OUTPUT)
    time["scheme"] = '"backward_euler"', f"or {', '.join(word for word in SCHEMES.words() if word != 'backward_euler')}"
    solver["method"] = '"auto"', f"or {', '.join(METHODS.words())}"
    output["fields"] = output["fields"][0], f"of {', '.join(FIELDS)}; all without it"
    parts = [
        "# A scene with every key that `jaxfem simulate` reads; what is in comments may be left out.",
        "# Units are SI: m, s, kg, N, Pa.",
        "",
        line("gravity", "[0.0, 0.0, -9.81]", "m/s^2"),
        *table("[time]", scene_files.TIME_KEYS, time, ("step", "duration", "save_every")),
        *_scheme_numbers(),
        *table("[solver]", scene_files.SOLVER_KEYS, solver, ("method",)),
        *_method_settings(),
        *table("[output]", scene_files.OUTPUT_KEYS, output, ("folder", "points")),
        *_soft_body(),
        *_rigid_body(),
        *_contact(),
        *_joints(),
        "",
        "# [compare]                     # what `jaxfem compare` runs; no other command looks at it",
        *(line(f"# {key}", *COMPARE[key]) for key in scene_files.COMPARE_KEYS),
    ]
    return "\n".join(parts) + "\n"


def line(key: str, value: str | None, comment: str) -> str:
    """A key with its value (None: `key` is the whole line) and a comment, in columns."""
    text = key if value is None else f"{key} = {value}"
    return f"{text:<31} # {comment}" if comment else text


def table(heading: str, keys: Sequence[str], known: Mapping[str, Line], active: Sequence[str]) -> Iterator[str]:
    """Lines of a table with all `keys` as they are `known`; those that are not `active` in comments."""
    yield from ("", heading)
    for key in keys:
        value, comment = known[key]
        yield line(f"{'' if key in active else '# '}{key}", value, comment)


def _scheme_numbers() -> Iterator[str]:
    for word in SCHEMES.words():
        for field in dataclasses.fields(SCHEMES[word].made):
            yield f'# with scheme = "{word}": {field.name} = {_written(field.default)}'


def _method_settings() -> Iterator[str]:
    for word in METHODS.words():
        for name, default in scene_files.method_settings(word).items():
            if default is not None:
                yield f'# with method = "{word}": {name} = {_written(default)}'


def _written(value: Any) -> str:
    """A number, a word or a flag as files write it."""
    return str(value).lower() if isinstance(value, bool) else repr(value).replace("'", '"')


def _soft_body() -> Iterator[str]:
    yield from ("", "[[body]]                        # a soft body; as many as wanted")
    for key in scene_bodies.BODY_KEYS:
        if key == "mesh":
            yield line("mesh", *MESHES["box"])
            yield from (line("# mesh", *MESHES[kind]) for kind in scene_bodies.MESH_KEYS if kind != "box")
        elif key == "material":
            yield line(f"# {key}", *BODY[key])
            yield from (line(each.name, _number(each), each.unit) for each in Linear.constants)
            yield from _other_laws()
        elif key not in ("driven", "load"):
            yield line(key if key in ("name", "density", "fixed") else f"# {key}", *BODY[key])
    yield from _blocks()


def _number(constant: Constant) -> str:
    return NUMBERS.get(constant.name) or repr(1.0 if constant.default is None else constant.default)


def _other_laws() -> Iterator[str]:
    for word in LAWS.words():
        law = LAWS[word].made
        if word == Linear.word:
            continue
        constants = [
            f"{each.name}{f' ({each.unit})' if each.unit else ''}"
            for each in law.constants_of(dict(law.options))
            if each.name not in {own.name for own in Linear.constants}
        ]
        options = [f"{name} = {_toml(value)}" for name, value in law.options.items()]
        yield f'# a "{word}" has {", ".join([*constants, *options]) or "no other constants"}'


def _blocks() -> Iterator[str]:
    """Loads and prescribed motions, each a table of its own."""
    places = {"nodes": '"x+"', "faces": '"x+"', "point": "[0.1, 0.05, 0.15]"}
    for word in LOADS.words():
        kind = LOADS[word].made
        value = "100.0" if kind.scalar else "[0.0, 0.0, -0.1]"
        yield from ("", "# [[body.load]]", f'# kind = "{word}"', f"# {kind.place} = {places[kind.place]}")
        yield line("# value", value, kind.unit)
    yield from ("", "# [[body.driven]]               # nodes that follow a prescribed motion", '# nodes = "x-"')
    yield from (line(f"# {key}", *MOTION[key]) for key in scene_bodies.MOTION_KEYS)


def _rigid_body() -> Iterator[str]:
    shapes = [kind for kind in solids() if kind.word != "file"]
    yield from ("", "[[rigid]]                       # a rigid body", "shape = { sphere = 0.04 }       # m")
    yield from (f"# shape = {_shape(kind)} # instead of shape" for kind in shapes if kind.word != "sphere")
    yield '# shape = { file = "part.stl", scale = 1e-3 } # instead of shape'
    known: dict[str, Line] = {
        "name": ('"ball"', ""),
        "mass": ("0.1", "kg"),
        "density": ("500.0", "kg/m^3, instead of mass"),
        "position": ("[0.1, 0.05, 0.25]", "m"),
        "rotate": ("{ axis = [0, 0, 1], degrees = 90 }", "or orientation, a quaternion"),
        "orientation": ("[1, 0, 0, 0]", "scalar first"),
        "velocity": ("[0.0, 0.0, 0.0]", "m/s"),
        "angular_velocity": ("[0.0, 0.0, 0.0]", "rad/s"),
        "inertia": ("[[1e-4, 0, 0], [0, 1e-4, 0], [0, 0, 1e-4]]", "kg m^2, that of the shape without it"),
        "fixed": ("true", "it does not move"),
        "motion": (f"{{ {', '.join(f'{key} = {MOTION[key][0]}' for key in scene_bodies.MOTION_KEYS)} }}", "prescribed"),
    }
    for key in scene_coupling.RIGID_KEYS:
        if key != "shape":
            yield line(key if key in ("name", "mass", "position") else f"# {key}", *known[key])
    assert set(inputs_of(RigidBody)) <= set(known)


def _contact() -> Iterator[str]:
    grounds = [kind for kind in obstacles() if kind.word not in ("plane", "file")]
    yield from ("", "[[contact]]                     # what may touch: a and b, or a and ground")
    yield from ('a = "ball"', "ground = { plane = [0, 0, 1], point = [0, 0, 0] }")
    yield from (f"# ground = {_shape(kind)} # instead of ground" for kind in grounds)
    yield '# ground = { file = "floor.stl", scale = 1e-3 } # instead of ground'
    yield '# b = "block" # instead of ground'
    values = {"friction": "0.5", "restitution": "0.0", "margin": "0.01", "separation": "0.1"}
    yield from _fields(Contact, values, left=("a", "b"))


def _joints() -> Iterator[str]:
    """A table of each kind."""
    for word in JOINTS.words():
        kind = JOINTS[word]
        yield from ("", "# [[joint]]", f'# kind = "{word}"', '# b = "ball" # a and b are bodies; the world without one')
        values = {"anchor": "[0.1, 0.05, 0.45]", "anchor_b": "[0.1, 0.05, 0.25]", "length": "0.2", "compliance": "0.0"}
        values |= {"damping": "0.0", "low": "-1.0", "high": "1.0"}
        yield from _fields(kind.made, values, left=("a", "b", *kind.fixed), every="# ")


def _fields(made: type, values: Mapping[str, str], left: Sequence[str], every: str = "# ") -> Iterator[str]:
    for name, each in inputs_of(made).items():
        if name in left:
            continue
        deep = isinstance(each, Nodes) or (isinstance(each, Input) and type(each).__name__ == "Vertices")
        note = "of a soft a" if deep else getattr(each, "unit", "")
        value = _nested(each) if isinstance(each, Nested) else values.get(name, each.example)
        yield line(f"{every}{'of soft bodies: ' if deep else ''}{name}", value, note)


def _nested(given: Nested) -> str:
    inner = {name: each.example for name, each in inputs_of(given.made).items()}
    return f"{{ {', '.join(f'{name} = {value}' for name, value in inner.items())} }}"


def _shape(kind: Any) -> str:
    """A small shape of a kind."""
    fields = inputs_of(kind)
    leading = kind.leading or next(iter(fields))
    values = {str(kind.word) if name == leading else name: _small(each) for name, each in fields.items()}
    return f"{{ {', '.join(f'{name} = {value}' for name, value in values.items())} }}"


def _small(each: Input) -> str:
    if isinstance(each, Vector):
        return str([0.05] * each.length)
    if isinstance(each, Number):
        return "0.05"
    return '"name"' if isinstance(each, Text) else each.example


def _toml(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else f'"{value}"' if isinstance(value, str) else str(value)
