"""Where does a step's time go?  python benchmarks/stages.py [--quick] [--out FOLDER]

Each stage compiled alone and run a hundred times in one loop, microseconds a call, float32: the brick and a swinging
cube of 5000 elements; beside them the whole step as a rollout runs it, at 1e-4.
"""

import jax
import jax.numpy as jnp
import scenes
from machine import describe, median_time
from report import arguments, finish

import jaxfem as jf
from jaxfem.elements.domains import domain_gradient
from jaxfem.elements.tetra import rotation_of
from jaxfem.methods.nodes.condensed import coarse_of, condensed_matrix, group_modes
from jaxfem.methods.nodes.preconditioner import two_level
from jaxfem.system.soft import momentum_gradient, step_system
from jaxfem.tensors import array_of

DT, LOOPS = 1 / 60, 100


def looped(stage):
    """A stage that maps a field to anything, repeated with a little of its result fed back, so none is left out."""

    @jax.jit
    def run(arrays, field):
        def again(_, x):
            made = jax.tree.leaves(stage(arrays, x))
            return x + 1e-30 * sum(jnp.sum(leaf[..., :1]) for leaf in made)

        return jax.lax.fori_loop(0, LOOPS, again, field)

    return run


def stages(model, params, state):
    system = step_system(model, params, state, jnp.asarray(DT, model.rest.dtype))
    coarse = coarse_of(system)
    matrix, modes = condensed_matrix(system), group_modes(system)
    padded = model.pattern.gathered(state.velocities)

    def rotation(m, x):
        return array_of(rotation_of(domain_gradient(m.domains[0], x), "polar"))

    def rows(m, x):
        return step_system(m, params, state.replace(positions=x), jnp.asarray(DT, x.dtype)).elastic[0].bias

    def turned(s, x):
        first = s.elastic[0].replace(rotation=s.elastic[0].rotation + 1e-30 * x[0, 0])
        return s.replace(elastic=(first, *s.elastic[1:]))

    def assembly(s, x):
        return condensed_matrix(turned(s, x)).blocks

    return {
        "rotation": (rotation, model, state.positions),
        "rotation_and_strain": (rows, model, state.positions),
        "residual": (lambda s, x: momentum_gradient(s, x), system, state.velocities),
        "assembly": (assembly, system, state.velocities),
        "coarse_matrix_and_inverse": (lambda s, x: coarse_of(turned(s, x)), system, padded),
        "product": (lambda a, x: a.apply(x), matrix, padded),
        "preconditioner": (lambda a, x: two_level(*a)(x), (matrix, modes, coarse), padded),
    }


def measure(parts, repeats):
    model, params, state = parts
    found = {}
    for name, (stage, arrays, field) in stages(*parts).items():
        run = looped(stage)
        found[name] = 1e6 * median_time(lambda run=run, a=arrays, f=field: run(a, f), repeats) / LOOPS
    steps = 20
    seconds = median_time(lambda: jf.rollout(model, params, state, DT, steps), repeats)
    _, info = jf.rollout(model, params, state, DT, steps)
    found["whole_step"] = 1e6 * seconds / steps
    found["iterations"] = float(jnp.mean(info.iterations))
    found["elements"] = model.elements.count
    return found


def main():
    options = arguments(__doc__)
    repeats = 1 if options.quick else 5
    figures = {"machine": describe(), "unit": "microseconds"}
    figures["brick"] = measure(scenes.brick(jnp.float32), repeats)
    figures["cube"] = measure(scenes.cube(10, jnp.float32, 1e-4), repeats)
    for name in ("brick", "cube"):
        print(name, "  ".join(f"{stage} {value:.4g}" for stage, value in figures[name].items()), flush=True)
    finish("stages", figures, options.out)


if __name__ == "__main__":
    main()
