"""rebuild: the model of other rest positions is the one that build makes of them; derivatives in them are true."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivatives import Parted

import jaxfem as jf
from jaxfem.fitting.markers import attach, marker_positions

RNG = np.random.default_rng(3)
BOX = jf.mesh.box((0.4, 0.1, 0.1), (4, 1, 1))
UNEVEN = jf.TetMesh(
    BOX.points + 0.006 * RNG.standard_normal(BOX.points.shape), BOX.cells, face_groups=dict(BOX.face_groups)
)
MOVED = 1e-5 * RNG.standard_normal(BOX.points.shape)


def declared(mesh, strain, shift=0.0):
    """A beam with a load of each kind, and a rigid body that is tied to its end; anchors move with the mesh."""
    at = {cell: mesh.points[mesh.cells[cell]].mean(0) for cell in (5, 12)}
    beam = jf.SoftBody(
        mesh,
        young=[3e5, 2e5] * (len(mesh.cells) // 2),
        poisson=0.3,
        density=900.0,
        fixed="x-",
        strain=strain,
        loads=[jf.Traction("x+", (0, 0, -30.0)), jf.Pressure("z+", 20.0), jf.PointForce(at[5], (0.0, 0.1, 0))],
        name="beam",
    )
    tip = jf.RigidBody(jf.Box((0.1, 0.1, 0.1)), mass=0.2, position=(0.5, 0, 0), orientation=(0.9, 0.1, 0.3, 0.2))
    joints = [jf.WeldJoint(beam, tip, nodes="x+"), jf.BallJoint(None, beam, at[12])]
    return jf.Scene([beam, tip], joints=joints)


@pytest.mark.parametrize("strain", ["element", "nodal_volume", "smoothed"])
def test_all_that_comes_of_the_shape_is_what_build_makes_of_it(strain):
    moved = jf.TetMesh(UNEVEN.points + MOVED, UNEVEN.cells, face_groups=dict(BOX.face_groups))
    model, _, _ = jf.build(declared(UNEVEN, strain))
    wanted, _, _ = jf.build(declared(moved, strain))
    found = jf.rebuild(model, moved.points).replace(reshaped=False, size=wanted.size)
    assert jax.tree.structure(found) == jax.tree.structure(wanted)
    paths, changed = jax.tree_util.tree_flatten_with_path(found)[0], 0
    for (path, ours), theirs, old in zip(paths, jax.tree.leaves(wanted), jax.tree.leaves(model), strict=True):
        if "['point soft-rigid'].a." in jax.tree_util.keystr(path):
            continue  # several elements share a node, and which one is named does not matter
        scale = float(np.max(np.abs(np.asarray(theirs, float)), initial=1e-300))
        assert np.allclose(ours, theirs, rtol=0, atol=1e-11 * scale), jax.tree_util.keystr(path)
        changed += not np.array_equal(np.asarray(old), np.asarray(theirs))
    assert changed > 8  # the comparison saw something


def compliance(model, params, state):
    def of(rest):
        shaped = jf.rebuild(model, rest)
        end, _ = jf.equilibrium(shaped, params, state.replace(positions=rest))
        return jnp.sum(shaped.loads[0].force(params.loads[0], rest) * (end.positions - rest))

    return of


@pytest.mark.parametrize("strain", ["element", pytest.param("smoothed", marks=pytest.mark.slow)])
def test_gradient_of_a_compliance_is_that_of_differences(strain):
    body = jf.SoftBody(
        UNEVEN, young=3e5, poisson=0.3, density=900.0, fixed="x-", strain=strain, loads=[jf.Traction("x+", (0, 0, -40))]
    )
    model, params, state = jf.build(jf.Scene([body]), tolerance=1e-13)
    of, rest = Parted(compliance(model, params, state)), model.rest
    (slope,) = of.backwards(rest)
    way = jnp.asarray(RNG.standard_normal(rest.shape))
    h = 2e-6
    difference = (of(rest + h * way) - of(rest - h * way)) / (2 * h)
    assert abs(jnp.vdot(slope, way) / difference - 1) < 1e-6
    assert jnp.abs(slope).max() > 1e-3
    assert abs(of.forwards(rest, direction=(way,)) / difference - 1) < 1e-6


@pytest.mark.slow
def test_gradient_of_a_bounce_is_that_of_differences():
    mesh = jf.TetMesh(BOX.points * 0.5 + (0, 0, 0.0502), BOX.cells)
    body = jf.SoftBody(mesh, young=5e4, poisson=0.3, density=900.0, velocity=(0, 0, -1.0))
    scene = jf.Scene([body], contacts=[jf.Contact(body, jf.Plane((0, 0, 0)), friction=0.3)])
    model, params, state = jf.build(scene, tolerance=1e-13)

    @Parted
    def after(rest):
        shaped = jf.rebuild(model, rest)
        states, _ = jf.rollout(shaped, params, state.replace(positions=rest), 2e-3, 12)
        return jnp.vdot(states.velocities[-1][:, 2], shaped.nodal_volumes)

    way = jnp.asarray(RNG.standard_normal(model.rest.shape))
    (slope,) = after.backwards(model.rest)
    h = 1e-7
    difference = (after(model.rest + h * way) - after(model.rest - h * way)) / (2 * h)
    assert abs(jnp.vdot(slope, way) / difference - 1) < 1e-6


def test_what_cannot_follow_is_refused():
    body = jf.SoftBody(BOX, young=1e5, poisson=0.3, density=1e3, fixed="x-", name="beam")
    model, params, state = jf.build(jf.Scene([body]))
    with pytest.raises(ValueError, match=r"jaxfem\.rebuild"):
        model.replace(rest=model.rest)
    with pytest.raises(jf.SceneError, match="one place in m for each node"):
        jf.rebuild(model, model.rest[:-1])
    mirrored = model.rest * jnp.array([1.0, 1.0, -1.0])
    with pytest.raises(jf.SceneError, match=r'element 0 of "beam" inside out'):
        jf.rebuild(model, mirrored)
    _, info = jax.jit(lambda rest: jf.step(jf.rebuild(model, rest), params, state, 1e-3))(mirrored)
    assert "rest positions given to rebuild" in jf.solvers.describe(info.status)
    with pytest.raises(jf.SceneError, match="does not say how it follows"):
        jf.rebuild(model.replace(loads=(object(),)), model.rest)
    with pytest.raises(jf.SceneError, match="no soft body"):
        jf.rebuild(jf.build(jf.Scene([jf.RigidBody(jf.Sphere(0.1), mass=1.0)]))[0], jnp.zeros((0, 3)))


def test_traced_places_of_a_mesh_point_to_rebuild():
    def inside(factor):
        return jf.TetMesh(BOX.points * factor, BOX.cells).volume

    with pytest.raises(jf.MeshError, match=r"jaxfem\.rebuild"):
        jax.grad(inside)(1.0)
    with pytest.raises(jf.MeshError, match=r"jaxfem\.rebuild"):
        jax.grad(lambda factor: BOX.scaled(factor).volume)(1.0)


def test_single_precision_keeps_its_type():
    body = jf.SoftBody(UNEVEN, young=1e5, poisson=0.3, density=1e3, fixed="x-")
    model, _, _ = jf.build(jf.Scene([body]), dtype=jnp.float32)
    again = jf.rebuild(model, model.rest)
    for ours, theirs in zip(jax.tree.leaves(again), jax.tree.leaves(model), strict=True):
        assert ours.dtype == theirs.dtype
        assert np.allclose(ours, theirs, rtol=2e-5, atol=2e-5 * np.abs(np.asarray(theirs, float)).max(initial=0))


def test_markers_follow_a_new_shape_and_take_places():
    """Inside, over a face, over an edge and over a corner: as `attach` puts them there, also after a strain."""
    body = jf.SoftBody(UNEVEN, young=1e5, poisson=0.3, density=1e3, fixed="x-")
    model, _, _ = jf.build(jf.Scene([body]))
    top, corner = UNEVEN.points[UNEVEN.faces("z+")[3]].mean(0), UNEVEN.points[-1]
    places = {
        "in": UNEVEN.points[UNEVEN.cells[4]].mean(0),
        "face": top + np.array([0, 0, 0.01]),
        "corner": corner + 0.01,
    }
    edge = UNEVEN.points[UNEVEN.faces("z+")[0][:2]].mean(0)
    places["edge"] = edge + np.array([0.0, 0.0, 0.004])
    markers = attach(model, places)
    strained = model.rest + 0.02 * jnp.sin(20 * model.rest[:, ::-1])
    steps = 1e-6 * RNG.standard_normal((4, 3))
    shifted = {name: place + step for (name, place), step in zip(places.items(), steps, strict=True)}
    wanted = attach(model, shifted)
    found = markers.reshaped(model.rest, jnp.array(list(shifted.values())))
    assert np.allclose(marker_positions(found, strained), marker_positions(wanted, strained), atol=1e-13)
    moved = model.rest.at[:, 2].multiply(1.01)
    ridden, at_rest = markers.reshaped(moved), np.asarray(marker_positions(markers, model.rest))
    assert np.allclose(marker_positions(ridden, moved), at_rest * [1, 1, 1.01], atol=2e-4)
    at = jnp.array(list(places.values()))

    def seen(places, rest):
        return marker_positions(markers.reshaped(rest, places), strained)[:, 2].sum()

    for number in (0, 1):
        slope = jax.grad(seen, number)(at, model.rest)
        way = jnp.asarray(RNG.standard_normal(slope.shape))
        h = 1e-7
        ends = [seen(*(x + s * h * way if i == number else x for i, x in enumerate((at, model.rest)))) for s in (1, -1)]
        assert abs(jnp.vdot(slope, way) - (ends[0] - ends[1]) / (2 * h)) < 1e-6 * abs(jnp.vdot(slope, way))
