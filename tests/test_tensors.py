import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxfem import tensors

RNG = np.random.default_rng(0)


def test_eigenbasis_is_orthonormal_and_symmetric():
    gram = np.einsum("aij,bij->ab", tensors.EIGENBASIS, tensors.EIGENBASIS)
    np.testing.assert_allclose(gram, np.eye(6), atol=1e-15)
    np.testing.assert_array_equal(tensors.EIGENBASIS, tensors.EIGENBASIS.transpose(0, 2, 1))


def test_eigenbasis_diagonalises_isotropic_stiffness():
    young, poisson = 3.0, 0.3
    lam, mu = young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))
    for k, s in enumerate(tensors.EIGENBASIS):
        stress = lam * np.trace(s) * np.eye(3) + 2 * mu * s
        eigenvalue = young / (1 - 2 * poisson) if k == 0 else 2 * mu
        np.testing.assert_allclose(stress, eigenvalue * s, atol=1e-15)


def test_coefficients_are_scalar_products_and_transpose_of_synthesis():
    s = RNG.standard_normal((3, 3, 7))
    s = s + s.transpose(1, 0, 2)
    coefficients = np.stack(tensors.to_eigenbasis(s))
    np.testing.assert_allclose(coefficients, np.einsum("rij,ije->re", tensors.EIGENBASIS, s), atol=1e-14)
    back = np.array([[np.asarray(c) for c in row] for row in tensors.from_eigenbasis(jnp.asarray(coefficients))])
    np.testing.assert_allclose(back, s, atol=1e-14)


def test_component_algebra_matches_numpy():
    a, b = RNG.standard_normal((2, 3, 3, 5))
    first, second = a.transpose(2, 0, 1), b.transpose(2, 0, 1)
    np.testing.assert_allclose(
        np.asarray(tensors.array_of(tensors.product(a, b))).transpose(2, 0, 1), first @ second, atol=1e-14
    )
    np.testing.assert_allclose(tensors.determinant(a), np.linalg.det(first), atol=1e-14)
    spd = np.einsum("ike,jke->ije", a, a) + np.eye(3)[:, :, None]
    inverse = np.asarray(tensors.array_of(tensors.guarded_inverse(spd))).transpose(2, 0, 1)
    np.testing.assert_allclose(inverse, np.linalg.inv(spd.transpose(2, 0, 1)), atol=1e-12)


def test_skew_is_the_cross_product():
    v, u = RNG.standard_normal((2, 4, 3))
    np.testing.assert_allclose(np.einsum("nij,nj->ni", tensors.skew(jnp.asarray(v)), u), np.cross(v, u), atol=1e-15)


def test_guarded_inverse_stays_finite_for_singular_matrices():
    zero = np.zeros((3, 3, 2))
    zero[0, 0, 1] = 1.0
    assert np.isfinite(np.asarray(tensors.array_of(tensors.guarded_inverse(jnp.asarray(zero))))).all()


PRODUCTS = [
    "mrk,mk->mr",
    "mrk,mr->mk",
    "mij,mik->mjk",
    "ij,jak->iak",
    "mki,kj->mij",
    "bij,bj->bi",
    "mji,mkj->mki",
    "i,j->ji",
]
SUMS = ["ij,jk->k", "ii,ij->j", "...ij,jk->...ik", "mrai,mrbi,mab->mr"]


@pytest.mark.parametrize("subscripts", PRODUCTS + SUMS)
def test_contractions_are_those_of_einsum_to_the_last_digit(subscripts):
    size = {name: number for number, name in enumerate("abijkmr", start=2)} | {".": 2}
    shapes = [[size[name] for name in names.replace("...", ".")] for names in subscripts.split("->")[0].split(",")]
    tensors_ = [jnp.asarray(RNG.standard_normal(shape)) for shape in shapes]
    found = tensors.contract(subscripts, *tensors_)
    np.testing.assert_array_equal(found, jnp.einsum(subscripts, *tensors_, precision="highest"))


def test_a_product_of_two_is_traced_as_one():
    for subscripts, count in ("mrk,mk->mr", 1), ("mij,mik->mjk", 1), ("i,j->ji", 1):
        shapes = [[2 + "ijkmr".index(name) for name in names] for names in subscripts.split("->")[0].split(",")]
        program = jax.make_jaxpr(lambda a, b, s=subscripts: tensors.contract(s, a, b))(*map(jnp.ones, shapes))
        assert [str(each.primitive) for each in program.eqns] == ["dot_general"] * count
