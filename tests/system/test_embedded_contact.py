"""Contact with the vertices of a surface embedded in a soft body."""

import warnings

import derivatives
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.building.bodies import BodyIndex
from jaxfem.building.embedded import embedded
from jaxfem.building.faces import warn_between_points
from jaxfem.building.meetings import meeting_of

NOTHING = (0.0, 0.0, 0.0)
RADIUS = 0.06


def sphere(radius, count=80):
    """Points spread over a sphere by the golden angle, the lowest one its pole."""
    z = np.linspace(-1, 1, count)
    angle = np.pi * (3 - 5**0.5) * np.arange(count)
    across = np.sqrt(1 - z**2)
    return radius * np.column_stack([across * np.cos(angle), across * np.sin(angle), z])


def block(cells=2, young=2e5, **more):
    """A soft block of 0.2 m about the origin."""
    mesh = jf.mesh.box((0.2, 0.2, 0.2), cells, origin=(-0.1, -0.1, -0.1))
    return jf.SoftBody(mesh, young, 0.3, 1000.0, damping=2e-3, name="block", **more)


def test_points_stay_where_they_are_at_rest_also_outside_the_mesh():
    mesh, points = block().mesh, sphere(0.12)
    cells, weights = embedded(mesh, points, "surface")
    np.testing.assert_allclose(np.einsum("qk,qki->qi", weights, mesh.points[cells]), points, atol=1e-14)
    assert weights.min() < 0 and np.abs(points).max() > 0.1


def test_what_may_pass_between_chosen_points_is_told():
    """A pea between vertices of a coarse surface, a soft leaf between chosen nodes: they fell through in silence."""
    grid = np.stack(np.meshgrid([-0.1, 0.0, 0.1], [-0.1, 0.0, 0.1], [-0.1]), -1).reshape(-1, 3)
    pea = jf.RigidBody(jf.Sphere(0.02), mass=1.0, position=(0.05, 0.05, -0.2), name="pea")
    pot = jf.RigidBody(jf.Sphere(0.06), mass=1.0, position=(0.05, 0.05, -0.2), name="pot")
    mesh = jf.mesh.box((0.4, 0.4, 0.02), (2, 2, 1), origin=(-0.2, -0.2, -0.2))
    leaf = jf.SoftBody(mesh, 2e5, 0.3, 1000.0, name="leaf")
    body = block()

    def told(other, **chosen):
        soft = [each for each in (body, other) if isinstance(each, jf.SoftBody)]
        rigid = [each for each in (body, other) if isinstance(each, jf.RigidBody)]
        index = BodyIndex(soft, [x.name for x in soft], rigid, [x.name for x in rigid])
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            warn_between_points(meeting_of(jf.Contact(body, other, **chosen), index, "contact 0", float))
        return [str(each.message) for each in caught]

    assert (
        "vertices of its surface are up to 0.1 m apart and the other side is 0.04 m thin" in told(pea, surface=grid)[0]
    )
    assert "its nodes are up to 0.1 m apart and the other side is 0.02 m thin" in told(leaf, nodes="z-")[0]
    for silent in (
        told(pot, surface=grid),
        told(pea, surface=grid, faces=False),
        told(pea, surface=grid[:1]),
        told(pea, nodes="z-"),  # whose triangles meet it
        told(pea),
        told(jf.Plane((0, 0, -0.2)), surface=grid),
    ):
        assert not silent


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_vertices_carry_the_body_and_nodes_pass_through(dtype):
    body, plane = block(), jf.Plane((0, 0, -0.07))
    scene = jf.Scene([body], contacts=[jf.Contact(body, plane, friction=0.5, surface=sphere(RADIUS))])
    model, params, state = jf.build(scene, dtype=dtype, tolerance=1e-4 if dtype == jnp.float32 else 1e-8)
    states, info = jf.rollout(model, params, state, 1e-2, 100)
    assert not info.status.any() and states.positions.dtype == dtype
    cells, weights = embedded(body.mesh, sphere(RADIUS), "surface")
    lowest = np.einsum("qk,tqki->tqi", weights, states.positions[:, cells])[..., 2].min(1)
    assert lowest.min() > -0.07 - 1e-4 and abs(lowest[-1] + 0.07) < 1e-4
    assert float(states.positions[-1, :, 2].min()) < -0.1
    # It stands on a pole of a few vertices, held upright by none: its weight is what they carry.
    found = jf.impulses(model, states)
    push = sum(float(jnp.sum(found[f"contact {name}"][-1])) for name in model.contacts)
    assert push == pytest.approx(8.0 * 9.81 * 1e-2, rel=0.05)


@pytest.mark.slow
def test_vertices_at_nodes_are_nodes():
    body = block(velocity=(0.5, 0, -1.0))
    nodes = body.mesh.surface_nodes
    ends = []
    for chosen in ({}, {"surface": body.mesh.points[nodes]}):
        contact = jf.Contact(body, jf.Plane((0, 0, -0.105)), friction=0.3, **chosen)
        model, params, state = jf.build(jf.Scene([body], contacts=[contact]), tolerance=1e-11)
        states, info = jf.rollout(model, params, state, 5e-3, 10)
        assert not info.status.any()
        ends.append(states.positions[-1])
    np.testing.assert_allclose(*ends, atol=1e-9)


def test_an_impact_on_vertices_changes_momentum_by_its_impulse():
    body = block(velocity=(0, 0, -100.0))
    contact = jf.Contact(body, jf.Plane((0, 0, -0.5)), friction=0.0, surface=sphere(RADIUS))
    model, params, state = jf.build(jf.Scene([body], gravity=NOTHING, contacts=[contact]), tolerance=1e-10)
    states, info = jf.rollout(model, params, state, 1 / 60, 12)
    assert not info.status.any()
    (push,) = (jnp.sum(each, (1, 2)) for each in jf.impulses(model, states).values())
    momentum = jnp.sum(1000.0 * model.nodal_volumes * states.velocities[..., 2], -1)
    before = jnp.concatenate([jnp.array([-800.0]), momentum[:-1]])
    np.testing.assert_allclose(momentum - before, push, atol=1e-8 * 800)
    assert float(push.max()) > 400


@pytest.mark.slow
def test_vertices_meet_another_soft_body_and_keep_momentum():
    ball = block(young=1e5, velocity=(0, 0, -1.0))
    mesh = jf.mesh.box((0.3, 0.3, 0.1), (3, 3, 1), origin=(-0.15, -0.15, -0.2))
    slab = jf.SoftBody(mesh, 1e5, 0.3, 1000.0, name="slab")
    contact = jf.Contact(ball, slab, friction=0.4, surface=sphere(RADIUS))
    model, params, state = jf.build(jf.Scene([ball, slab], gravity=NOTHING, contacts=[contact]), tolerance=1e-10)
    states, info = jf.rollout(model, params, state, 5e-3, 40)
    assert not info.status.any()
    momentum = jnp.einsum("n,tni->ti", 1000.0 * model.nodal_volumes, states.velocities)
    np.testing.assert_allclose(momentum, jnp.broadcast_to(jnp.array([0, 0, -8.0]), momentum.shape), atol=1e-7)
    assert float(states.velocities[-1, len(ball.mesh.points) :, 2].mean()) < -0.2  # the slab has been struck


@pytest.mark.slow
def test_derivative_of_a_bounce_on_vertices():
    body = block(cells=1, young=3e4, velocity=(0.3, 0, -1.0))
    contact = jf.Contact(body, jf.Plane((0, 0, -0.065)), friction=0.1, surface=sphere(RADIUS, 12))
    model, params, state = jf.build(jf.Scene([body], contacts=[contact]), tolerance=1e-13)
    (name,) = params.contacts

    def place(young, friction):
        rough = params.contacts[name]
        contacts = {name: rough.replace(friction=friction * rough.friction)}
        values = params.replace(young=young * params.young, contacts=contacts)
        return jf.rollout(model, values, state, 5e-3, 8)[0].positions[-1].mean(0) @ jnp.array([1.0, 0.3, 1.0])

    derivatives.check(place, (1.0, 1.0), forwards=False)


@pytest.mark.parametrize(
    ("surface", "text"),
    [
        ([[0, 0, 1.0]], r'surface of contact 0, in "block": point 0 at \(0.0, 0.0, 1.0\) is 0.9 m outside'),
        (np.zeros((0, 3)), "has no point"),
        ([[0, 0, np.nan]], "finite"),
        ([0, 0, 1], r"\(q, 3\)|shape"),
    ],
)
def test_impossible_surfaces_are_refused(surface, text):
    body = block()
    with pytest.raises(jf.SceneError, match=text):
        jf.build(jf.Scene([body], contacts=[jf.Contact(body, jf.Plane(), surface=surface)]))


def test_points_are_given_once_and_for_soft_bodies():
    body, ball = block(), jf.RigidBody(jf.Sphere(0.1), mass=1.0)
    with pytest.raises(jf.SceneError, match="both nodes and surface"):
        jf.Contact(body, jf.Plane(), nodes="z-", surface=sphere(0.1))
    with pytest.raises(jf.SceneError, match="embedded in a soft body"):
        jf.build(jf.Scene([ball], contacts=[jf.Contact(ball, jf.Plane(), surface=sphere(0.1))]))
