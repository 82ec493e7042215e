"""What does a first call cost?  python benchmarks/compile.py [--quick] [--out FOLDER]

The standard programs, each in a process of its own on one core and without compiled programs kept from before: fusions
(each a kernel) of the program that XLA makes for the CPU, seconds to trace and to compile it, by the wall and by the
processor. The last count on a machine that does other work.
"""

import json
import os
import re
import subprocess
import sys
import time

import jax
from machine import describe
from report import arguments, finish

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_enable_compilation_cache", False)

import jax.numpy as jnp  # noqa: E402
from scenes import beam  # noqa: E402

import jaxfem as jf  # noqa: E402

DT, STEPS = 1e-2, 10
HEADER = re.compile(r"(?:ENTRY )?%?([\w.\-]+) .*\{$")
INSTRUCTION = re.compile(r" = (?:\(.*?\)|\S+) ([a-z][\w\-]*)\(")
INNER = re.compile(r"(?:calls|to_apply)=%?([\w.\-]+)")
SILENT = ("parameter", "constant", "get-tuple-element", "tuple", "bitcast")
"""Instructions that run nothing."""


def soft():
    """A hanging beam of elements; its condensed matrix, and conjugate gradients."""
    return beam((20, 3, 3), jnp.float64, 1e-6)


def sliding():
    """A rigid box on the ground, with friction: eight candidate pairs."""
    body = jf.RigidBody(jf.Box((0.2, 0.2, 0.2)), mass=1.0, position=(0, 0, 0.1), velocity=(1.0, 0, 0))
    return jf.build(jf.Scene([body], contacts=[jf.Contact(body, jf.Plane(), friction=0.3)]), tolerance=1e-10)


def tip(model, params, state):
    states, _ = jf.rollout(model, params, state, DT, STEPS)
    return jnp.sum((states.positions[-1] - model.rest) ** 2)


def slide(model, params, state):
    return jf.step(model, params, state, DT)[0].rigid.velocities[0, 0]


PROGRAMS = {
    "soft_step": (soft, lambda *scene: jf.step(*scene, DT)),
    "soft_rollout": (soft, lambda *scene: jf.rollout(*scene, DT, STEPS)),
    "soft_rollout_gradient": (soft, jax.value_and_grad(tip, argnums=1)),
    "sliding_step": (sliding, lambda *scene: jf.step(*scene, DT)),
    "sliding_step_gradient": (sliding, jax.value_and_grad(slide, argnums=1, allow_int=True)),
}
QUICK = ("soft_step", "sliding_step")


def counts(text):
    """Fusions of a compiled program, each a kernel, and all instructions that run something, inside of loops too."""
    found, inner, here = {}, set(), ""
    for line in text.splitlines():
        header = None if line.startswith(" ") else HEADER.match(line)
        if header:
            here = header.group(1)
        instruction = INSTRUCTION.search(line)
        if instruction and line.startswith(" "):
            found.setdefault(here, []).append(instruction.group(1))
            inner.update(INNER.findall(line) if instruction.group(1) != "call" else ())
    run = [name for where, names in found.items() if where not in inner for name in names if name not in SILENT]
    return run.count("fusion"), len(run)


def measure(name):
    make, call = PROGRAMS[name]
    scene = make()
    jax.block_until_ready(scene[2].positions)
    begun, spent = time.perf_counter(), time.process_time()
    lowered = jax.jit(call).lower(*scene)
    traced = time.process_time() - spent
    compiled = lowered.compile()
    wall, processor = time.perf_counter() - begun, time.process_time() - spent
    fusions, instructions = counts(compiled.as_text())
    return {
        "fusions": fusions,
        "instructions": instructions,
        "trace_cpu_s": traced,
        "compile_cpu_s": processor - traced,
        "cpu_s": processor,
        "wall_s": wall,
    }


def apart(name):
    """`measure` in a new process on one core."""
    prefix = ["taskset", "-c", "0"] if hasattr(os, "sched_setaffinity") else []
    done = subprocess.run([*prefix, sys.executable, __file__, "--only", name], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{name} failed:\n{done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


def main():
    if "--only" in sys.argv:
        print(json.dumps(measure(sys.argv[sys.argv.index("--only") + 1])))
        return
    options = arguments(__doc__)
    figures = {"machine": describe()}
    for name in QUICK if options.quick else PROGRAMS:
        figures[name] = apart(name)
        print(name, {key: round(value, 2) for key, value in figures[name].items()})
    finish("compile", figures, options.out)


if __name__ == "__main__":
    main()
