"""What is asked of a fit afterwards stands in its page."""

import dataclasses

import numpy as np
import pytest

from jaxfem.fitting.advice import interval_in_words, text_of
from jaxfem.fitting.asked import Contribution, Profile
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.unknowns import chosen
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


def test_what_is_open_to_one_side_is_no_number():
    young = next(each for each in Linear.constants if each.name == "young")
    text = text_of((young,), {"young": 1.7e11}, {"young": 1.9e15}, {"young": (1.1e7, np.inf)})
    assert text == "  young       at least 1.1e+07 Pa   (95 %; the search ended at 1.7e+11)"
    assert interval_in_words(-np.inf, np.inf, "Pa") == "open towards both sides"
    assert interval_in_words(1.0, 2.0, "Pa") == "1 to 2 Pa" and interval_in_words(-np.inf, 2.0) == "at most 2"


def test_groups_of_faces_have_no_constants():
    young = next(each for each in Linear.constants if each.name == "young")
    known = {name: young for name in ("young", "young.beam", "young.beam.stiff", "young.ball")}
    with pytest.raises(FitError, match=r'"x-" is no group of elements of "beam", and groups of nodes.*there are stiff'):
        chosen(["young.beam.x-"], known)
    with pytest.raises(FitError, match=r'of "ball".*the mesh has none'):
        chosen(["young.ball.x-"], known)
    with pytest.raises(FitError, match=r'did you mean "young\.ball"'):
        chosen(["young.bal"], known)
