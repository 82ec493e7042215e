"""Ten soft cubes on top of each other for ten seconds.  python benchmarks/stack.py [--quick] [--out FOLDER]

Cubes of 0.1 m, 2x2x2 cells of 5 tetrahedra, E 1e7 Pa, nu 0.3, 1000 kg/m^3, friction 0.5, dt 1/60 s, tolerance 1e-6
(float32: 1e-4). A column of them buckles under its own weight below E = 1.5 MPa (Greenhill 1881). `turned`: each cube
turned 10 degrees and 2 mm aside, one this way, the next that way. `straight`: 2 mm aside only; `aligned`: node on node.
There each contact is there twice, the hardest case for friction.
`failed_steps` counts those; `shortening` over rho g L^2 / 2 E; `lean`: how far a cube's centre moves aside from the
tenth step on. Run it with one core (taskset -c 0) to compare with other engines.
"""

import itertools
import time

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from machine import describe, first_time  # noqa: E402
from report import arguments, finish  # noqa: E402

import jaxfem as jf  # noqa: E402

DT, SIDE, YOUNG, DENSITY, CUBES = 1 / 60, 0.1, 1e7, 1000.0, 10
TOLERANCES = {"float64": 1e-6, "float32": 1e-4}


def stack(degrees, aside, precision):
    cubes = []
    for k in range(CUBES):
        a = np.radians(degrees) * (-1) ** k
        turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
        mesh = jf.mesh.box((SIDE,) * 3, 2, tets_per_cell=5, origin=(-SIDE / 2, -SIDE / 2, 0)).rotated(turn)
        place = (aside * (-1) ** k, 0, SIDE * k)
        cubes.append(jf.SoftBody(mesh.translated(place), YOUNG, 0.3, DENSITY, damping=5e-3))
    contacts = [jf.Contact(cubes[0], jf.Plane()), *(jf.Contact(b, a) for a, b in itertools.pairwise(cubes))]
    scene = jf.Scene(cubes, contacts=contacts)
    return jf.build(scene, dtype=getattr(jnp, precision), tolerance=TOLERANCES[precision])


def measure(degrees, aside, precision, steps):
    model, params, state = stack(degrees, aside, precision)

    def run():
        return jf.rollout(model, params, state, DT, steps)

    compile_s = first_time(run)
    begin = time.perf_counter()
    states, info = jax.block_until_ready(run())
    seconds = time.perf_counter() - begin
    centres = states.positions.reshape(steps, CUBES, -1, 3).mean(2)
    length = CUBES * SIDE
    return {
        "ms_per_step": 1e3 * seconds / steps,
        "iterations": float(jnp.median(info.iterations)),
        "most_iterations": int(info.iterations.max()),
        "failed_steps": int(jnp.sum(info.status != 0)),
        "steps": steps,
        "speed_at_end": float(jnp.abs(states.velocities[-1]).max()),
        "lean": float(jnp.abs(centres[-1, :, :2] - centres[9, :, :2]).max()),
        "shortening": (length - float(states.positions[-1, :, 2].max())) / (DENSITY * 9.81 * length**2 / (2 * YOUNG)),
        "inverted": int(info.inverted.max()),
        "solver": model.method.name,
        "first_call_s": compile_s,
    }


def main():
    options = arguments(__doc__)
    steps = 20 if options.quick else 600
    figures = {"machine": describe()}
    figures |= {f"turned_{each}": measure(10, 0.002, each, steps) for each in TOLERANCES}
    figures["straight_float64"] = measure(0, 0.002, "float64", steps)
    figures["aligned_float64"] = measure(0, 0.0, "float64", steps)
    finish("stack", figures, options.out)


if __name__ == "__main__":
    main()
