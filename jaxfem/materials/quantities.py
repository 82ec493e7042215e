"""Numbers that are no constant of a material and yet can be fitted: declared beside the field that holds them.

    friction: Any = field(metadata=within(low=0) | fitted(FRICTION))

Fits then know unit, transform and usual bounds, as of a material's constant, and find the number by its path.
"""

import dataclasses
from collections.abc import Iterator
from typing import Any

from jaxfem.materials.constants import Constant, Identity, Logistic

KEY = "fitted"


@dataclasses.dataclass(frozen=True)
class Quantity:
    """A `constant` that a field holds; `angular`: its unit where the joint's coordinate is an angle, else the same;
    `needs`: the flag of the rows without which it has no effect."""

    constant: Constant
    angular: str = ""
    needs: str = ""

    def of(self, length: bool) -> Constant:
        """The constant, of a length or an angle."""
        if length or not self.angular:
            return self.constant
        return dataclasses.replace(self.constant, unit=self.angular)


def fitted(constant: Constant, angular: str = "", needs: str = "") -> dict[str, Quantity]:
    """A field's metadata, beside its range."""
    return {KEY: Quantity(constant, angular, needs)}


def quantities_of(values: Any) -> Iterator[tuple[str, Quantity]]:
    """(field, quantity) of all fields that can be fitted; none of what is no dataclass."""
    for each in dataclasses.fields(values) if dataclasses.is_dataclass(values) else ():
        if KEY in each.metadata:
            yield each.name, each.metadata[KEY]


def positive(name: str, unit: str, label: str, angular: str = "", needs: str = "") -> dict[str, Quantity]:
    """Metadata of a number >= 0, searched by its logarithm: an error bar that leaves it open becomes a limit."""
    advice = f"must be >= 0 {unit}".rstrip()
    return fitted(Constant(name, unit, advice, label=label, low=0.0, closed=True, limit=True), angular, needs)


def share(name: str, label: str) -> dict[str, Quantity]:
    """Metadata of a number between 0 and 1, searched on a logistic curve."""
    return fitted(
        Constant(
            name,
            "",
            "must be between 0 and 1",
            label=label,
            low=0.0,
            high=1.0,
            closed=True,
            transform=Logistic(0.0, 1.0),
            bounds=(1e-3, 0.999),
            absolute=True,
        )
    )


def signed(name: str, unit: str, label: str, angular: str = "") -> dict[str, Quantity]:
    """Metadata of a number of either sign, searched as it is."""
    return fitted(signed_constant(name, unit, label), angular)


def signed_constant(name: str, unit: str, label: str) -> Constant:
    """A number of either sign; usual bounds are its start less and more a hundred times its size, 1 at least."""
    return Constant(name, unit, "must be finite", label=label, transform=Identity(), bounds=(-100.0, 100.0))
