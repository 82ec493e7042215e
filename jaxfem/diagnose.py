"""What went wrong in a step or a run, in words: which step, which body, which joint or contact, and what to do."""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.batching import one_program
from jaxfem.model import Model, Params, State, StepInfo
from jaxfem.pytrees import on_host
from jaxfem.rows.attachments import SoftPoint
from jaxfem.rows.candidates import Candidates, pairs_of
from jaxfem.rows.contact import ShapeContacts
from jaxfem.solvers import Status, describe
from jaxfem.stepping.checks import StepError
from jaxfem.stepping.entering import typed
from jaxfem.stepping.values import wrong_numbers
from jaxfem.system.coupled import configuration
from jaxfem.system.holding import STILL, violation

Array = jax.Array

OPEN = 1e-3  # of the scene's size (or rad): a joint that is further apart than this has come open
DEEP = 1e-2  # of the scene's size: contacts that strike are pushed out over some steps, so a little is usual


LANE = "of a batch, give one lane: jax.tree.map(lambda leaf: leaf[0], states)"
"""What to do with lanes."""


class Finding(NamedTuple):
    """One thing to look at: `kind` ("invalid", "not finite", "inverted", "fastest", "open", "deep", "inside"), the
    declared `name` of the body, joint, contact or parameter, the `amount` (the value, nodes or bodies, elements, m/s,
    m or rad, m, m), a sentence, and what to do."""

    kind: str
    name: str
    amount: float
    text: str
    advice: str = ""


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """What `diagnose` found; `str()` of it is the report.

    `ok`: every step converged and nothing looks wrong. `step`: the first that failed, counted from 1 along the leading
    axis of info and state; None where none did. `status`: its status, or that of the worst. `findings`: what to look
    at, the gravest first.
    """

    ok: bool
    step: int | None
    status: Status
    findings: tuple[Finding, ...]
    text: str

    def __str__(self) -> str:
        return self.text


def diagnose(model: Model, params: Params, state: State, info: StepInfo) -> Diagnosis:
    """Look at what `step` or `rollout` returned and say what is wrong and what to do; host side, not for inside jit.

    `info` and `state` are those of one step, or both of a run, with a leading axis of its saved steps; a run's `info`
    may also come with its last state alone. Bodies are looked at in the first bad state, joints and contacts in the
    last one that is finite. StepError for a batch, of runs or of single steps: look at one lane at a time.
    """
    status, states = _along_time(model, params, state, info)
    params, *states = typed(model, params, *states)
    finite = [all(np.isfinite(each).all() for each in _moving(one)) for one in states]
    alone = len(states) == 1 and len(status) > 1
    bad = [code != 0 or not (alone or finite[place]) for place, code in enumerate(status)]
    if alone and not finite[0]:
        bad[-1] = True
    step = bad.index(True) if True in bad else None
    shown = 0 if alone else len(states) - 1 if step is None else step
    findings = [Finding("invalid", *each, "correct that value in `params`") for each in wrong_numbers(model, params)]
    findings += _bodies(model, states[shown], step is not None)
    sound = [one for one, good in zip(states[: shown + 1], finite, strict=False) if good]
    rows = list(_rows(model, params, sound[-1])) if sound else []
    findings += [each for each in rows if each.advice]
    code = int(status[step]) if step is not None else int(Status.CONVERGED)
    ok = step is None and not findings
    if ok:
        text = "; ".join(filter(None, (_all_well(info, len(status), rows), beyond(model, info))))
    else:
        time = None if alone else float(np.asarray(states[shown].time))
        text = "\n".join([_headline(step, status, bad, code, time), *_listed(findings, code)])
    return Diagnosis(ok, None if step is None else step + 1, Status(code), tuple(findings), text)


def _along_time(model: Model, params: Params, state: State, info: StepInfo) -> tuple[np.ndarray, list[State]]:
    """Status of each step (T,), and the states: as many, or the last one alone."""
    given_as = ((model, Model), (params, Params), (state, State), (info, StepInfo))
    if not all(isinstance(each, kind) for each, kind in given_as):
        given = ", ".join(type(each).__name__ for each, _ in given_as)
        raise StepError(f"got ({given}); the order is (model, params, state, info)")
    status, places = np.asarray(info.status), np.asarray(state.positions)
    if status.ndim > 1 or places.ndim not in (2, 3) or (places.ndim == 3 and len(places) != status.size):
        raise StepError(
            f"info.status has shape {status.shape} and state.positions {places.shape}: give one step's, or one run's "
            f"with its steps along the leading axis; {LANE}"
        )
    if places.ndim == 3 and _stands_still(state, status):
        raise StepError(
            f"steps that converged are at one time, {np.min(state.time):.6g} s, as those of a run are not: {LANE}"
        )
    if places.ndim == 2:
        return np.atleast_1d(status), [state]
    host = on_host(state)
    return np.atleast_1d(status), [jax.tree.map(lambda leaf, at=at: leaf[at], host) for at in range(len(places))]


def _stands_still(states: State, status: np.ndarray) -> bool:
    """Whether time does not go on from one state to the next, though one of both converged: so it is with lanes of a
    batch. A run that stopped repeats its last state, with the status for which it did."""
    times, dropped = (np.asarray(each) for each in (states.time, 0 if states.carry is None else states.carry.time))
    times, status = np.atleast_1d(times), np.atleast_1d(status)
    same = (np.diff(times) <= 0) & (np.diff(np.broadcast_to(dropped, times.shape)) == 0)
    return bool((same & ((status[:-1] == 0) | (status[1:] == 0))).any())


def _moving(state: State) -> list[np.ndarray]:
    """Places and velocities of nodes, then of rigid bodies."""
    rigid = state.rigid
    own = [state.positions, state.velocities]
    if rigid is not None:
        own += [rigid.positions, rigid.orientations, rigid.velocities, rigid.angular_velocities]
    return [np.asarray(each) for each in own]


def _bodies(model: Model, state: State, failed: bool) -> Iterator[Finding]:
    """Bodies that are not finite, bodies turned inside out, and in a failed step the fastest one."""
    places, velocities, *rigid = _moving(state)
    owner = [model.bodies[number] for number in np.asarray(model.node_body)]
    lost = ~(np.isfinite(places).all(1) & np.isfinite(velocities).all(1))
    speed = np.linalg.norm(velocities, axis=1)
    if rigid and model.rigid is not None:
        owner += model.rigid.names
        lost = np.append(lost, ~np.all([np.isfinite(each).all(1) for each in rigid], axis=0))
        speed = np.append(speed, np.linalg.norm(rigid[2], axis=1))
    for name in dict.fromkeys(each for each, gone in zip(owner, lost, strict=True) if gone):
        count, total = (sum(each == name for each in of) for of in (np.array(owner)[lost], owner))
        what = f"{count} of its {total} nodes" if name in model.bodies else "its place or velocity"
        advice = "take a smaller time step; look at its loads, start and material for NaN, infinity or zero"
        yield Finding("not finite", name, count, f'body "{name}" is not finite any more: {what}', advice)
    yield from _inverted(model, places)
    speed = np.where(lost, -1.0, speed)
    if failed and len(speed) and speed.max() > 0:
        fastest = int(speed.argmax())
        text = f'body "{owner[fastest]}" is the fastest, {speed[fastest]:.3g} m/s'
        yield Finding("fastest", owner[fastest], float(speed[fastest]), text)


def _inverted(model: Model, places: np.ndarray) -> Iterator[Finding]:
    """Bodies with elements inside out, the one with most of them first."""
    cells, rest = np.asarray(model.elements.cells), np.asarray(model.rest)
    share = _sixfold_volumes(places[cells]) / _sixfold_volumes(rest[cells])
    body = np.asarray(model.elements.body)[share <= 0]
    counts = np.bincount(body, minlength=len(model.bodies))
    for number in np.argsort(-counts, kind="stable")[: np.count_nonzero(counts)]:
        name, count = model.bodies[number], int(counts[number])
        own = np.asarray(model.elements.body) == number
        least = np.nanargmin(np.where(own, share, np.inf))
        what = "element is" if count == 1 else "elements are"
        text = (
            f'{count} {what} inside out in body "{name}", worst is element {least} at {share[least]:.2g} of its volume'
        )
        advice = "take a smaller time step, a finer mesh or gentler loads"
        yield Finding("inverted", name, count, text, advice)


def _sixfold_volumes(corners: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):  # of elements that are not finite: they are told of by themselves
        volumes: np.ndarray = np.linalg.det(corners[:, 1:] - corners[:, :1])
    return volumes


def _rows(model: Model, params: Params, state: State) -> Iterator[Finding]:
    """Joints that are open, the worst first, and the deepest contact; with advice where that is more than it should be.

    The most open joint is told in any case, others where there is something to do.
    """
    at, size = configuration(state), 1.0 if model.size is None else float(model.size)
    holding = {label: group for label, group in model.joints.items() if group.holds}
    found = _openings(holding, {label: params.joints[label] for label in holding}, at)
    opened = []
    for label, group in holding.items():
        gap, softness = np.asarray(found[label][0]), np.asarray(found[label][1])
        share = gap / (size if group.length else 1.0)
        unit = "m" if group.length else "rad"
        opened += [(*each, unit, label) for each in zip(share, gap, group.names, softness > 0, strict=True)]
    told: set[str] = set()
    for share, amount, name, soft, unit, label in sorted(opened, key=lambda each: -each[0]):
        if name in told or (told and share <= OPEN):
            continue
        told.add(name)
        advice = "see that its anchors fit where the bodies start; take a smaller time step or raise max_iterations"
        advice = f"{advice}; it has a compliance, which lets it give: lower it" if soft else advice
        text = f'joint "{name}" is open by {amount:.3g} {unit} (rows "{label}")'
        yield Finding("open", name, float(amount), text, advice if share > OPEN else "")
    deepest = min(_nearest(model, at), default=(0.0, "", ""))
    if deepest[0] < 0:
        depth, name, label = -deepest[0], *deepest[1:]
        advice = "see that the bodies do not start inside each other; take a smaller time step or a larger margin"
        text = f'contact "{name}" is {depth:.3g} m deep (rows "{label}")'
        yield Finding("deep", name, depth, text, advice if depth > DEEP * size else "")
    yield from _through(model, at, DEEP * size)


@one_program
def _openings(joints: Mapping[str, Any], params: Mapping[str, Any], at: Any) -> dict[str, tuple[Array, Array]]:
    """By how much each joint of each group is open, and its greatest compliance, (m,)."""
    rows = {label: group.rows(at, params[label], STILL) for label, group in joints.items()}
    return {label: (violation(each), jnp.max(each.compliance, 1)) for label, each in rows.items()}


def _through(model: Model, at: Any, most: float) -> Iterator[Finding]:
    """Soft bodies whose nodes that do not take part in a contact are further than `most` [m] beyond its shape."""
    node_body = np.asarray(model.node_body)
    for candidates in model.contacts.values():
        if not (isinstance(candidates, ShapeContacts) and isinstance(candidates.points, SoftPoint)):
            continue
        nodes, names = np.asarray(candidates.points.nodes), np.array(candidates.names)
        for name in dict.fromkeys(candidates.names):
            mine = np.flatnonzero(names == name)
            touching = np.unique(nodes[mine])
            others = np.setdiff1d(np.flatnonzero(np.isin(node_body, node_body[touching])), touching)
            if not len(others):
                continue
            gap = np.asarray(candidates.for_nodes(others, int(mine[0])).pairs(at).gap)
            if gap.min() < -most:
                body, depth = model.bodies[node_body[others[gap.argmin()]]], -float(gap.min())
                count = int((gap < -most).sum())
                text = f'{count} nodes of body "{body}" are through contact "{name}", up to {depth:.3g} m'
                advice = f'give contact "{name}" nodes="all", so that nodes inside touch too; take a smaller time step'
                yield Finding("inside", body, depth, text, advice)


def _nearest(model: Model, at: Any) -> Iterator[tuple[float, str, str]]:
    """The least gap [m] of each group of contacts, its contact's name and its group's."""
    gaps = _gaps(dict(model.contacts), at)
    for label, candidates in model.contacts.items():
        gap = np.asarray(gaps[label])
        yield float(gap.min()), candidates.names[int(gap.argmin())], label


@one_program
def _gaps(contacts: Mapping[str, Candidates], at: Any) -> dict[str, Array]:
    """The gap [m] of each pair of each group."""
    return {label: pairs_of(each, at).gap for label, each in contacts.items()}


def _all_well(info: StepInfo, steps: int, rows: list[Finding]) -> str:
    what = "the step" if steps == 1 else f"all {steps} steps"
    effort = f"at most {int(np.max(info.iterations))} iterations, residual {float(np.max(info.residual)):.1e}"
    return "; ".join([f"{what} converged ({effort})", *(f"at the end {each.text}" for each in rows)])


def beyond(model: Model, info: StepInfo) -> str:
    """Says that a pyramid held more friction than the cone, by the most of a step's points; empty where none did."""
    most = 0 if info.beyond_cone is None else int(np.max(info.beyond_cone))
    if not most:
        return ""
    pyramids = (each for each in model.contacts.values() if each.rough and not each.cone)
    contacts = ", ".join(dict.fromkeys(f'"{name}"' for each in pyramids for name in each.names))
    where = "a point" if most == 1 else f"up to {most} points"
    return (
        f"friction at {where} was more than its coefficient allows, by up to 1.41 times across its directions: "
        f"Contact(cone=True) is the true cone (contact {contacts})"
    )


def _headline(step: int | None, status: np.ndarray, bad: list[bool], code: int, time: float | None) -> str:
    """Which step failed first and how; how many did."""
    if step is None:
        return "every step converged, but this looks wrong:"
    when = "" if time is None else f" (t = {time:.6g} s)"
    which = "the step" if len(status) == 1 else f"step {step + 1} of {len(status)}"
    word = "not finite" if Status(code) is Status.CONVERGED else words(code)
    more = f", the first of {sum(bad)}" if sum(bad) > 1 else ""
    return f"{which}{when} failed{more}: {word}"


def words(code: int) -> str:
    """A status in a few words, like "iteration limit"; `describe` has the whole sentence."""
    return Status(code).name.lower().replace("_", " ")


def _listed(findings: list[Finding], code: int) -> list[str]:
    """A line a finding, then what to do: the solve's own remedy first, each only once."""
    told = [] if Status(code) is Status.CONVERGED else [f"its solve {describe(code)}"]
    advice = dict.fromkeys(each.advice for each in findings if each.advice)
    return [f"  {line}" for line in (*told, *(each.text for each in findings), *(f"next: {each}" for each in advice))]
