"""Lanes last with what large, mixed and finely weighed bodies need: groups' modes, several laws, consistent masses."""

import jax.numpy as jnp
import numpy as np
import pytest
from scenes import beam

import jaxfem as jf
from jaxfem import sweeping
from jaxfem.materials.constants import Constant
from jaxfem.sweeping.lanes import body as bodies
from jaxfem.sweeping.lanes import modes
from jaxfem.sweeping.lanes.solve import refined, solve

DT, STEPS = 5e-3, 10
KEPT = {"x": "positions", "v": lambda run: run.last.velocities}
SHEAR = Constant("shear", "Pa", "must be > 0 Pa", label="shear modulus", low=0.0, stiffness=True)
BULK = Constant("bulk", "Pa", "must be > 0 Pa", label="bulk modulus", low=0.0)


def same(scene, variants, derivatives=(), outputs=KEPT, **options):
    """Lanes give what one after another gives, and the derivatives too; the result of the lanes."""
    options = {"dt": DT, "steps": STEPS, "every": STEPS, "derivatives": derivatives, **options}
    loop, lanes = (jf.sweep(*scene, variants, outputs=outputs, engine=e, **options) for e in ("loop", "lanes"))
    assert loop.good.all() and lanes.good.all()
    for name, want in loop.outputs.items():
        share = 1e-6 if name in outputs else 1e-5
        np.testing.assert_allclose(lanes[name], want, atol=share * np.abs(want).max() + 1e-12, err_msg=name)
    return lanes


@pytest.mark.parametrize("scheme", ["backward_euler", "generalized_alpha"])
def test_modes_of_groups(monkeypatch, scheme):
    """Where all modes are too dear: as above, from fewer modes, and some more iterations."""
    monkeypatch.setattr(modes, "GROUP", 5)
    scene = beam((4, 2, 1), build={"scheme": scheme})
    young = {"young": np.array([1e4, 1e5, 1e6])}
    full = same(scene, young)
    monkeypatch.setattr(bodies, "ALL", 0)
    made = sweeping.Sweep(*scene, young, dt=DT, steps=1, outputs=KEPT, engine="lanes")
    held = made._prepared.shapes.shape
    assert held[1] < held[0] == 3 * int(scene[0].free.sum()) and not made._prepared.complete
    groups = same(scene, young, derivatives=["young"], outputs={"tip": lambda run: run.last.positions[-1, 2]})
    assert full.iterations.max() < groups.iterations.max() < 200


def test_modes_of_groups_are_those_of_the_body():
    """With one group a body, they are its affine maps: three slow ones of a free body, at which it does not strain."""
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (3, 1, 1))
    model, _, _ = jf.build(jf.Scene([jf.SoftBody(mesh, young=1e5, poisson=0.3, density=1e3)]))
    points, count = np.asarray(model.rest), model.nodes
    volumes = np.asarray(model.elements.volumes)
    rest = modes.Rest(
        np.moveaxis(np.asarray(model.elements.gradients), -1, 0),
        volumes,
        np.asarray(model.elements.cells),
        np.asarray(model.nodal_volumes),
        count,
        np.full(len(volumes), 2.5),
        np.ones(len(volumes)),
        0.0,
    )
    squared, shapes = modes.group_modes(rest, points, np.zeros(count, int))
    assert shapes.shape == (3 * count, 12) and (squared[:6] < 1e-9 * squared[-1]).all() and squared[6] > 0
    np.testing.assert_allclose(shapes.T @ (np.repeat(rest.mass, 3)[:, None] * shapes), np.eye(12), atol=1e-10)
    whole, _ = modes.all_modes(rest)
    assert squared[6] >= whole[6]  # Rayleigh: fewer shapes, higher frequencies


class TwoModuli(jf.Material, word="sweeps_two_moduli"):
    """Linear elasticity by its shear and bulk moduli [Pa]."""

    constants = (SHEAR, BULK)

    def stiffness(self, values):
        return 3 * values["bulk"], 2 * values["shear"]


def test_several_laws():
    box = jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1))
    first = jf.SoftBody(box, young=1e5, poisson=0.3, density=1e3, damping=2e-3, fixed="x-", name="first")
    law = TwoModuli(shear=2e4, bulk=8e4)
    second = jf.SoftBody(box.translated((0, 0.1, 0)), material=law, density=9e2, name="second")
    scene = jf.build(jf.Scene([first, second], gravity=(0, 0, -9.81)))
    variants = {"young": np.array([1e5, 3e4]), "shear": np.array([2e4, 1e4]), "damping": np.array([0.0, 2e-3])}
    share = np.random.default_rng(0).normal(size=scene[0].rest.shape)
    outputs = {**KEPT, "whole": lambda run: (run.last.positions * share).sum()}
    same(scene, variants, derivatives=["young", "shear"], outputs={"whole": outputs["whole"]})
    assert same(scene, variants, outputs=outputs).engine == "lanes"


@pytest.mark.parametrize(("mass", "scheme"), [("consistent", "generalized_alpha"), ("averaged", "backward_euler")])
def test_masses_that_are_not_lumped(mass, scheme):
    """With driven nodes and drag: what held nodes do is felt through the masses too."""
    box = jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1))
    shaken = jf.Driven("x-", jf.Motion(amplitude=(0.0, 0.0, 0.005), frequency=5.0))
    body = jf.SoftBody(box, young=1e5, poisson=0.3, density=1e3, damping=2e-3, mass_damping=3.0, driven=[shaken])
    scene = jf.build(jf.Scene([body], gravity=(0, 0, -9.81)), mass=mass, scheme=scheme)
    variants = {"young": np.array([1e4, 1e6]), "density": np.array([1e3, 5e2]), "mass_damping": np.array([3.0, 20.0])}
    same(scene, variants, derivatives=["young", "density", "mass_damping"], outputs={"v": KEPT["v"]})
    free = jf.build(jf.Scene([jf.SoftBody(box, young=1e5, poisson=0.3, density=1e3)]), mass=mass)
    made = sweeping.Sweep(*free, {"young": [1e5]}, dt=DT, steps=1, outputs=KEPT)
    assert made.engine.name == "loop" and "that something holds" in made.reason


def test_tiny_bodies_have_derivatives_in_single_precision():
    """Squares of their forces and of derivatives in E are below what single precision holds."""
    slopes = {}
    for dtype in ("float32", "float64"):
        mesh = jf.mesh.box((1e-4, 3e-5, 3e-5), (2, 1, 1))
        body = jf.SoftBody(mesh, young=1e5, poisson=0.4, density=1e3, damping=2e-4, fixed="x-")
        scene = jf.build(jf.Scene([body], gravity=(0, 0, -1e4)), dtype=dtype)
        outputs = {"tip": lambda run: run.last.positions[-1, 2]}
        options = {"dt": 1e-4, "steps": 8, "every": 8, "outputs": outputs, "derivatives": ["young"]}
        made = jf.sweep(*scene, {"young": [1e5, 1e6]}, engine="lanes", **options)
        assert made.good.all()
        slopes[dtype] = made.derivative("tip", "young")
    np.testing.assert_allclose(slopes["float32"], slopes["float64"], rtol=2e-3)


def test_double_precision_by_corrections_in_single():
    """A spectrum that single precision cannot solve ends in double all the same; lanes that cannot be say so."""
    rng = np.random.default_rng(0)
    n, lanes = 40, 3
    basis = np.linalg.qr(rng.normal(size=(3 * n, 3 * n)))[0]
    spectra = np.stack([np.geomspace(1, top, 3 * n) for top in (1e2, 1e12, 1e2)], -1)
    b = rng.normal(size=(n, 3, lanes))
    b[..., 2] = np.nan

    def product(dtype):
        q, s = jnp.asarray(basis, dtype), jnp.asarray(spectra, dtype)
        return lambda x: (q @ (s * (q.T @ x.reshape(3 * n, -1)))).reshape(x.shape)

    target, asked, limit = 1e-10 * np.sqrt((b**2).sum((0, 1))), jnp.ones(lanes, bool), jnp.int32(3000)
    single = product(jnp.float32), lambda r: r
    found, outcome = refined(product(jnp.float64), lambda r: r, single, jnp.asarray(b), target, asked, limit)
    left = np.sqrt(((np.asarray(product(jnp.float64)(found)) - b) ** 2).sum((0, 1)))
    assert outcome.converged.tolist() == [True, bool(left[1] <= 1.1 * target[1]), False] and left[0] <= target[0]
    assert outcome.finite.tolist() == [True, True, False]
    alone, plain = solve(product(jnp.float64), lambda r: r, jnp.asarray(b), target, asked, limit)
    assert plain.converged.tolist() == outcome.converged.tolist()
    np.testing.assert_allclose(found[..., 0], alone[..., 0], atol=1e-9)
