"""How long until the best fit?  python benchmarks/fit_searches.py [--quick] [--out FOLDER]

The beam of `coverage.py`, one recording with white noise; E, nu and damping from values 1.5 times and 30 times off. The
same compiled simulation, the same unknowns (logarithms, and nu on its logistic curve) and bounds for all: the search of
`jaxfem.fit`, SciPy's `least_squares` ("trf", forward-mode Jacobians), L-BFGS-B (SciPy) and Adam (optax, rate .05) on
the mean square with reverse-mode gradients. Told are the seconds and evaluations until the loss is first within .1 % of
the lowest that any found, without compiling; None: not within 60 gradients of L-BFGS-B or 400 of Adam. Where other
programs run, processor seconds tell more than those of the clock: `load` is that of the machine.
"""

import os
import time

import jax
import jax.numpy as jnp
import numpy as np
from coverage import DT, STILL, TRUE, Beam, drawn
from machine import describe
from report import arguments, finish, save

jax.config.update("jax_enable_x64", True)

import jaxfem as jf  # noqa: E402
from jaxfem.fitting import Noise, Search, Take  # noqa: E402
from jaxfem.fitting.evaluation import Evaluator  # noqa: E402
from jaxfem.fitting.objective import difference, keeping, scene_at  # noqa: E402
from jaxfem.fitting.recovery import assembled  # noqa: E402
from jaxfem.fitting.search import find  # noqa: E402

STARTS = {
    "1.5_off": {"young": 3.9e5, "poisson": 0.25, "damping": 6e-3},
    "30_off_stiff": {"young": 30 * 2.6e5, "poisson": 0.1, "damping": 4e-2},
    "30_off_soft": {"young": 2.6e5 / 30, "poisson": 0.45, "damping": 4e-4},
}
BOUNDS = {"young": (2.6e3, 2.6e7), "poisson": (0.0, 0.49), "damping": (4e-5, 0.4)}
WITHIN = 1.001
MOST = {"lbfgs": 60, "adam": 400}


class Clock:
    """Seconds and evaluations of one search, with the loss after each."""

    def __init__(self):
        self.begun, self.used, self.seen = time.perf_counter(), time.process_time(), []

    def note(self, loss):
        self.seen.append((loss, time.perf_counter() - self.begun, time.process_time() - self.used))

    def until(self, lowest):
        for number, (loss, wall, processor) in enumerate(self.seen, 1):
            if loss <= WITHIN * lowest:
                return {"s": wall, "processor_s": processor, "evaluations": number}
        return None


class Fits:
    """One recording, and the searches for its values."""

    def __init__(self):
        self.beam = Beam()
        noise = self.beam.sigma * drawn(0.0, self.beam.clean.shape, 0)
        places = self.beam.clean + noise
        self.recording = jf.Recording(DT * np.arange(len(places)), places, self.beam.markers.names)
        self.piece = self.evaluator(STARTS["1.5_off"])[0].pieces[0]
        self.gradient = jax.jit(jax.value_and_grad(self.loss))

    def evaluator(self, start, progress=None):
        beam = self.beam
        take = Take(
            beam.model, beam.params.replace(**start), beam.state, self.recording, beam.markers, DT, release=STILL * DT
        )
        made, _, shared = assembled([take], tuple(TRUE), ("delay",), None, BOUNDS, Noise(), None, "warn")
        found = Evaluator(made.pieces, made.unknowns, progress)
        return found, shared.starts[0]

    def loss(self, z):
        """By a rollout of all rows, which has a derivative backwards; a fit's own simulation has none."""
        problem, plan = self.piece.problem, self.piece.plan
        params, state = scene_at(z, problem, plan)
        states, info = jf.rollout(problem.model, params, state, problem.dt, plan.frames * plan.every, every=plan.every)
        keep = keeping(problem, plan)
        frames = jnp.concatenate([keep(state)[None], jax.vmap(keep)(states)])
        r, _ = difference(z, frames, jnp.max(info.status), problem, plan)
        return jnp.sum(r * r) / np.count_nonzero(problem.weights)

    def ours(self, start):
        clock = Clock()
        evaluator, z = self.evaluator(start, lambda stage, number, loss, values: clock.note(loss))
        find(evaluator, [z], Search())
        return clock

    def least_squares(self, start):
        from scipy.optimize import least_squares

        evaluator, z = self.evaluator(start)
        clock = Clock()

        def value(z):
            r = evaluator.residual(z)[0]
            clock.note(evaluator.loss(r))
            return np.nan_to_num(np.concatenate([each.ravel() for each in r]), posinf=1e3)

        def jacobian(z):
            r, columns, _ = evaluator.linear(z)
            clock.note(evaluator.loss(r))
            return np.nan_to_num(np.concatenate([each.reshape(z.size, -1) for each in columns], axis=1).T)

        box = evaluator.unknowns.box
        inside = np.clip(z, box[0] + 1e-9, box[1] - 1e-9)
        least_squares(value, inside, jacobian, bounds=box, max_nfev=60)
        return clock

    def lbfgs(self, start):
        from scipy.optimize import minimize

        evaluator, z = self.evaluator(start)
        clock = Clock()

        def both(z):
            value, slope = self.gradient(jnp.asarray(z))
            clock.note(float(value))
            return float(np.nan_to_num(value, nan=1e6)), np.nan_to_num(np.asarray(slope))

        options = {"maxfun": MOST["lbfgs"], "ftol": 1e-12, "gtol": 1e-12}
        minimize(both, z, jac=True, method="L-BFGS-B", bounds=np.transpose(evaluator.unknowns.box), options=options)
        return clock

    def adam(self, start):
        import optax

        evaluator, z = self.evaluator(start)
        low, high = evaluator.unknowns.box
        clock, optimizer = Clock(), optax.adam(0.05)
        state = optimizer.init(z)
        for _ in range(MOST["adam"]):
            value, slope = self.gradient(jnp.asarray(z))
            clock.note(float(value))
            updates, state = optimizer.update(np.nan_to_num(np.asarray(slope)), state, z)
            z = np.clip(np.asarray(optax.apply_updates(z, updates)), low, high)
        return clock


def main():
    options = arguments(__doc__)
    figures = {"machine": describe(), "load": os.getloadavg()[0], "within": WITHIN}
    fits = Fits()
    names = ("ours", "least_squares", "lbfgs", "adam")
    if options.quick:
        MOST.update(lbfgs=10, adam=10)
    evaluator, z = fits.evaluator(STARTS["1.5_off"])
    evaluator.linear(z), evaluator.residual(z + 1e-3), fits.gradient(jnp.asarray(z))  # compile
    for word, start in list(STARTS.items())[: 1 if options.quick else None]:
        clocks = {name: getattr(fits, name)(start) for name in names}
        lowest = min(loss for clock in clocks.values() for loss, *_ in clock.seen)
        figures[word] = {
            name: {
                "until_within": clock.until(lowest),
                "evaluations": len(clock.seen),
                "s": clock.seen[-1][1],
                "loss_over_lowest": min(loss for loss, *_ in clock.seen) / lowest,
            }
            for name, clock in clocks.items()
        }
        print(word, figures[word], flush=True)
        save("fit_searches", figures, options.out)
    finish("fit_searches", figures, options.out)


if __name__ == "__main__":
    main()
