"""The real beam with a law that relaxes.  python benchmarks/real_beam.py DIR --branches 1 2 [--quick]

One set of constants a law, from gravity.csv alone: the relaxed Young's modulus from the settled shape, share and time
of each branch from the motion from the release until it has long settled, at 5 ms. One branch has beta beside it; with
two the second takes its place: one take rings at one frequency, and cannot tell beta from a branch that relaxes fast.
Then the loaded takes are predicted: settled tips by statics, frequency and damping ratio with the weight as a ball on a
rope (`real_beam_weight.py`).
"""

import numpy as np
import real_beam as beams
import real_beam_weight as weights

import jaxfem as jf
from jaxfem.fitting.search import Search

DT = 5e-3
END = 2.95  # s of the recording: it has settled since 2.3
RINGING = 1.63  # s after the release, until it has settled
STARTS = {1: [(0.1, 0.6)], 2: [(0.25, 0.016), (0.03, 0.5)]}
BETA = {1: 2.6e-3, 2: 0.0}  # s; 0: not fitted


def law(branches, young, damping):
    """The beam's material."""
    return jf.Viscoelastic(young, 0.499, damping, branches)


def fitted(cells, gravity, count, young):
    """The fit of a law with `count` branches, and the law with its values."""
    scene = beams.beam(cells, material=law(STARTS[count], young, BETA[count]))
    names = [f"{word}_{k + 1}" for k in range(count) for word in ("g", "tau")]
    names += ["damping"] if BETA[count] else []
    bounds = {name: {"g": (0.005, 1.0), "t": (1e-3, 2.0), "d": (1e-4, 1e-2)}[name[0]] for name in names}
    result = jf.fit(
        *scene,
        gravity,
        beams.PLACES,
        parameters=(*names, "delay"),
        dt=DT,
        frame="rest",
        end=END,
        bounds=bounds,
        search=Search(candidates=1, polish=10, tol=1e-3),
        checks="warn",
    )
    pairs = [(result.values[f"g_{k + 1}"], result.values[f"tau_{k + 1}"]) for k in range(count)]
    return result, law(pairs, young, result.values.get("damping", 0.0))


def rms(result):
    """Misfit of the tip markers while it rings and after, a coordinate [mm]."""
    tips = result.residuals[:, [name.startswith("tip") for name in result.markers]]
    early = result.times <= RINGING
    return [1e3 * float(np.sqrt(np.nanmean(part**2))) for part in (tips[early], tips[~early])]


def run(folder, cells, count, takes):
    """Figures of a law with `count` branches; `takes`: name -> `Settled`."""
    young = beams.settled_young([takes["gravity"]], 2.6e5)
    result, material = fitted(cells, beams.recording_of(folder, "gravity"), count, young)
    ringing, settled = rms(result)
    figures = {
        "young": young,
        **beams.summary_of(result),
        "ringing_rms_mm": ringing,
        "settled_rms_mm": settled,
        "fit": result.status,
    }
    figures["warnings"] = list(result.warnings)
    figures["settled"] = beams.heights(takes, young)
    frequency = 2 * np.pi * np.array([7.72, 4.35, 3.37])
    storage, loss = (np.asarray(each) for each in material.storage_and_loss(frequency))
    figures["storage_modulus"], figures["half_loss_tangent"] = storage.tolist(), (0.5 * loss / storage).tolist()
    loaded = [name for name in takes if name != "gravity"]
    figures["loaded"] = {name: weights.compare(folder, name, cells, material) for name in loaded}
    return figures
