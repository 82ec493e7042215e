"""What is asked of a fit afterwards stands in its page."""

import dataclasses

import numpy as np

from jaxfem.fitting.asked import Contribution, Profile
from jaxfem.io.fit_after_page import after_parts
from jaxfem.materials.linear import Linear


@dataclasses.dataclass
class Found:
    """As much of a result as the page asks for."""

    constants: tuple
    values: dict
    profiles: tuple = ()
    contributions: tuple = ()


def test_profiles_and_type_b_are_shown():
    young = next(each for each in Linear.constants if each.name == "young")
    values = np.linspace(1.8e5, 2.2e5, 5)
    one_sided = Profile("young", values, ((values - 2e5) / 1e4) ** 2, (1.804e5, np.inf))
    added = Contribution("density", "1 %", {"young": 2000.0})
    text = "\n".join(after_parts(Found((young,), {"young": 2e5}, (one_sided,), (added,))))
    assert "from 1.804e+05 to no end before the bound" in text and "<svg" in text
    assert "<td>density</td><td>1 %</td><td>2e+03</td>" in text and "young Pa" in text
    assert after_parts(Found((young,), {"young": 2e5})) == []
    assert one_sided.line() == "profile of young (95 %): at least 1.804e+05" and "density off by 1 %" in added.line()
