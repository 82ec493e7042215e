"""Names of what strain is taken of, in one place: the parts of it, and the kinds of rows that are made of them."""

from typing import Literal, NamedTuple

Part = Literal["full", "deviatoric", "volumetric", "local_volumetric", "shared_volumetric"]
Domain = Literal["element", "edge", "node"]
"""What strain is averaged around."""


class Taken(NamedTuple):
    """A part of the strain: its `rows` among the six coefficients in the eigenbasis, of which 0 is volumetric, and the
    share of the bulk modulus that acts on it: "all", or one of those of `bulk_shares`."""

    rows: tuple[int, int]
    bulk: Literal["all", "local", "shared"] = "all"


PARTS: dict[str, Taken] = {
    "full": Taken((0, 6)),
    "deviatoric": Taken((1, 6)),
    "volumetric": Taken((0, 1)),
    "local_volumetric": Taken((0, 1), "local"),
    "shared_volumetric": Taken((0, 1), "shared"),
}
"""All parts by their names."""

STRAINS: dict[str, tuple[tuple[Domain, Part], ...]] = {
    "element": (("element", "full"),),
    "nodal_volume": (("element", "deviatoric"), ("node", "volumetric")),
    "smoothed": (("edge", "deviatoric"), ("node", "local_volumetric"), ("node", "shared_volumetric")),
}
"""What each kind of strain rows takes on which domains; shared volumetric rows come right after the local ones."""

PLAIN = "element"
"""The strain of each linear tetrahedron alone, all of it: what bodies have that name no other; it locks near nu = 0.5.
"""


def rows_of(part: Part) -> slice:
    """Which of the six coefficients in the eigenbasis belong to a part."""
    return slice(*PARTS[part].rows)
