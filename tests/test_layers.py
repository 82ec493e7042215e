"""Imports point one way, ground first; and importing the package changes nothing global."""

import ast
import pathlib
import re
import subprocess
import sys

import jaxfem

ROOT = pathlib.Path(jaxfem.__file__).parent

# Ground first: a module may import from its own layer and from those before it.
LAYERS = [
    ["answers", "pytrees", "batching", "inputs", "ranges", "registry", "indexing"],
    ["rotation", "tensors"],
    ["solvers", "mesh", "materials"],
    ["schemes", "motion", "loads"],
    ["elements", "rigid"],
    ["state"],
    ["model", "rows"],
    ["declared"],
    ["system", "energies"],
    ["methods"],
    ["stepping", "building"],
    ["statics", "vibration", "diagnose"],
    ["fitting", "sweeping"],
    ["io"],
    ["cli"],
]
LEVEL = {name: level for level, names in enumerate(LAYERS) for name in names}


def imported(path: pathlib.Path) -> set[str]:
    """Top-level jaxfem modules that a file imports, wherever in it the import stands."""
    package = path.relative_to(ROOT.parent).parts[:-1]
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            names = [f"{base}.{node.module}" if base and node.module else base or node.module or ""]
            if names[0] == "jaxfem":
                names = [f"jaxfem.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            continue
        found |= {name.split(".")[1] for name in names if name.startswith("jaxfem.")}
    return found


def test_every_module_has_a_layer():
    modules = {p.name.removesuffix(".py") for p in ROOT.iterdir() if p.suffix == ".py" or (p / "__init__.py").exists()}
    assert modules - {"__init__", "__main__", "__pycache__"} == set(LEVEL)


def test_the_overview_has_every_module_in_the_order_of_the_layers():
    page = (ROOT.parent / "docs" / "architecture.md").read_text()
    rows = [line.split("|")[1] for line in page.splitlines() if line.startswith("| `") and line.count("|") == 4]
    named = [re.findall(r"`(\w+)`", row) for row in rows]
    assert {name for names in named for name in names} == set(LEVEL)
    levels = [LEVEL[name] for names in named for name in names]
    assert levels == sorted(levels)


def test_imports_point_to_the_ground():
    wrong = []
    for path in ROOT.rglob("*.py"):
        layer = path.relative_to(ROOT).parts[0].removesuffix(".py")
        if layer in LEVEL:
            wrong += [
                f"{path.name}: {layer} -> {name}" for name in imported(path) if LEVEL.get(name, 99) > LEVEL[layer]
            ]
    assert not wrong


def test_import_sets_nothing_global():
    code = (
        "import jax, logging; before = jax.config.jax_enable_x64, logging.getLogger().level; import jaxfem; "
        "import jax.numpy as jnp; "
        "assert (jax.config.jax_enable_x64, logging.getLogger().level) == before == (False, 30); "
        "assert jnp.zeros(1).dtype == jnp.float32; import sys; assert 'matplotlib' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_files_are_short():
    """A file is read in one sitting: at most 300 lines."""
    files = [*ROOT.rglob("*.py"), *pathlib.Path(__file__).parent.rglob("*.py")]
    lengths = {path.name: len(path.read_text().splitlines()) for path in files}
    assert {name: length for name, length in lengths.items() if length > 300} == {}


def test_one_module_alone_tells_jax_of_classes():
    """By which JAX tells them apart, as it does not those of `register_dataclass` (see `pytrees.py`)."""
    words = ("register_dataclass(", "register_pytree", "register_static(")
    users = {p.name for p in ROOT.rglob("*.py") if any(f"tree_util.{word}" in p.read_text() for word in words)}
    assert users == {"pytrees.py"}


def test_one_module_alone_knows_meshio():
    """It is no longer kept up: what replaces it must have one place to go to."""
    users = [p.name for p in ROOT.rglob("*.py") if "import meshio" in p.read_text()]
    assert users == ["foreign.py"]


def test_products_take_all_digits_on_every_device():
    """Accelerators take ten bits of single precision where nothing is said: so `jaxfem.tensors` says it."""
    words, loose = {"einsum", "vdot", "dot", "inner", "matmul", "tensordot"}, []
    for path in ROOT.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in words:
                of_jax = isinstance(node.func.value, ast.Name) and node.func.value.id == "jnp"
                if of_jax and "precision" not in {keyword.arg for keyword in node.keywords}:
                    loose.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert not loose
