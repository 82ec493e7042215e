"""Takes: recordings with the scene that each is of, prepared for a search together."""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxfem.fitting.before import falling, is_held, looked_through, refuse, written_faults
from jaxfem.fitting.beside import DataOf, data_of
from jaxfem.fitting.clamp import in_frame_of_clamp
from jaxfem.fitting.correlation import Channels
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.evaluation import Piece
from jaxfem.fitting.markers import Markers, attach, marker_places
from jaxfem.fitting.measurement import Measurement, measurement
from jaxfem.fitting.noise import Noise
from jaxfem.fitting.objective import Plan, make_problem
from jaxfem.fitting.place_checks import unit_faults
from jaxfem.fitting.recording import Recording
from jaxfem.fitting.repairs import first_places, repaired
from jaxfem.fitting.start_checks import release_doubts
from jaxfem.fitting.unknowns import DELAY, Unknowns
from jaxfem.materials.constants import Constant
from jaxfem.model import Model, Params, State
from jaxfem.stepping import check_call, typed

BETWEEN = 0.02
"""Of the samples' spacing: a release nearer to a row is that row's."""


@dataclasses.dataclass(frozen=True)
class Take:
    """A `recording` of `markers` (attached ones, or places by name [m]) on the scene (`model`, `params`, `state`), in
    steps of about `dt` [s]; `frame`, `compare`, `release`, `end` as in `jaxfem.fit`. `name`: its word in tables.
    `beside`: what else was measured, `Frequencies`, `Settled`, `SupportForce` and `Gauge` objects. `clamp`: markers
    on what stands still, by name and place [m] in the body's frame: the rigid frame is found from them alone,
    and they are compared with nothing. `groups`: numbers of elements by the name of a group, whose constants then have
    paths of their own, young.GROUP.
    """

    model: Model
    params: Params
    state: State
    recording: Recording
    markers: Markers | Mapping[str, Any]
    dt: float
    frame: str = "none"
    compare: str = "displacement"
    release: Any = "auto"
    end: Any = None
    name: str = "take"
    beside: Sequence[Any] = ()
    clamp: Mapping[str, Any] | None = None
    groups: Mapping[str, Any] | None = None


@dataclasses.dataclass(frozen=True)
class Prepared:
    """A take whose recording was looked at and cut: `faults` were let pass, `notes` tell what was repaired, `doubts`
    are warnings."""

    take: Take
    params: Params
    state: State
    markers: Markers
    recording: Recording
    measured: Measurement
    faults: tuple[str, ...]
    notes: tuple[str, ...]
    doubts: tuple[str, ...] = ()

    @property
    def unit(self) -> str:
        """Of its samples: "m" or "px"."""
        return "m" if self.recording.camera is None else "px"

    @property
    def axes(self) -> int:
        """Coordinates of a sample."""
        return 3 if self.recording.camera is None else 2

    @property
    def constants(self) -> int:
        """Unknowns of a frame that are found along the way."""
        return 6 * (self.take.frame == "all")


def prepared(take: Take, checks: str, late: bool = False) -> Prepared:
    """Check and cut a take's recording. FitError where it cannot be right, unless `checks` is "warn". `late`:
    what is fitted changes how, or when, the motion begins."""
    params, state = typed(take.model, take.params, take.state)  # plain numbers are fine, as in `step`
    check_call(take.model, params, state, take.dt)
    markers = take.markers if isinstance(take.markers, Markers) else attach(take.model, take.markers)
    recording, told = in_frame_of_clamp(take.recording, take.clamp, markers.names, take.frame)
    nominal = np.asarray(marker_places(markers, state), np.float64)
    rough = recording.subset(markers.names)
    try:
        recording = repaired(rough)
    except FitError:  # of a marker that scatters far more than others: its unit may be another
        if rough.unit != "px":
            refuse(unit_faults(first_places(rough), nominal, rough.names, take.frame), checks)
        raise
    of = recording, markers, nominal, take.model, params, take.frame
    try:
        measured = measurement(
            recording, nominal, frame=take.frame, compare=take.compare, release=take.release, end=take.end
        )
    except FitError:  # no release is found, say: the course of the motion may tell why
        refuse(looked_through(*of, (-np.inf, np.inf))[0], checks)
        raise
    scene = take.model, params, state
    faults, notes = written_faults(recording, measured, nominal, *scene, take.frame, take.compare, late, take.release)
    if not faults:
        end = measured.begins[0] + float(measured.times[-1]) + 0.5 * measured.spacing
        begin = recording.times[0] if isinstance(take.release, str) else measured.begins[0]
        faults, suspicions = looked_through(*of, (begin, end))
        notes += suspicions
    faults = refuse(faults, checks)
    notes = [*recording.notes, *told, *_rounded(take.release, measured), *notes]
    doubts = []
    if not isinstance(take.release, str) and is_held(take.model) and falling(*scene, late):
        doubts = release_doubts(recording, measured, float(take.release))
    return Prepared(take, params, state, markers, recording, measured, tuple(faults), tuple(notes), tuple(doubts))


def _rounded(release: Any, measured: Measurement) -> list[str]:
    """A note of a release that was given between rows."""
    off = 0.0 if isinstance(release, str) else measured.begins[0] - float(release)
    if abs(off) < BETWEEN * measured.spacing:
        return []
    return [
        f"release = {release:g} s lies between rows: the motion is taken to begin at that of {measured.begins[0]:g} s, "
        f'{1e3 * abs(off):.2g} ms {"later" if off > 0 else "earlier"}; fit "delay" to find the rest'
    ]


def compiled_piece(
    made: Prepared, unknowns: Unknowns, own: Mapping[str, Constant], noise: Noise, usual: float
) -> Piece:
    """What is compiled of a take; `own`: name of an unknown of the fit -> the constant that it is in this take; `usual`
    scale [m] where the noise gives none.

    Steps are such that a frame is saved at each sample: `dt` is moved to the nearest divisor of the sample spacing.
    """
    take, measured = made.take, made.measured
    every = max(1, round(measured.spacing / take.dt))
    dt = measured.spacing / every
    columns = [k for k, name in enumerate(unknowns.names) if name in own]
    constants = tuple(own[unknowns.names[k]] for k in columns)
    early = max(
        [0.0, *(-float(unknowns.lower[k]) for k, each in zip(columns, constants, strict=True) if each is DELAY)]
    )
    frames = max(2, int(np.ceil((measured.times[-1] + early) / measured.spacing - 1e-6)))
    solved = take.frame if take.frame == "all" else "none"  # "rest" is dealt with once, before: both share a program
    plan = Plan(constants, frames, every, solved, take.compare, measured.free_origin)
    scale = noise.scale(made.markers.names, usual)
    problem = make_problem(
        take.model, made.params, made.state, made.markers, measured, plan, dt, scale, made.recording.camera
    )
    return Piece(problem, plan, np.array(columns, int))


def data_beside(made: Prepared, unknowns: Unknowns, own: Mapping[str, Constant]) -> list[DataOf]:
    """What was measured beside the markers of a take, as a fit evaluates it; `own` as in `compiled_piece`."""
    take = made.take
    scene = take.model, made.params, made.state, made.markers
    return data_of(take.beside, scene, unknowns.names, own, made.measured.spacing, take.dt)


def channels_of(number: int, made: Prepared, weights: np.ndarray) -> list[Channels]:
    """Markers of a take by the rows in which they were seen; `weights` (T, M, 3) of the residuals."""
    measured = made.measured
    level = made.take.compare == "displacement"
    # In the recording's axes where the frame is found with the fit: noise is noise.
    quiet = level and not measured.free_origin
    still = -measured.still * weights.max(axis=0) if quiet else np.zeros((0, *weights.shape[1:]))
    when = np.round(measured.times / measured.spacing).astype(int)
    before: np.ndarray = np.asarray(np.isfinite(still).all(axis=-1))
    patterns: dict[bytes, list[int]] = {}
    for marker in np.flatnonzero(measured.seen.any(axis=0)):
        key = measured.seen[:, marker].tobytes() + before[:, marker].tobytes()
        patterns.setdefault(key, []).append(int(marker))
    found = []
    for marks in patterns.values():
        rows, there = np.flatnonzero(measured.seen[:, marks[0]]), before[:, marks[0]]
        found.append(
            Channels(
                take=number,
                rows=rows,
                marks=np.array(marks),
                when=np.concatenate([measured.still_when[there] if quiet else np.zeros(0, int), when[rows]]).astype(
                    int
                ),
                still=still[there][:, marks],
                offset=level,
                pinned=quiet,
                axes=made.axes,
            )
        )
    return found


def checked_takes(takes: Sequence[Take]) -> None:
    """FitError for none, or two of a name, or of different precision or unit."""
    if not takes:
        raise FitError("no take is given: give at least one recording with its scene")
    names = [take.name for take in takes]
    for name in names:
        if names.count(name) > 1:
            raise FitError(f'two takes are named "{name}": give each a name of its own')
    for one, other in itertools.combinations(takes, 2):
        if _same(one.recording, other.recording):
            raise FitError(
                f'takes "{one.name}" and "{other.name}" hold the very same samples, which would count twice: leave one '
                "out, or give it its own recording"
            )
    if len({str(take.model.rest.dtype) for take in takes}) > 1:
        raise FitError("takes differ in precision: build all scenes in float64, or all in float32")


def _same(one: Recording, other: Recording) -> bool:
    """Whether markers of the same names stand at the very same places throughout."""
    names = [name for name in one.names if name in other.names]
    if not names or one.times.shape != other.times.shape:
        return False
    a, b = (each.subset(names).positions for each in (one, other))
    return bool(np.array_equal(a, b, equal_nan=True))
