"""A doll of 15 rigid bodies and 4 soft limbs falls over.  python benchmarks/ragdoll.py [--quick] [--out FOLDER]

Float32 at relative residual 1e-4, dt 1/100 s, by the solver that build chooses and by the condensed route. Run it with
one core (taskset -c 0) to compare with others.
"""

import jax
from machine import describe, first_time, median_time
from report import arguments, finish

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402

import jaxfem as jf  # noqa: E402


def doll():
    box, ball = jf.Box, jf.Sphere
    bodies, joints = {}, []

    def add(name, shape, place):
        bodies[name] = jf.RigidBody(shape, density=1000.0, position=place, name=name)

    def hinge(a, b, place, axis, low, high):
        joints.append(jf.HingeJoint(bodies[a], bodies[b], place, axis, low=low, high=high))

    add("pelvis", box((0.2, 0.12, 0.1)), (0, 0, 1.0))
    add("chest", box((0.24, 0.14, 0.3)), (0, 0, 1.25))
    add("head", ball(0.09), (0, 0, 1.52))
    hinge("pelvis", "chest", (0, 0, 1.08), (1, 0, 0), -0.5, 0.5)
    hinge("chest", "head", (0, 0, 1.42), (1, 0, 0), -0.5, 0.5)
    soft = []
    for side, x in (("left", -1.0), ("right", 1.0)):
        add(f"{side} arm", box((0.24, 0.06, 0.06)), (x * 0.27, 0, 1.35))
        add(f"{side} forearm", box((0.24, 0.05, 0.05)), (x * 0.53, 0, 1.35))
        add(f"{side} wrist", box((0.06, 0.05, 0.05)), (x * 0.70, 0, 1.35))
        hinge("chest", f"{side} arm", (x * 0.13, 0, 1.35), (0, 1, 0), -1.2, 1.2)
        hinge(f"{side} arm", f"{side} forearm", (x * 0.40, 0, 1.35), (0, 0, 1), -1.5, 1.5)
        hinge(f"{side} forearm", f"{side} wrist", (x * 0.66, 0, 1.35), (0, 1, 0), -0.7, 0.7)
        add(f"{side} thigh", box((0.08, 0.08, 0.4)), (x * 0.07, 0, 0.73))
        add(f"{side} shin", box((0.06, 0.06, 0.4)), (x * 0.07, 0, 0.31))
        add(f"{side} ankle", box((0.06, 0.08, 0.06)), (x * 0.07, 0, 0.07))
        hinge("pelvis", f"{side} thigh", (x * 0.07, 0, 0.94), (1, 0, 0), -1.2, 1.2)
        hinge(f"{side} thigh", f"{side} shin", (x * 0.07, 0, 0.52), (1, 0, 0), -2.0, 0.1)
        hinge(f"{side} shin", f"{side} ankle", (x * 0.07, 0, 0.1), (1, 0, 0), -0.5, 0.5)
        ends = {
            f"{side} hand": ((0.1, 0.05, 0.05), (x * 0.78 - 0.05, -0.025, 1.325), "x-" if x > 0 else "x+", "wrist"),
            f"{side} foot": ((0.06, 0.12, 0.04), (x * 0.07 - 0.03, -0.04, 0.0), "z+", "ankle"),
        }
        for name, (size, corner, face, bone) in ends.items():
            mesh = jf.mesh.box(size, 1, tets_per_cell=5, origin=corner, name=name)
            flesh = jf.SoftBody(mesh, young=2e5, poisson=0.3, density=800.0, damping=0.01)
            joints.append(jf.WeldJoint(flesh, bodies[f"{side} {bone}"], nodes=face))
            soft.append(flesh)
    ground = jf.Plane((0, 0, -0.01))
    contacts = [jf.Contact(body, ground, friction=0.6) for body in [*soft, *bodies.values()]]
    return jf.Scene([*soft, *bodies.values()], joints=joints, contacts=contacts)


def measure(solver, steps):
    model, params, state = jf.build(doll(), dtype=jnp.float32, tolerance=1e-4, solver=solver, max_iterations=5000)
    push = state.rigid.velocities.at[1, 1].set(1.5)
    state = state.replace(rigid=state.rigid.replace(velocities=push))

    def run():
        return jf.rollout(model, params, state, 1e-2, steps)

    compile_s = first_time(run)
    seconds = median_time(run, 1)
    states, info = run()
    return {
        "ms_per_step": 1e3 * seconds / steps,
        "iterations": float(jnp.median(info.iterations)),
        "most_iterations": int(info.iterations.max()),
        "status": int(info.status.max()),
        "head_height": float(states.rigid.positions[-1, 2, 2]),
        "lowest_node": float(states.positions[..., 2].min()),
        "steps": steps,
        "solver": model.method.name,
        "first_call_s": compile_s,
    }


def main():
    options = arguments(__doc__)
    steps = 20 if options.quick else 120
    figures = {solver: measure(solver, steps) for solver in ("auto", "condensed")}
    figures["machine"] = describe()
    finish("ragdoll", figures, options.out)


if __name__ == "__main__":
    main()
