"""[[beside]] tables of fit files: what was measured of a scene beside the markers."""

import dataclasses
from typing import Any

from jaxfem.fitting.beside import KINDS, Datum
from jaxfem.fitting.errors import FitError
from jaxfem.io.toml_tables import SceneFileError, Table


def beside_of(table: Table, above: str) -> tuple[Datum, ...]:
    """The data of [[beside]] tables, or with `above` = "take." of [[take.beside]] ones; what each kind takes its class
    says. SceneFileError for kinds that are none, missing and unknown keys, and numbers that cannot be."""
    found = []
    for number, values in enumerate(table.tables("beside", f"{above}beside")):
        where = f"[[{above}beside]] {number + 1}"
        made = KINDS[Table(values, where, None).choice("kind", KINDS.words())].made
        fields = dataclasses.fields(made)
        own = Table(values, where, ("kind", *(each.name for each in fields)))
        given: dict[str, Any] = {name: value for name, value in own.values.items() if name != "kind"}
        for each in fields:
            if each.default is dataclasses.MISSING and each.name not in given:
                raise SceneFileError(f"missing key {each.name!r} in {where}: give it in {made.unit or 'its unit'}")
        try:
            datum = made(**given)
            datum.numbers(), datum.scale(), datum.labels()
        except FitError as problem:
            raise SceneFileError(f"{where}: {problem}") from problem
        found.append(datum)
    return tuple(found)
