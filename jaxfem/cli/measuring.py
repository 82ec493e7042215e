"""What `jaxfem bench` measures: standard scenes, stepped at several tolerances, time beside error."""

import dataclasses
import platform
import statistics
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxfem as jf
from jaxfem.stepping import rollout

Parts = tuple[jf.Model, jf.Params, jf.State]

EXACT = 1e-11
TOLERANCES = {"float32": (1e-2, 1e-3, 1e-4, 1e-5), "float64": (1e-2, 1e-4, 1e-6, 1e-8)}
USUAL = 1e-4  # tolerance at which compile time, memory and the gradient are measured


@dataclasses.dataclass(frozen=True)
class Standard:
    """A standard scene: box of `size` [m] in `cells`, material, time step [s] and number of steps."""

    name: str
    size: tuple[float, float, float]
    cells: tuple[int, int, int]
    tets_per_cell: int
    young: float
    poisson: float
    density: float
    damping: float
    dt: float
    steps: int
    fixed: str = "x-"
    mirrored: bool = True

    def build(self, dtype: Any, solver: str, tolerance: float) -> Parts:
        """(model, params, state), from rest under gravity."""
        mesh = jf.mesh.box(self.size, self.cells, self.tets_per_cell, mirrored=self.mirrored)
        body = jf.SoftBody(
            mesh,
            young=self.young,
            poisson=self.poisson,
            density=self.density,
            damping=self.damping,
            fixed=self.fixed,
        )
        return jf.build(jf.Scene([body]), dtype=dtype, solver=solver, tolerance=tolerance)


STANDARD = (
    Standard("soft beam", (0.1, 0.03, 0.03), (20, 3, 3), 6, 2.6e5, 0.4, 1070.0, 2e-3, 1e-2, 50),
    Standard("stiff brick", (9.6, 0.2, 0.1), (96, 2, 1), 12, 1e9, 0.35, 2200.0, 0.0, 1 / 60, 60, mirrored=False),
    Standard("hanging cube", (1.0, 1.0, 1.0), (10, 10, 10), 5, 1e5, 0.3, 1000.0, 0.0, 1 / 60, 30, "z+"),
)
QUICK = (Standard("soft beam", (0.1, 0.03, 0.03), (4, 2, 2), 6, 2.6e5, 0.4, 1070.0, 2e-3, 1e-2, 5),)


@dataclasses.dataclass(frozen=True)
class Row:
    """One measurement; seconds, megabytes, and the largest error of a node's place relative to the motion."""

    scene: str
    elements: int
    precision: str
    tolerance: float
    iterations: float
    ms_per_step: float
    steps_per_second: float
    error: float
    status: int
    compile_s: float | None = None
    memory_mb: float | None = None
    gradient_ratio: float | None = None


def machine() -> str:
    """The machine in words."""
    name, info = platform.processor() or platform.machine(), Path("/proc/cpuinfo")
    if info.exists():
        lines = info.read_text(encoding="utf-8").splitlines()
        names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
        name = f"{names[0]}, {len(names)} cores" if names else name
    return f"{name}; Python {platform.python_version()}, JAX {jax.__version__} on {jax.default_backend()}"


def measure(scene: Standard, repeats: int, done: Callable[[str], None]) -> list[Row]:
    """All rows of a scene; `done` is called with a note after each of `count_rows`."""
    model, params, state = scene.build(jnp.float64, "auto", EXACT)
    exact, _ = rollout(model, params, state, scene.dt, scene.steps, every=scene.steps)
    done(f"{scene.name}: reference")
    rows = []
    for precision, tolerances in TOLERANCES.items():
        parts = scene.build(jnp.dtype(precision), "auto", USUAL)
        costs = _costs(scene, parts, repeats)
        done(f"{scene.name}, {precision}: compile and gradient")
        for tolerance in tolerances:
            row = _timed(scene, parts, precision, tolerance, exact.positions[-1], repeats)
            rows.append(dataclasses.replace(row, **costs) if tolerance == USUAL else row)
            done(f"{scene.name}, {precision}, {tolerance:g}")
    return rows


def count_rows(scenes: tuple[Standard, ...]) -> int:
    """How often `measure` calls back, over all scenes."""
    return len(scenes) * (1 + sum(1 + len(values) for values in TOLERANCES.values()))


def _timed(scene: Standard, parts: Parts, precision: str, tolerance: float, exact: Any, repeats: int) -> Row:
    model, params, state = parts
    model = model.replace(tolerance=jnp.asarray(tolerance, model.rest.dtype))

    def run() -> Any:
        return rollout(model, params, state, scene.dt, scene.steps, every=scene.steps)

    states, info = run()
    each = _median(run, repeats) / scene.steps
    start, end = np.asarray(model.rest, np.float64), np.asarray(states.positions[-1], np.float64)
    motion = np.linalg.norm(np.asarray(exact) - start, axis=1).max()
    error = np.linalg.norm(end - np.asarray(exact), axis=1).max() / motion
    _, steps = rollout(model, params, state, scene.dt, scene.steps)
    return Row(
        scene.name,
        model.elements.count,
        precision,
        tolerance,
        float(np.mean(np.asarray(steps.iterations))),
        1e3 * each,
        1 / each,
        float(error),
        int(info.status.max()),
    )


def _costs(scene: Standard, parts: Parts, repeats: int) -> dict[str, Any]:
    """Seconds to compile a rollout, megabytes it needs beside its arguments, and its gradient's cost in runs."""
    model, params, state = parts

    def run(young: Any) -> Any:
        states, _ = rollout(model, params.replace(young=young), state, scene.dt, scene.steps, every=scene.steps)
        return jnp.sum((states.positions - model.rest) ** 2)

    begun = time.perf_counter()
    forward = jax.jit(run).lower(params.young).compile()
    compile_s = time.perf_counter() - begun
    gradient = jax.jit(jax.value_and_grad(run)).lower(params.young).compile()
    memory = forward.memory_analysis()
    size = getattr(memory, "temp_size_in_bytes", float("nan")) / 1e6
    times = [_median(partial(call, params.young), repeats) for call in (forward, gradient)]
    return {"compile_s": compile_s, "memory_mb": size, "gradient_ratio": times[1] / times[0]}


def _median(call: Callable[[], Any], repeats: int) -> float:
    jax.block_until_ready(call())
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        jax.block_until_ready(call())
        times.append(time.perf_counter() - begun)
    return statistics.median(times)
