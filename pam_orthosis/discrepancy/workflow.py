# SPDX-License-Identifier: Apache-2.0
"""The gap workflow: check, replay, find where, name, add, show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from pam_orthosis.discrepancy import check, intervals, measure, select, structure
from pam_orthosis.discrepancy.data import Recording
from pam_orthosis.discrepancy.expected import Samples, decided, expected_squares
from pam_orthosis.discrepancy.fit import Fit, Problem, Scored
from pam_orthosis.discrepancy.replay import Replay, Run
from pam_orthosis.discrepancy.selection import Selection, Step
from pam_orthosis.discrepancy.system import System
from pam_orthosis.discrepancy.whitening import noise_levels, noise_whitener
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Section, load
from pam_orthosis.progress import Progress, silent

HELD_SHARE = 0.25  # of each recording, at its end, where no recording is held out
LEAST_CLOSURE = 0.9  # below it named effects that leave a gap are no explanation
MOST_LEFT = 1.3  # gap after over the noise floor above which the residual is not called clean
MOST_KEPT = 3.0  # gap of an equation over the noise floor above which it is unexplained, whatever was closed
LEAST_NAMED = 0.5  # closure of a model below which it names nothing
WHOLE = 0.995  # share of the samples that are judged, above which none is said to be left out
TELLING_STRAIN = 4.0  # deviations of an ordinary parameter over its tolerance that are worth a remark


@dataclass(frozen=True)
class Named:
    """An effect that was found: parameters (name -> value, unit, lower, upper), evidence.

    `look_alikes` are effects that nothing told from it when it was added, `separated_by` the experiments
    that would.
    """

    name: str
    equation: str
    parameters: Mapping[str, tuple[float, str, float, float]]
    evidence: float
    look_alikes: tuple[str, ...] = ()
    separated_by: tuple[str, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """All that the workflow found; `report` and `cli` turn it into pages and files.

    `look_alikes` and `separated_by` are those of the first effect. `from_configured` names the closures that
    count from the configured model, since recalibration closed the gap already. `empty` are parameters of
    the effects (as `EFFECT.PARAMETER`) at values where these are not what their names say.
    """

    system: System
    verdict: str
    effects: tuple[Named, ...]
    surrogates: tuple[Named, ...]
    look_alikes: tuple[str, ...]
    separated_by: tuple[str, ...]
    runner_up: tuple[str, float] | None
    configured: measure.Gap
    before: measure.Gap
    after: measure.Gap
    floor: measure.Gap
    closure: Mapping[str, float | None]
    from_configured: tuple[str, ...]
    where: Sequence[structure.Where]
    left: Sequence[structure.Where]
    strained: Mapping[str, float]
    empty: tuple[str, ...]
    steps: Sequence[Step]
    remarks: Sequence[str]
    selection: Selection = field(repr=False)
    held_out: Problem = field(repr=False)


@dataclass(frozen=True)
class Beginning:
    """Recordings that were checked, and the recalibrated model's replay of them.

    Attributes:
        system: without the equations that these recordings cannot judge.
        problem, null: training recordings, weighted, and the recalibrated model.
        held_out: recordings that judge.
        floor: what noise alone leaves in them.
        remarks: on the recordings.
    """

    system: System
    problem: Problem
    null: Fit
    held_out: Problem
    floor: measure.Gap
    remarks: tuple[str, ...]

    def configured(self, judged: Samples | None = None) -> measure.Gap:
        """Return the gap of the model as configured; `judged`: the samples that count (all)."""
        return measure.gap_at(self.held_out, (), self.held_out.replay.defaults(()), judged)

    def recalibrated(self, judged: Samples | None = None) -> measure.Gap:
        """Return the gap of the recalibrated model; `judged` as for `configured`."""
        return measure.gap(self.held_out, self.null, judged)

    def where(self) -> list[structure.Where]:
        """Return where the recalibrated model disagrees with the held-out recordings."""
        return structure.locate(self.held_out, self.null)

    def strained(self) -> dict[str, float]:
        """Return ordinary parameters outside their tolerance, in multiples of it."""
        return _strained(self.null)


def begin(
    system: System,
    training: Sequence[Recording],
    held_out: Sequence[Recording],
    settings,
    tell: Progress = silent,
    replay: Replay | None = None,
) -> Beginning:
    """Check recordings and recalibrate the model's ordinary parameters: the stages before the search.

    Arguments and errors are those of `find_gap`.
    """
    tell("checking the recordings")
    remarks = check.check(system, [*training, *held_out], settings.replay.warm_up)
    lacking = check.missing_inputs(system, [*training, *held_out])
    if lacking:
        system = _without(system, lacking)
        replay = None
    if not held_out:
        check.check_divisible(training, HELD_SHARE, settings.replay.warm_up)
        training, held_out = _split(training)
        remarks.append("no recording is held out: the last quarter of each one judges")
    check.check_motion(system, training, "the fit")
    check.check_motion(system, held_out, "the judgement")
    tell("compiling the model")
    problem, judge, floor = prepared(replay or Replay(system), training, held_out, settings)
    return Beginning(system, *select.recalibrated(problem, tell), judge, floor, tuple(remarks))


def find_gap(
    system: System,
    training: Sequence[Recording],
    held_out: Sequence[Recording],
    settings: Section | None = None,
    tell: Progress = silent,
    replay: Replay | None = None,
) -> Outcome:
    """Find where recordings and the model disagree, and which effects explain it.

    Args:
        training: recordings to fit.
        held_out: recordings to judge by; if empty, the last quarter of each training recording.
        settings: the branch `gap` of the parameters (as shipped).
        tell: told what is worked on.
        replay: kept kernels of the same system, to save time over many calls.

    Raises:
        OrthosisError: a recording is unfit.
    """
    settings = settings or load().gap
    return search(begin(system, training, held_out, settings, tell, replay), settings, tell)


def search(start: Beginning, settings, tell: Progress = silent) -> Outcome:
    """Return which effects explain what a recalibrated model leaves."""
    found = select.extended(start.problem, start.null, start.held_out, settings.evidence, tell)
    tell("measuring the gap on held-out recordings")
    return _judged(start, found, settings)


def _without(system: System, lacking: Sequence[str]) -> System:
    """Return the system without the equations that need inputs which were not recorded."""
    known = system.without(lacking)
    if not known.equations:
        raise OrthosisError(f"no equation can be replayed without {', '.join(lacking)}")
    return known


def _split(recordings: Sequence[Recording]) -> tuple[list[Recording], list[Recording]]:
    cut = [round((1 - HELD_SHARE) * one.samples) for one in recordings]
    first = [one.part(0, at, one.name) for one, at in zip(recordings, cut, strict=True)]
    last = [one.part(at, one.samples, f"{one.name} (end)") for one, at in zip(recordings, cut, strict=True)]
    return first, last


def prepared(replay: Replay, training, held_out, settings) -> tuple[Problem, Problem, measure.Gap]:
    """Return the training and the held-out problem, whitened, and the noise floor of the latter.

    What noise does to a replay is found without the effects that the model has already: a model that sticks
    would make of a little noise a large offset.
    """
    system, cutoff = replay.system, settings.replay.cross_cutoff
    bare = _bare(replay)
    runs = [[Run(system, one, cutoff) for one in group] for group in (training, held_out)]
    _check_replayed(replay, [run for group in runs for run in group])
    noise = _noise(bare, runs[0], settings)
    scored = [[_scored(bare, run, noise, settings, seed) for seed, run in enumerate(group)] for group in runs]
    floors = [floor for _, floor in scored[1]]
    units = {name: float(np.mean([floor[name] for floor in floors])) for name in floors[0]}
    white = dict.fromkeys([*units, measure.OVERALL], 1.0)
    problems = [Problem(replay, [one for one, _ in group]) for group in scored]
    return problems[0], problems[1], measure.Gap(units, white)


def _bare(replay: Replay) -> Replay:
    """Return the replay without the effects that the model has already."""
    return Replay(replay.system.bare()) if replay.system.simpler else replay


def _check_replayed(replay: Replay, runs: Sequence[Run]) -> None:
    for run in runs:
        for equation in replay.system.equations:
            if not np.isfinite(replay.residuals(run, equation, (), replay.defaults(()))).all():
                raise OrthosisError(
                    f"{run.recording.name}: the replay of the {equation.name} equation runs away; check the"
                    " units and the zeros of its signals, and the model's parameters"
                )


def _warm_up(run: Run, settings) -> int:
    return round(settings.replay.warm_up / run.period)


def _noise(replay: Replay, runs: Sequence[Run], settings) -> dict[str, float]:
    """Return the sd of the noise in each channel, estimated, and of the inputs' quantisation."""
    levels = _levels(replay, runs, settings, (), replay.defaults(()))
    measured = {c.name: levels.get(c.name, runs[0].roughness(c.name)) for c in replay.system.channels}
    inputs = dict.fromkeys(replay.system.inputs, settings.replay.input_noise)
    return {**measured, **inputs, **replay.system.input_noise}


def _levels(replay: Replay, runs: Sequence[Run], settings, effects, values) -> dict[str, float]:
    """Return the noise (sd) of the channels that are predicted, as a model's residuals show it."""
    residuals: dict[str, list[np.ndarray]] = {}
    for equation in replay.system.equations:
        for run in runs:
            rows = replay.residuals(run, equation, effects, values)[_warm_up(run, settings) :]
            for i, channel in enumerate(equation.channels):
                residuals.setdefault(channel, []).append(rows[:, i])
    return noise_levels(residuals, [run.period for run in runs])


def _floor(start: Beginning, found: Selection, settings) -> measure.Gap:
    """Return the noise floor as the final model shows it, in the recordings that judge.

    In a closed loop the inputs answer to the sensors' noise; a model that lacks a delay takes that for
    its own doing, and its residuals tell a wrong level. It is counted from the noise that the whiteners were
    made with, which is the bare model's.
    """
    replay, floor = _bare(found.problem.replay), start.floor
    fitted = [one.run for one in found.problem.scored]
    first = _levels(replay, fitted, settings, (), replay.defaults(()))
    last = _last_levels(start, found, settings)
    return _scaled(floor, {name: floor.white[name] * last[name] / first[name] for name in first})


def _last_levels(start: Beginning, found: Selection, settings) -> dict[str, float]:
    """Return the noise (sd) of the recordings that judge as the final model's residuals show it."""
    judging = [one.run for one in start.held_out.scored]
    return _levels(found.problem.replay, judging, settings, found.final.effects, found.final.values)


def _scaled(floor: measure.Gap, white: dict[str, float]) -> measure.Gap:
    """Return a floor with other whitened levels, units in proportion."""
    units = {name: floor.units[name] * white[name] / floor.white[name] for name in white}
    overall = float(np.sqrt(np.mean([value**2 for value in white.values()])))
    return measure.Gap(units, {**white, measure.OVERALL: overall})


def _decided(start: Beginning, found: Selection, spread: np.ndarray, settings):
    """Return which held-out samples chance does not decide, and what the final model expects to leave there.

    None and the noise floor, if no state of the model is left to chance.
    """
    final, judge = found.final, start.held_out
    if not _chance(found.problem.system, final):
        return None, _floor(start, found, settings)
    noise, cutoff = _last_levels(start, found, settings), settings.replay.cross_cutoff
    squares = expected_squares(judge, final, spread, noise, cutoff)
    masks = decided(judge, squares)
    if masks is None:
        return None, _floor(start, found, settings)
    white = {
        name: float(
            np.sqrt(np.mean(np.concatenate([squares[key][masks[key]] for key in squares if key[1] == name])))
        )
        for name in start.floor.units
    }
    return masks, _scaled(start.floor, white)


def _left_out(masks: Samples | None) -> tuple[str, ...]:
    """Return the remark on samples that do not count."""
    if masks is None:
        return ()
    share = {channel: np.mean(np.concatenate([m for (_, c), m in masks.items() if c == channel]))
             for _, channel in masks}  # fmt: skip
    told = ", ".join(f"{1 - kept:.0%} of {name}" for name, kept in share.items() if kept < WHOLE)
    return (f"not judged, since chance decides where play comes to rest: {told}",) if told else ()


def _chance(system: System, final: Fit) -> bool:
    """Whether a model has a state that chance decides."""
    catalogue = system.bare().catalogue
    return any(catalogue[name].held for name in (*final.effects, *system.simpler))


def _scored(replay: Replay, run: Run, noise, settings, seed: int) -> tuple[Scored, dict[str, float]]:
    warm_up = _warm_up(run, settings)
    whiten, floor = noise_whitener(
        replay, run, (), replay.defaults(()), noise, settings.replay.cross_cutoff, warm_up, seed
    )
    return Scored(run, whiten, warm_up), floor


def _judged(start: Beginning, found: Selection, settings) -> Outcome:
    system, judge, final = start.system, start.held_out, found.final
    spread = intervals.covariance(found.final_problem, final)
    judged, floor = _decided(start, found, spread, settings)
    configured = start.configured(judged)
    before, after = start.recalibrated(judged), measure.gap(judge, final, judged)
    left = structure.locate(judge, final)
    closed = _closures(configured, before, after, floor)
    kept, empty = max(measure.over_noise(system, after, floor).values()), _empty(system, final)
    verdict = _verdict(final, structure.clean(left) and not beyond(after, floor), closed, kept, empty)
    named = tuple(_named(system, found, spread, name, settings.evidence) for name in final.effects)
    first = _first_named(found, named)
    trusted = _trusted(closed[measure.OVERALL])  # a name that leaves most of the gap open is no name
    return Outcome(
        system=system,
        verdict=verdict,
        effects=named if trusted else (),
        surrogates=() if trusted else named,
        look_alikes=first.look_alikes if first else (),
        separated_by=first.separated_by if first else (),
        runner_up=_runner_up(found),
        configured=configured,
        before=before,
        after=after,
        floor=floor,
        closure=closed,
        from_configured=_from_configured(before, floor, closed),
        where=start.where(),
        left=left,
        strained=_strained(final),
        empty=empty if trusted else (),
        steps=tuple(found.steps),
        remarks=(*start.remarks, *_left_out(judged)),
        selection=found,
        held_out=judge,
    )


def _closures(configured, before, after, floor) -> dict[str, float | None]:
    """Return closure per channel and overall, of whitened residuals, from the recalibrated model.

    Where recalibration alone hides the gap (an effect that resembles an ordinary parameter), closure
    counts from the configured model.
    """
    closed: dict[str, float | None] = {}
    for name, after_white in after.white.items():
        closed[name] = measure.closure(before.white[name], after_white, floor.white[name])
        if closed[name] is None:
            closed[name] = measure.closure(configured.white[name], after_white, floor.white[name])
    return closed


def _from_configured(before: measure.Gap, floor: measure.Gap, closed) -> tuple[str, ...]:
    """Return the closures that `_closures` counts from the configured model."""
    return tuple(
        name
        for name, share in closed.items()
        if share is not None and measure.closure(before.white[name], 0.0, floor.white[name]) is None
    )


def _trusted(share: float | None) -> bool:
    """Return whether a model closes enough of the gap to be one; None: there is hardly any gap."""
    return share is None or share >= LEAST_NAMED


def beyond(after: measure.Gap, floor: measure.Gap) -> bool:
    """Return whether a gap is left, however well free parameters that are moved again would follow it."""
    return after.white[measure.OVERALL] > MOST_LEFT * floor.white[measure.OVERALL]


def _verdict(final: Fit, clean: bool, closed, kept: float, empty: Sequence[str]) -> str:
    """Return the verdict on a model that leaves a `clean` residual or not.

    Args:
        kept: the gap over the noise, in the equation where it is largest.
        empty: parameters at which effects of the model are not what their names say.
    """
    share = closed[measure.OVERALL]
    if clean and not final.effects:
        return "none"
    if not final.effects or empty or kept > MOST_KEPT or not _trusted(share):
        return "unexplained"
    return "explained" if clean or (share is not None and share >= LEAST_CLOSURE) else "unexplained"


def _empty(system: System, final: Fit) -> tuple[str, ...]:
    """Return the parameters at which effects are not what their names say."""
    return tuple(
        f"{name}.{q.name}"
        for name in final.effects
        for q in system.catalogue[name].parameters
        if q.is_empty(final.values[f"{name}.{q.name}"])
    )


def _named(system: System, found: Selection, spread, name: str, settings) -> Named:
    effect, final = system.catalogue[name], found.final
    parameters = {}
    known = {one.name for one in final.free}
    for q in effect.parameters:
        key = f"{name}.{q.name}"
        if key not in known:
            continue
        parameters[q.name] = (final.values[key], q.unit, *intervals.interval(final, spread, key))
    alike = _look_alikes(found, name, settings)
    apart = _separated_by(system, (name, *alike)) if alike else ()
    return Named(name, system.equation_of(name), parameters, found.evidence[name], alike, apart)


def _first_named(found: Selection, named: Sequence[Named]) -> Named | None:
    """Return the effect that was accepted first of those that stayed."""
    order = [step.accepted for step in found.steps]
    return min(named, key=lambda one: order.index(one.name), default=None)


def _first_round(found: Selection) -> tuple[float, Sequence[tuple[str, float]]]:
    """Return `_round_of` the first accepted effect that stayed."""
    accepted = [step.accepted for step in found.steps if step.accepted in found.final.effects]
    return _round_of(found, accepted[0]) if accepted else (0.0, ())


def _round_of(found: Selection, name: str) -> tuple[float, Sequence[tuple[str, float]]]:
    """Return the evidence of an effect when it was accepted, and those of its round that are not named.

    The best effect of a round may have been refused, and the next one accepted. A round in silence ranks
    by evidence of its own.
    """
    step = next(step for step in found.steps if step.accepted == name)
    own = dict(step.ranked).get(name, step.evidence)
    return own, [item for item in step.ranked if item[0] not in found.final.effects]


def _runner_up(found: Selection) -> tuple[str, float] | None:
    """Return the best effect that was not chosen in the first round, and how far it was behind."""
    own, others = _first_round(found)
    behind = [(name, own - evidence) for name, evidence in others]
    return min(behind, key=lambda item: item[1]) if behind else None


def _look_alikes(found: Selection, name: str, settings) -> tuple[str, ...]:
    """Return the effects that were near in evidence when one was accepted, but for those that are named."""
    own, others = _round_of(found, name)
    near = max(settings.ambiguous, settings.ambiguous_share * own)
    return tuple(other for other, evidence in others if own - evidence < near)


def _separated_by(system: System, names: Sequence[str]) -> tuple[str, ...]:
    """Return the experiments that part some effects, those of the first one first."""
    return tuple(dict.fromkeys(test for name in names for test in system.experiments(name)))


def _strained(final: Fit) -> dict[str, float]:
    """Return ordinary parameters that left their tolerance, in multiples of it."""
    named = {q for name in final.effects for q in (f"{name}.{p}" for p in _parameter_names(final, name))}
    strain = {one.name: one.deviation(final.values) for one in final.free if one.name not in named}
    return {name: value for name, value in strain.items() if abs(value) > TELLING_STRAIN}


def _parameter_names(final: Fit, effect: str) -> list[str]:
    return [key.split(".", 1)[1] for key in final.values if key.startswith(f"{effect}.")]
