"""Every public name says what it is: modules, functions, classes, their methods and properties."""

import ast
import inspect
import pathlib

import jaxfem as jf

ROOT = pathlib.Path(jf.__file__).parent
KINDS = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


def public(node):
    """Definitions in a module or class whose names have no underscore in front, with those inside public classes."""
    for each in node.body:
        if isinstance(each, KINDS) and not each.name.startswith("_"):
            yield each.name, each, node
            if isinstance(each, ast.ClassDef):
                yield from ((f"{each.name}.{name}", inner, outer) for name, inner, outer in public(each))


def inherited(module, name):
    """Whether a method takes its docstring from a base class, where the same thing is promised."""
    owner = __import__(module, fromlist=["_"])
    for part in name.split("."):
        owner = getattr(owner, part)
    return bool(inspect.getdoc(owner))


def is_setter(node):
    return any(isinstance(each, ast.Attribute) and each.attr == "setter" for each in node.decorator_list)


def test_everything_public_has_a_docstring():
    bare, count = [], 0
    for path in ROOT.rglob("*.py"):
        tree = ast.parse(path.read_text())
        module = ".".join(path.relative_to(ROOT.parent).with_suffix("").parts).removesuffix(".__init__")
        count += 1
        if not ast.get_docstring(tree) and tree.body:
            bare.append(module)
        for name, node, _ in public(tree):
            count += 1
            if not ast.get_docstring(node) and not is_setter(node) and not inherited(module, name):
                bare.append(f"{module}.{name}")
    assert not bare and count > 500


def test_names_that_users_import_are_listed_and_documented():
    """Also those that are made by a call: their text is not the one that Python writes for any dataclass."""
    bare = []
    for owner in (jf, jf.mesh, jf.solvers):
        for name in owner.__all__:
            each = getattr(owner, name)
            text = inspect.getdoc(each) or ""
            if not isinstance(each, str) and (len(text) < 15 or text.startswith(f"{name}(")):
                bare.append(f"{owner.__name__}.{name}")
    assert not bare


def test_the_readme_names_what_there_is():
    """Errors and warnings that the documentation speaks of are at the top of the package."""
    assert {"MeshError", "SceneError", "StepError", "FitError", "MaterialError", "MeshWarning"} <= set(jf.__all__)
    assert jf.MeshError is jf.mesh.MeshError and jf.__version__.count(".") == 2
