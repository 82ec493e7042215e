"""How do sweeps compare with MuJoCo's threaded rollout, and do two cores give twice?  python benchmarks/sweep_others.py

Clamped beams of 192 tetrahedra under their weight, E over a factor of 100, let go for 0.2 s: microseconds of processor
time a variant and step, and beside each the error of the final positions, as a share of how far that variant moved,
from steps of 0.2 ms by generalised alpha in float64 on the same mesh; median and largest of the variants. MuJoCo, if it
is installed: `flexcomp` with `elasticity` of the same tetrahedra, nodes of the same masses, integrator "discrete"; its
law is another where strains are large. Two devices against one: by the clock, with the machine's load beside it.
"""

import os

# With `intra_op_parallelism_threads=1` too, the two devices would take turns.
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false --xla_force_host_platform_device_count=2"
import time

import jax
import numpy as np
from machine import describe
from report import arguments, finish, save

import jaxfem as jf
from jaxfem import sweeping

POISSON, DENSITY, DAMPING, TIME = 0.4, 1070.0, 2e-3, 0.2
CELLS, FINE = (4, 2, 2), 2e-4
MESH = jf.mesh.box((0.1, 0.03, 0.03), CELLS, tets_per_cell=12)
FIXED = np.asarray(MESH.points)[:, 0] < 1e-9


def ours(young, dt, dtype, engine, devices=1, **scheme):
    """Function that runs all variants and gives their final positions (V, n, 3)."""
    constants = {"poisson": POISSON, "density": DENSITY, "damping": DAMPING}
    body = jf.SoftBody(MESH, young=2.6e5, fixed="x-", **constants)
    scene = jf.build(jf.Scene([body], gravity=(0, 0, -9.81)), dtype=dtype, **scheme)
    steps, devices = round(TIME / dt), jax.local_devices()[:devices]
    end = {"end": lambda run: run.last.positions}
    options = {"dt": dt, "steps": steps, "every": steps, "outputs": end, "engine": engine, "devices": devices}
    made = sweeping.Sweep(*scene, {"young": young}, **options)

    def run():
        found = [made.run(chunk) for chunk in range(made.chunks)]
        assert not np.concatenate([told["status"] for _, told in found]).any()
        back = np.argsort(np.concatenate([made.members(chunk) for chunk in range(made.chunks)]))
        return np.concatenate([outputs["end"] for outputs, _ in found])[back]

    return run


def mujoco_model(mujoco, young, dt):
    points, cells = np.asarray(MESH.points), np.asarray(MESH.cells)
    mass = DENSITY * np.abs(np.linalg.det(points[cells[:, 1:]] - points[cells[:, :1]])).sum() / 6

    def words(values):
        return " ".join(f"{value:.9g}" for value in np.ravel(values))

    model = mujoco.MjModel.from_xml_string(f"""
        <mujoco><option timestep="{dt}" integrator="discrete" gravity="0 0 -9.81"/><worldbody>
        <flexcomp name="beam" type="direct" dim="3" mass="{mass}" radius="1e-4"
            point="{words(points)}" element="{words(cells)}">
        <contact selfcollide="none" contype="0" conaffinity="0"/><edge equality="false"/>
        <elasticity young="{young}" poisson="{POISSON}" damping="{DAMPING}"/>
        <pin id="{words(np.flatnonzero(FIXED))}"/></flexcomp></worldbody></mujoco>""")
    # It shares the mass evenly among the nodes; ours have that of the volume around them.
    volumes = np.abs(np.linalg.det(points[cells[:, 1:]] - points[cells[:, :1]])) / 6
    nodal = DENSITY * np.bincount(cells.ravel(), np.repeat(volumes / 4, 4))
    model.body_mass[model.flex_vertbodyid[~FIXED]] = nodal[~FIXED]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def mujoco_run(young, dt, threads):
    """The same of MuJoCo's threaded rollout."""
    import mujoco
    from mujoco import rollout

    models, steps = [mujoco_model(mujoco, each, dt) for each in young], round(TIME / dt)
    data = [mujoco.MjData(models[0]) for _ in range(threads)]
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    first = np.zeros((len(models), mujoco.mj_stateSize(models[0], kind)))
    for model, row in zip(models, first, strict=True):
        mujoco.mj_getState(model, mujoco.MjData(model), row, kind)

    def run():
        states, _ = rollout.rollout(models, data, first, nstep=steps)
        places = np.tile(np.asarray(MESH.points), (len(models), 1, 1))
        places[:, ~FIXED] += states[:, -1, 1 : 1 + models[0].nq].reshape(len(models), -1, 3)
        return places

    return run


def measured(run, repeats):
    """Best processor time, best time by the clock [s], and the result."""
    made, times = run(), []
    for _ in range(repeats):
        start, clock = time.process_time(), time.perf_counter()
        made = run()
        times.append((time.process_time() - start, time.perf_counter() - clock))
    return *np.min(times, 0), made


def main():
    options = arguments(__doc__)
    jax.config.update("jax_enable_x64", True)
    count, repeats = (32, 1) if options.quick else (64, 3)
    young = np.geomspace(2.6e4, 2.6e6, count)
    exact = ours(young, FINE, "float64", "lanes", scheme="generalized_alpha")()
    moved = np.abs(exact - np.asarray(MESH.points)).max((1, 2))
    ways = {"loop float64, 0.01 s": (ours(young, 1e-2, "float64", "loop"), 1e-2)}
    for dt in (1e-2, 2e-3):
        ways[f"lanes float32, {dt:g} s"] = ours(young, dt, "float32", "lanes"), dt
        ways[f"lanes float64, {dt:g} s"] = ours(young, dt, "float64", "lanes"), dt
        second = {"scheme": "generalized_alpha"}
        ways[f"lanes float32, generalised alpha, {dt:g} s"] = ours(young, dt, "float32", "lanes", **second), dt
        try:
            ways[f"MuJoCo, {dt:g} s"] = mujoco_run(young, dt, 1), dt
        except ImportError:
            print("MuJoCo is not installed: left out")
    figures = {"machine": describe(), "variants": count, "time": TIME, "factor_of_young": 100}
    for name, (run, dt) in ways.items():
        seconds, _, made = measured(run, repeats)
        off = np.abs(made - exact).max((1, 2)) / moved
        each = 1e6 * seconds / count / round(TIME / dt)
        figures[name] = {"us": each, "scene_steps_per_s": 1e6 / each, "error": [np.median(off), off.max()]}
        print(f"{name}: {each:.0f} us, error {np.median(off):.3f}, at most {off.max():.3f}", flush=True)
        save("sweep_others", figures, options.out)
    pairs = {"lanes": lambda cores: ours(young, 1e-2, "float32", "lanes", cores)}
    if any(name.startswith("MuJoCo") for name in ways):
        pairs["MuJoCo"] = lambda cores: mujoco_run(young, 1e-2, cores)
    for name, way in pairs.items():
        one, two = (measured(way(cores), 3 * repeats)[1] for cores in (1, 2))
        figures[f"{name}, two cores"] = {"ratio": one / two, "load": os.getloadavg()[0]}
        print(f"{name}: two cores {one / two:.2f} times one, load {os.getloadavg()[0]:.1f}", flush=True)
    finish("sweep_others", figures, options.out)


if __name__ == "__main__":
    main()
