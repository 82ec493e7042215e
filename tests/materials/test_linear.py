import numpy as np
import pytest

import jaxfem as jf
from jaxfem.materials import moduli as material
from jaxfem.materials.constants import MaterialError


def test_constants_agree_with_each_other():
    young, poisson = 2.0e5, 0.3
    lam, mu = young * poisson / ((1 + poisson) * (1 - 2 * poisson)), material.shear_modulus(young, poisson)
    bulk = material.bulk_modulus(young, poisson)
    np.testing.assert_allclose(bulk, lam + 2 * mu / 3, rtol=1e-15)
    np.testing.assert_allclose(mu * (3 * lam + 2 * mu) / (lam + mu), young, rtol=1e-14)
    np.testing.assert_allclose(material.eigenstiffness(young, poisson), (3 * bulk, 2 * mu), rtol=1e-15)


BAD = [
    ("young", 0.0, 'young of "block" is 0: it must be > 0 Pa'),
    ("young", -1e5, 'young of "block" is -100000'),
    ("young", np.nan, 'young of "block" is nan'),
    ("young", 1e-3, "outside the plausible 1 to 1e[+]13 in SI units"),
    ("poisson", 0.5, 'poisson of "block" is 0.5: it must lie strictly between -1 and 0.5'),
    ("poisson", -1.0, 'poisson of "block" is -1'),
    ("density", 0.0, 'density of "block" is 0: it must be > 0'),
    ("density", 1e6, "check its unit"),
    ("damping", -1e-3, 'damping of "block" is -0.001: it must be >= 0'),
    ("damping", 50.0, "check its unit"),
    ("young", [1e5, 1e5], r'young of "block" has shape \(2,\); give one number, or one for each of its 6 elements'),
    ("young", [1e5, 1e5, 1e5, -2.0, 1e5, 1e5], 'young of element 3 of "block" is -2'),
]


@pytest.mark.parametrize(("name", "value", "text"), BAD)
def test_impossible_materials_are_refused_by_name(name, value, text):
    values = {"young": 1e5, "poisson": 0.3, "density": 1000.0, name: value}
    with pytest.raises(MaterialError, match=text):
        jf.SoftBody(jf.mesh.box((1, 1, 1), (1, 1, 1), name="block"), **values)
