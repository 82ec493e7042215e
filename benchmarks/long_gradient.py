"""What memory does a gradient through 1000 steps take?  python benchmarks/long_gradient.py [--quick] [--out FOLDER]

A clamped beam of 2000 elements swings; the derivative of its tip's height by Young's modulus, in reverse through
`rollout` with checkpoints, without them, and forwards: each in a process of its own, of which the largest resident
memory is told (interpreter and compiler among it). --quick: 100 steps of 250 elements.
"""

import argparse
import json
import pathlib
import resource
import subprocess
import sys
import time

WAYS = ("checkpoints", "none", "forwards")
SIZES = {False: ((20, 5, 4), 1000, 40), True: ((10, 5, 1), 100, 10)}
DT = 1e-3


def one(way, quick):
    """Value, derivative, seconds of processor time and the largest resident memory [MB] of one way."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax.numpy as jnp
    import numpy as np

    import jaxfem as jf

    cells, steps, checkpoint = SIZES[quick]
    mesh = jf.mesh.box((0.1, 0.03, 0.03), cells, tets_per_cell=5)
    body = jf.SoftBody(mesh, 2e5, 0.4, 1070.0, damping=3e-3, fixed="x-")
    model, params, state = jf.build(jf.Scene([body]), tolerance=1e-12)
    tip = jnp.asarray(np.flatnonzero(mesh.points[:, 0] > 0.1 - 1e-9))
    kept = {"checkpoint": checkpoint} if way == "checkpoints" else {}

    def height(young):
        states, info = jf.rollout(model, params.replace(young=young), state, DT, steps, every=checkpoint, **kept)
        return jnp.mean(states.positions[-1, tip, 2]), info.status.max()

    young, begun = jnp.asarray(2e5), time.process_time()
    if way == "forwards":
        (value, status), (slope, _) = jax.jit(lambda y: jax.jvp(height, (y,), (jnp.ones_like(y),)))(young)
    else:
        (value, status), slope = jax.jit(jax.value_and_grad(height, has_aux=True))(young)
    found = {"value": float(value), "derivative": float(slope), "status": int(status)}
    found["processor_s"] = time.process_time() - begun
    found["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"elements": int(model.elements.count), "steps": steps, **found}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="100 steps of 250 elements")
    parser.add_argument("--out", type=pathlib.Path, help="folder for long_gradient.json")
    parser.add_argument("--way", choices=WAYS, help="one alone, its figures as JSON")
    chosen = parser.parse_args()
    if chosen.way:
        print(json.dumps(one(chosen.way, chosen.quick)))
        return
    from machine import describe
    from report import finish, save

    figures = {"machine": describe()}
    for way in WAYS:
        words = [sys.executable, __file__, "--way", way, *(["--quick"] if chosen.quick else [])]
        ran = subprocess.run(words, capture_output=True, text=True, check=False)
        figures[way] = json.loads(ran.stdout) if ran.returncode == 0 else {"failed": ran.stderr[-300:]}
        print(way, figures[way], flush=True)
        save("long_gradient", figures, chosen.out)
    told = [figures[way]["derivative"] for way in WAYS if "derivative" in figures[way]]
    figures["largest_relative_difference"] = max(told) / min(told) - 1 if min(told) > 0 else max(told) - min(told)
    finish("long_gradient", figures, chosen.out)


if __name__ == "__main__":
    main()
