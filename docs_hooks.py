"""Pages of the documentation that are made from the package when it is built, so that they cannot go stale."""

import argparse
import importlib
import inspect
from collections.abc import Iterator
from typing import Any

from mkdocs.structure.files import File, Files

import jaxfem
from jaxfem.cli.main import parser
from jaxfem.io.fit_template import fit_template
from jaxfem.io.sweep_template import sweep_template
from jaxfem.io.templates import scene_template

MORE = ("fitting", "sweeping", "io")
"""Packages with public names beside those that `jaxfem` itself has."""


def on_files(files: Files, config: Any) -> Files:
    """Add the reference."""
    for name, text in pages().items():
        files.append(File.generated(config, f"reference/{name}.md", content=text))
    return files


def pages() -> dict[str, str]:
    """The pages of the reference by name."""
    made = scene_template(), fit_template(), sweep_template()
    scene, fit, sweep = (f"```toml\n{text}```\n" for text in made)
    return {
        "python": "".join(_python()),
        "scene_files": f"# Scene files\n\nAll keys, as `jaxfem new scene` writes them.\n\n{scene}",
        "fit_files": f"# Fit files\n\nAll keys, as `jaxfem new fit` writes them.\n\n{fit}",
        "sweep_files": f"# Sweep files\n\nAll keys, as `jaxfem new sweep` writes them.\n\n{sweep}",
        "command_line": "# Commands\n\n" + "".join(_commands(parser())),
    }


def _python() -> Iterator[str]:
    """Every public name of the package, then of its public modules."""
    yield "# Python\n\n"
    for name in jaxfem.__all__:
        if name.startswith("_"):
            continue
        thing = getattr(jaxfem, name)
        if not inspect.ismodule(thing):
            yield f"::: jaxfem.{name}\n\n"
    for name in jaxfem.__all__:
        if inspect.ismodule(getattr(jaxfem, name)):
            yield f"::: jaxfem.{name}\n\n"
    for package in MORE:
        module = importlib.import_module(f"jaxfem.{package}")
        others = [name for name in module.__all__ if name not in jaxfem.__all__]
        yield f"## jaxfem.{package}\n\n{inspect.getdoc(module)}\n\n"
        yield from (f"::: jaxfem.{package}.{name}\n\n" for name in others)


def _commands(made: argparse.ArgumentParser) -> Iterator[str]:
    """The help of the command and of each of its commands."""
    yield f"## {made.prog}\n\n```text\n{made.format_help()}```\n\n"
    for action in made._actions:
        if isinstance(action, argparse._SubParsersAction):
            for inner in action.choices.values():
                yield from _commands(inner)
