"""The [fit.field] of `jaxfem fit`: after the fit a constant is found element by element, from what the fit found."""

import csv
import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxfem.fitting import FieldFit, FitError, FitResult, Take, fit_field
from jaxfem.fitting.fields import as_columns
from jaxfem.io.fit_after_page import field_part
from jaxfem.io.fit_files import FitFile
from jaxfem.model import Model

FILE = "field.csv"


def check_field(file: FitFile) -> None:
    """FitError where a delay is fitted, which fields do not know of."""
    if file.field and any(name.startswith("delay") for name in file.settings["parameters"] or ()):
        raise FitError('[fit.field] takes the release as it is: leave "delay" out of parameters')


def field_of(file: FitFile, result: FitResult, takes: Sequence[Take]) -> FieldFit:
    """Find the field that the file asks for."""
    asked = dict(file.field or {})
    by_name = {each.name: each for each in result.takes if not each.held_out}
    fitted = [
        dataclasses.replace(take, params=by_name[take.name].params, state=by_name[take.name].state)
        for take in takes
        if take.name in by_name
    ]
    constant = asked.pop("constant", "young")
    held = fitted[0].params.constants.get(constant)
    start = None if held is None else float(np.mean(np.asarray(held)))
    noise = file.settings["noise"]
    sigma = noise.sigma if noise.known else None
    return fit_field(fitted, constant, sigma=sigma, start=start, checks=file.settings["checks"], **asked)


def write_field(folder: Path, found: FieldFit, model: Model) -> tuple[Path, str]:
    """field.csv, and the page's part."""
    table = as_columns(found, model)
    path = folder / FILE
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(table)
        writer.writerows([f"{cell:.7g}" for cell in row] for row in zip(*table.values(), strict=True))
    return path, field_part(found, model)
