"""A soft body that touches itself: two patches of its surface, declared."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes

import jaxfem as jf
from jaxfem.solvers import describe


def clip():
    """A U on its side, 3 x 1 x 3 cells of 0.1 m less two: a gap of 0.1 m between its arms, 0.2 m long."""
    whole = jf.mesh.box((0.3, 0.1, 0.3), (3, 1, 3))
    middle = whole.points[whole.cells].mean(1)
    kept = whole.cells[~((middle[:, 0] > 0.1) & (middle[:, 2] > 0.1) & (middle[:, 2] < 0.2))]
    used, number = np.unique(kept, return_inverse=True)
    mesh = jf.mesh.TetMesh(whole.points[used], number.reshape(-1, 4), name="clip")
    inside = mesh.points[:, 0] > 0.15
    return mesh, inside & np.isclose(mesh.points[:, 2], 0.1), inside & np.isclose(mesh.points[:, 2], 0.2)


def between(mesh, places, upper, lower):
    """Least height of the upper patch above the lower one, where one is above the other: at points all over faces.

    `places` (n, 3). Heights of two patches at the same place: those of other places say nothing, both are bent.
    """

    def faces(patch):
        return places[mesh.surface[np.isin(mesh.surface, np.flatnonzero(patch)).all(1)]]

    steps = np.arange(7) / 6
    weights = np.array([(a, b, 1 - a - b) for a in steps for b in steps if a + b < 1 + 1e-9])
    points = np.einsum("sk,tki->tsi", weights, faces(upper)).reshape(-1, 3)
    least = np.inf
    for a, b, c in faces(lower):
        own = np.linalg.solve(np.array([b - a, c - a])[:, :2].T, (points - a)[:, :2].T).T
        inside = (own > 0).all(1) & (own.sum(1) < 1)
        least = min([least, *(points[inside, 2] - a[2] - own[inside] @ np.array([b - a, c - a])[:, 2])])
    return least


@pytest.mark.slow
@pytest.mark.parametrize(("touching", "most"), [(True, 3e-3), ("faces", 5e-4), (False, None)])
def test_the_arms_of_a_clip_do_not_pass_through_each_other(touching, most):
    """They press on each other for most of the run, and come to rest so; `most`: how far faces cut through each other
    between nodes 100 mm apart, where they are bent."""
    mesh, lower, upper = clip()
    end = np.flatnonzero(np.isclose(mesh.points[:, 0], 0.3) & np.isclose(mesh.points[:, 2], 0.3))
    held, pull = np.isclose(mesh.points[:, 2], 0), jf.NodalForce(end, (0, 0, -6.0))
    body = jf.SoftBody(mesh, 2e4, 0.3, 1000.0, damping=0.05, fixed=held, loads=[pull])
    faces = True if touching == "faces" else None
    contact = jf.Contact(body, body, nodes=upper, against=lower, friction=0.2, faces=faces)
    scene = jf.Scene([body], contacts=[contact] if touching else [])
    states, info = scenes.rolled(*jf.build(scene, tolerance=1e-7), 1e-2, 160)
    assert not info.status.any()
    gaps = [between(mesh, places, upper, lower) for places in np.asarray(states.positions)[::3]]
    if touching:
        assert min(gaps) > -most
        assert abs(gaps[-1]) < 3e-3
        assert float(np.abs(states.velocities[-1]).max()) < 1e-2
    else:
        assert min(gaps) < -2e-2


@pytest.mark.slow
def test_an_arm_that_slips_off_the_other_and_comes_through_is_named():
    mesh, lower, upper = clip()
    end = np.flatnonzero(np.isclose(mesh.points[:, 0], 0.3) & np.isclose(mesh.points[:, 2], 0.3))
    held, pull = np.isclose(mesh.points[:, 2], 0), jf.NodalForce(end, (0, 0, -12.0))
    body = jf.SoftBody(mesh, 2e4, 0.3, 1000.0, damping=0.05, fixed=held, loads=[pull])
    contact = jf.Contact(body, body, nodes=upper, against=lower, friction=0.2, name="arms")
    model, params, state = jf.build(jf.Scene([body], contacts=[contact]), tolerance=1e-7)
    _, info = scenes.rolled(model, params, state, 1e-2, 60)
    said = {describe(int(code)) for code in info.status if code}
    assert said and all(each.startswith('gave way under a load: contact "arms", whose sides') for each in said)
    assert not info.status[:40].any()


def test_momentum_is_kept_while_it_touches_itself():
    mesh, lower, upper = clip()
    body = jf.SoftBody(mesh, 2e4, 0.3, 1000.0)
    scene = jf.Scene([body], gravity=(0, 0, 0), contacts=[jf.Contact(body, body, nodes=upper, against=lower)])
    model, params, state = jf.build(scene, tolerance=1e-8)
    (label,) = model.contacts
    assert label.startswith("rough patches soft-soft")
    fast = jnp.where(jnp.asarray(mesh.points[:, 2] > 0.15)[:, None], jnp.array([0.0, 0, -20.0]), 0.0)
    states, info = jf.rollout(model, params, state.replace(velocities=fast), 5e-3, 10)
    assert not info.status.any()
    assert float(jf.impulses(model, states)[f"contact {label}"].max()) > 0
    momentum = jnp.einsum("n,tni->ti", 1000.0 * model.nodal_volumes, states.velocities)
    start = 1000.0 * model.nodal_volumes @ fast
    np.testing.assert_allclose(momentum, jnp.broadcast_to(start, momentum.shape), atol=1e-7)


@pytest.mark.slow
def test_the_derivative_of_a_strike_is_that_of_differences():
    """In the speed; nodes straight above each other, as the mesh has them: none of it hangs on which is nearest."""
    mesh, lower, upper = clip()
    body = jf.SoftBody(mesh, 2e4, 0.3, 1000.0)
    scene = jf.Scene([body], gravity=(0, 0, 0), contacts=[jf.Contact(body, body, nodes=upper, against=lower)])
    model, params, state = jf.build(scene, tolerance=1e-12)
    down = jnp.where(jnp.asarray(mesh.points[:, 2] > 0.15)[:, None], jnp.array([0.0, 0, -1]), 0.0)
    weights = jnp.asarray(np.random.default_rng(5).standard_normal(mesh.points.shape))

    def end(speed):
        states, info = jf.rollout(model, params, state.replace(velocities=speed * down), 5e-3, 6)
        return jnp.sum(states.positions[-1] * weights), info

    run, step = jax.jit(lambda speed: jax.jvp(end, (speed,), (1.0,), has_aux=True)), 1e-4
    (ahead, _, info), (behind, _, _) = run(20 + step), run(20 - step)
    assert not info.status.any() and not info.weakly_active.any()
    _, slope, _ = run(20.0)
    assert float(slope) == pytest.approx(float(ahead - behind) / (2 * step), rel=1e-7)


@pytest.mark.parametrize(
    ("more", "text"),
    [
        ({}, "two patches of its surface"),
        ({"nodes": "z+"}, "two patches of its surface"),
        ({"nodes": "z+", "against": "x+"}, "share nodes"),
        ({"nodes": [0], "against": "x+"}, "no whole triangle"),
    ],
)
def test_patches_that_are_none_are_refused(more, text):
    body = jf.SoftBody(jf.mesh.box((1, 1, 1), 1), 1e5, 0.3, 1e3)
    with pytest.raises(jf.SceneError, match=text):
        jf.build(jf.Scene([body], contacts=[jf.Contact(body, body, **more)]))
    other = jf.SoftBody(jf.mesh.box((1, 1, 1), 1, origin=(0, 0, 2)), 1e5, 0.3, 1e3)
    with pytest.raises(jf.SceneError, match="for a body that touches itself"):
        jf.build(jf.Scene([body, other], contacts=[jf.Contact(body, other, nodes="z+", against="x+")]))


@pytest.mark.parametrize(("cells", "faces", "warns"), [(1, None, True), (1, False, False), (3, None, False)])
def test_patches_that_are_narrow_for_their_nodes_are_told(cells, faces, warns):
    mesh = jf.mesh.box((0.3, 0.1, 0.1), (3 * cells, cells, cells))
    body = jf.SoftBody(mesh, 2e4, 0.3, 1000.0)
    contact = jf.Contact(body, body, nodes="z+", against="z-", faces=faces)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        jf.build(jf.Scene([body], contacts=[contact]))
    told = [each for each in caught if "nodes of one patch are up to 0.141 m apart" in str(each.message)]
    assert bool(told) == warns
    assert all(each.filename == __file__ for each in told)
