"""Published stiffnesses of silicone rubbers, as priors to begin from.

Least-squares Yeoh constants of tensile data over 0 to 300 % (Marechal, Balland, Lindenroth, Petrou, Kontovounisios &
Bello 2020, ASTM D412 at 450 mm/min). Strain there is crosshead travel, so that stiffnesses are low, and what is
published of one trade name differs by 1.5 to 2.3 times: a prior has a factor of two, and is never the truth.
"""

import difflib
from typing import NamedTuple

from jaxfem.fitting.errors import FitError
from jaxfem.fitting.priors import LogNormal

FACTOR = 2.0


class Silicone(NamedTuple):
    """Yeoh constants `c1`, `c2`, `c3` [Pa] of a silicone of this trade name."""

    name: str
    c1: float
    c2: float
    c3: float

    @property
    def young(self) -> float:
        """Young's modulus at small strain, 6 c1 of what is incompressible [Pa]."""
        return 6 * self.c1


SILICONES = (
    Silicone("Ecoflex 00-10", 3.605e3, 0.1379e3, -0.189),
    Silicone("Ecoflex 00-30", 7.83e3, 0.1034e3, -0.807),
    Silicone("Ecoflex 00-50", 10.67e3, 0.2606e3, -3.25),
    Silicone("Dragon Skin 10 Medium", 24.29e3, 2.25e3, -54.3),
    Silicone("Dragon Skin 20", 70.4e3, 5.22e3, -113.0),
    Silicone("Dragon Skin 30", 100.5e3, 6.39e3, -149.0),
    Silicone("Mold Star 16", 42.2e3, 2.89e3, -43.9),
)


def silicone(name: str, constant: str = "young", factor: float = FACTOR) -> LogNormal:
    """A prior of a silicone's Young's modulus, or of its Yeoh constant `constant` "c1" or "c2", known to a `factor`.

    `name`: one of `SILICONES`, capitals and signs aside. FitError for one that is not there.
    """
    known = {_plain(each.name): each for each in SILICONES}
    if _plain(name) not in known:
        near = [known[each].name for each in known if _plain(name) and each.startswith(_plain(name))]
        near = near or [known[each].name for each in difflib.get_close_matches(_plain(name), known, 1, 0.85)]
        hint = f'did you mean "{near[0]}"?' if near else f"known: {', '.join(s.name for s in SILICONES)}"
        raise FitError(f'no silicone is called "{name}": {hint}')
    if constant.split(".")[0] not in ("young", "c1", "c2"):
        raise FitError(f"silicones are known by young, c1 and c2, not by {constant}: give a median and a factor")
    return LogNormal(float(getattr(known[_plain(name)], constant.split(".")[0])), factor)


def _plain(name: str) -> str:
    return "".join(each for each in str(name).lower() if each.isalnum())
