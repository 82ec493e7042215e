"""How fast are sweeps, and how right?  python benchmarks/sweep.py [--quick] [--out FOLDER]

Clamped beams of 192, 576 and 2304 tetrahedra under their weight, E over a factor of 100 (the softest hang straight
down), 20 steps of 10 ms, 64 variants: scene-steps a second and core of each engine, in processor time of one thread, in
float32 and float64. Error: largest difference of a final position from `jf.rollout` in float64 at tolerance 1e-11, as a
share of how far that variant moved, over 8 of them. `192-free`: not clamped, they fall and spin at 5 rad/s.
`unbatched`: calls of a compiled `jf.rollout`, one after another; `mixed`: lanes in chance order, which `lanes` sorts by
what they cost.
"""

import os

os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
import time

import jax
import jax.numpy as jnp
import numpy as np
from machine import describe
from report import arguments, finish, save

import jaxfem as jf
from jaxfem import sweeping

FREE = "192-free"
SIZES = {"192": (4, 2, 2), FREE: (4, 2, 2), "576": (12, 2, 2), "2304": (12, 4, 4)}
DT, STEPS, FEW, SPIN = 1e-2, 20, 8, 5.0  # s, -, -, rad/s


def scene(size, dtype, **options):
    mesh = jf.mesh.box((0.1, 0.03, 0.03), SIZES[size], tets_per_cell=12)
    fixed = None if size == FREE else "x-"
    body = jf.SoftBody(mesh, young=2.6e5, poisson=0.4, density=1070.0, damping=2e-3, fixed=fixed)
    model, params, state = jf.build(jf.Scene([body]), dtype=dtype, **options)
    if size == FREE:
        arms = np.asarray(state.positions) - np.asarray(state.positions).mean(0)
        state = state.replace(velocities=jnp.asarray(SPIN * np.cross((0.2, 1.0, 0.3), arms), dtype))
    return model, params, state


def measured(run, repeats):
    """Seconds of processor time: the best of some runs, behind one that compiles; and what it gave."""
    made = run()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        made = run()
        times.append(time.process_time() - start)
    return min(times), made


def unbatched(parts, young):
    model, params, state = parts

    @jax.jit
    def one(value):
        states, info = jf.rollout(model, params.replace(young=value), state, DT, STEPS, every=STEPS)
        return states.positions[-1], info.status[-1]

    def run():
        made = [jax.block_until_ready(one(jnp.asarray(value, model.rest.dtype))) for value in young]
        assert not any(int(status) for _, status in made)
        return np.stack([np.asarray(positions) for positions, _ in made])

    return run


def engine(parts, young, name, order=None):
    options = {"outputs": {"end": lambda run: run.last.positions}, "engine": name, "order": order}
    made = sweeping.Sweep(*parts, {"young": young}, dt=DT, steps=STEPS, every=STEPS, **options)

    def run():
        found = [made.run(chunk) for chunk in range(made.chunks)]
        assert not np.concatenate([told["status"] for _, told in found]).any()
        back = np.argsort(np.concatenate([made.members(chunk) for chunk in range(made.chunks)]))
        return np.concatenate([outputs["end"] for outputs, _ in found])[back]

    return run


def compared(size, bits, young, exact, moved, repeats) -> dict:
    """Scene-steps a second, microseconds each, and error, of each way."""
    parts, some = scene(size, np.dtype(f"float{bits}")), young[:: len(young) // FEW]
    ways = {"unbatched": (unbatched(parts, some), len(some), slice(None))}
    ways["loop"] = engine(parts, some, "loop"), len(some), slice(None)
    ways["vmap"] = engine(parts, some, "vmap"), len(some), slice(None)
    spread = slice(None, None, len(young) // FEW)
    ways["lanes"] = engine(parts, young, "lanes"), len(young), spread
    mixed = np.random.default_rng(0).permutation(len(young))
    ways["mixed"] = engine(parts, young, "lanes", mixed), len(young), spread
    figures = {}
    for name, (run, count, shown) in ways.items():
        seconds, made = measured(run, repeats)
        error = (np.abs(made[shown] - exact).max((1, 2)) / moved).max()
        each = seconds / count / STEPS
        figures[name] = {"us_per_scene_step": 1e6 * each, "scene_steps_per_s": 1 / each, "error": float(error)}
        print(size, bits, name, f"{1e6 * each:.1f} us, error {error:.1e}", flush=True)
    figures["lanes_over_unbatched"] = figures["unbatched"]["us_per_scene_step"] / figures["lanes"]["us_per_scene_step"]
    return figures


def main():
    options = arguments(__doc__)
    jax.config.update("jax_enable_x64", True)
    sizes, count, repeats = (("192",), 32, 1) if options.quick else (tuple(SIZES), 64, 3)
    young = np.geomspace(2.6e4, 2.6e6, count)
    figures = {"machine": describe(), "variants": count, "steps": STEPS, "dt": DT, "factor_of_young": 100}
    exact = {}
    for bits in (32, 64):
        for size in sizes:
            if size not in exact:
                parts = scene(size, np.float64, tolerance=1e-11)
                ends = unbatched(parts, young[:: count // FEW])()
                exact[size] = ends, np.abs(ends - np.asarray(parts[0].rest)).max((1, 2))
            figures[f"{size} float{bits}"] = compared(size, bits, young, *exact[size], repeats)
            save("sweep", figures, options.out)
    finish("sweep", figures, options.out)


if __name__ == "__main__":
    main()
