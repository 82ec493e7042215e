"""What keeps joints together, and what heavy ones need.  python benchmarks/drift.py [--quick] [--out FOLDER]

Two scenes: the net of `joint_grid.py` (6800 spheres under up to 17 kN, from rest, 2 s) and a chain of ten rods of 1 kg
with 1000 kg at its end, let go 30 degrees aside (10 s); dt 1/60 s, float64, rows eliminated ("direct"). Four ways to
take drift back: none; a fifth of the gap a step (Baumgarte 1972, the share that game engines use); the whole gap a
step (the default); projection after each step, which moves positions and leaves velocities alone (post-stabilisation,
Cline & Pai 2003), a second solve. Each with and without geometric stiffness (Tournier et al. 2015).
`largest_gap` in m over the run; `energy`: largest change of total energy over that of one metre of fall;
`blown_up_at`: first step with a speed over 100 m/s or that is not finite, None if there is none.
"""

import math
from functools import partial

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from joint_grid import DT, anchor_gap, grid  # noqa: E402
from machine import describe, median_time  # noqa: E402
from report import arguments, finish  # noqa: E402

import jaxfem as jf  # noqa: E402
import jaxfem.system.pull as pull  # noqa: E402

SHARES = {"none": 1e-9, "baumgarte_0.2": 0.2, "whole_gap": 1.0, "projection": 1e-9}
TRACE = 1e-12  # m/N: a compliance that only carries the damping which makes a share of the gap


def chain():
    """Ten rods of 1 m and 1 kg, and 1000 kg at the end."""
    along = np.array([math.sin(math.radians(30)), 0, -math.cos(math.radians(30))])
    half = math.radians(30)  # 60 degrees about y turn x to `along`
    turn = (math.cos(half), 0, math.sin(half), 0)
    bodies, joints = [], []
    for k in range(11):
        heavy = k == 10
        shape = jf.Sphere(0.3) if heavy else jf.Box((1.0, 0.1, 0.1))
        place = (k + (0.3 if heavy else 0.5)) * along
        bodies.append(jf.RigidBody(shape, mass=1000.0 if heavy else 1.0, position=place, orientation=turn))
        joints.append(jf.BallJoint(bodies[k - 1] if k else None, bodies[k], k * along))
    return jf.build(jf.Scene(bodies, joints=joints), tolerance=1e-10)


def with_share(params, share):
    """Joints that take back this share of their gap a step: c = -g / (dt + alpha d), alpha next to nothing."""
    damping = DT * (1 / share - 1) / TRACE

    def one(values):
        compliance = jnp.full_like(values.compliance, TRACE if share < 1 else 0.0)
        return values.replace(compliance=compliance, damping=jnp.full_like(values.damping, damping))

    return params.replace(joints={name: one(values) for name, values in params.joints.items()})


def projected(model, params, state):
    """The state with its gaps taken out by the least motion in the mass norm: a step of a body at rest, weightless."""
    still = jax.tree.map(jnp.zeros_like, (state.rigid.velocities, state.rigid.angular_velocities))
    rest = state.replace(
        rigid=state.rigid.replace(velocities=still[0], angular_velocities=still[1]),
        memory=jax.tree.map(jnp.zeros_like, state.memory),
    )
    moved, info = jf.step(model, with_share(params.replace(gravity=jnp.zeros(3)), 1.0), rest, DT)
    kept = state.rigid.replace(positions=moved.rigid.positions, orientations=moved.rigid.orientations)
    return state.replace(rigid=kept), info.status


def figures_of(model, params, state):
    """Largest gap, largest speed, total energy."""
    speed = jnp.linalg.norm(state.rigid.velocities, axis=-1).max()
    energies = jf.energies(model, params, state)
    return anchor_gap(model, state), speed, energies.kinetic + energies.gravity


@partial(jax.jit, static_argnames=("steps", "project"))
def run(model, params, state, steps, project):
    """Figures of each step and the worst status."""

    def one(state, _):
        state, info = jf.step(model, params, state, DT)
        status = info.status
        if project:
            state, other = projected(model, params, state)
            status = jnp.maximum(status, other)
        return state, (*figures_of(model, params, state), status)

    return jax.lax.scan(one, state, length=steps)[1]


def measure(scene, share, project, steps):
    model, params, state = scene
    values = with_share(params, share)

    def call():
        return run(model, values, state, steps, project)

    seconds = median_time(call, 1)
    gap, speed, energy, status = (np.asarray(each) for each in call())
    wild = np.flatnonzero(~(speed < 100))
    sound = slice(0, wild[0] if len(wild) else steps)
    begin = float(figures_of(model, params, state)[2])
    fallen = params.rigid.mass.sum() * 9.81 * 1.0  # a metre of fall
    return {
        "ms_per_step": 1e3 * seconds / steps,
        "largest_gap": float(gap[sound].max()) if gap[sound].size else None,
        "energy": float(np.abs(energy[sound] - begin).max() / fallen) if gap[sound].size else None,
        "blown_up_at": int(wild[0]) if len(wild) else None,
        "failed_steps": int((status[sound] != 0).sum()),
        "steps": steps,
    }


def main():
    options = arguments(__doc__)
    side, below = (6, 4) if options.quick else (20, 16)
    figures = {"machine": describe()}
    for stiffness in (True, False):
        pull.ONSET = 1.0 if stiffness else math.inf
        jax.clear_caches()
        scenes = {"net": (grid(jnp.float64, side, below), 120), "chain": (chain(), 600)}
        for name, (scene, steps) in scenes.items():
            for way, share in SHARES.items():
                label = f"{name}_{way}{'' if stiffness else '_without_geometric_stiffness'}"
                steps = 20 if options.quick else steps
                figures[label] = measure(scene, share, way == "projection", steps)
                print(label, figures[label], flush=True)
    finish("drift", figures, options.out)


if __name__ == "__main__":
    main()
