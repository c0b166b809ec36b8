# SPDX-License-Identifier: Apache-2.0
"""The stages before the search: recordings are checked and weighted, the model is recalibrated."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pam_orthosis.discrepancy.fitting import measure, refit, structure
from pam_orthosis.discrepancy.fitting.fit import Fit
from pam_orthosis.discrepancy.fitting.measure import Samples
from pam_orthosis.discrepancy.preparation import check
from pam_orthosis.discrepancy.preparation.clocks import aligned
from pam_orthosis.discrepancy.preparation.glitches import without_glitches
from pam_orthosis.discrepancy.preparation.mistakes import against_words, mistake_words
from pam_orthosis.discrepancy.recordings.data import Recording
from pam_orthosis.discrepancy.recordings.memory import check_room
from pam_orthosis.discrepancy.recordings.stamps import Found, clearly_off, remarks_on, shared_skews
from pam_orthosis.discrepancy.replay.problem import Problem, Scored
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.replay.run import Run
from pam_orthosis.discrepancy.replay.whitening import Whitener, noise_levels, noise_whitener, stated
from pam_orthosis.discrepancy.systems.system import Equation, Names, System, Values
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Section
from pam_orthosis.progress import Progress, silent

HELD_SHARE = 0.25  # of each recording, at its end, where no recording is held out
NOTABLE = 4.0  # deviations of a nuisance parameter over its tolerance that are worth a remark


@dataclass(frozen=True)
class Beginning:
    """Recordings that were checked, and the recalibrated model's replay of them.

    Attributes:
        system: without the equations that these recordings cannot judge.
        problem, null: training recordings, weighted, and the recalibrated model.
        held_out: recordings that judge.
        floor: what noise alone leaves in them.
        remarks: on the recordings.
        mistaken: whether one of these says that they seem to have a mistake.
        against: the one on a coordinate that moves against all known forces; empty if none does.
        skewed: whether one says that stamps are clearly off.
        beyond: whether one says that they leave what the model's maps know.
        stamps: those that say that stamps are off.
        skews: by how much, of each recording as it was given.
        moved: what to say if an effect over time is named: recordings count from another instant than their
            clocks say; empty if they do not.
        whole: the system with the equations that need inputs which are missing; None: it is `system`.
        missing: these inputs.
    """

    system: System
    problem: Problem
    null: Fit
    held_out: Problem
    floor: measure.Gap
    remarks: tuple[str, ...]
    mistaken: bool = False
    against: str = ""
    skewed: bool = False
    beyond: bool = False
    stamps: tuple[str, ...] = ()
    skews: Found = ()
    moved: str = ""
    whole: System | None = None
    missing: Names = ()

    @property
    def doubtful(self) -> bool:
        """Whether a remark should be read before a search that may take minutes."""
        return self.mistaken or self.skewed or self.beyond

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
        """Return nuisance parameters outside their tolerance, in multiples of it."""
        return strained_parameters(self.null)


def begin(
    system: System,
    training: Sequence[Recording],
    held_out: Sequence[Recording],
    settings: Section,
    progress: Progress = silent,
    replay: Replay | None = None,
) -> Beginning:
    """Check recordings and recalibrate the model's nuisance parameters: the stages before the search.

    Arguments and errors are those of `find_gap`.
    """
    progress("checking the recordings")
    training, held_out = ([without_glitches(system, one) for one in many] for many in (training, held_out))
    remarks = check.check(system, [*training, *held_out], settings.replay.warm_up)
    check.check_unseen(training, held_out)
    replay = replay or Replay(system)
    check_room([*training, *held_out], replay.workers.jobs)
    skews = shared_skews(system, [*training, *held_out], replay.workers)
    beyond = check.beyond_boxes(system, [*training, *held_out])
    remarks += [*check.pulling_alike(system), *beyond, *check.unread([*training, *held_out])]
    whole, missing = system, check.missing_inputs(system, [*training, *held_out])
    if missing:
        system = _without(system, missing)
        replay = Replay(system, replay.workers)
    begins: list[int] = []
    if not held_out:
        check.check_divisible(training, HELD_SHARE, settings.replay.warm_up)
        training, held_out, begins = _split(training)
        remarks.append("no recording is held out: the last quarter of each one judges")
    check.check_motion(system, training, "the fit")
    check.check_motion(system, _judged(held_out, begins), "the judgement")
    progress("compiling the model")
    problem, judge, floor = prepared(replay, training, held_out, settings, begins)
    problem, null = refit.recalibrated(problem, progress)
    cutoff = settings.replay.cross_cutoff
    problem, judge, moved = aligned(problem, null, judge, cutoff)
    mistake = mistake_words(judge, cutoff)
    if stated(system) and measure.gap(judge, null).white[measure.OVERALL] < 1 + measure.LEAST_EXCESS:
        skews = [
            (one, ()) for one, _ in skews
        ]  # readings between rows have less noise, as if stamps were off
    stamps = [] if mistake else remarks_on(whole, skews)  # a mistake may look like stamps that are off
    against = "" if mistake else against_words(judge)
    remarks += [mistake] if mistake else stamps
    remarks += [against] * bool(against)
    return Beginning(
        system,
        problem,
        null,
        judge,
        floor,
        tuple(remarks),
        mistaken=bool(mistake or against),
        against=against,
        skewed=not mistake and clearly_off(skews),
        beyond=bool(beyond),
        stamps=tuple(stamps),
        skews=skews,
        moved=moved,
        whole=whole,
        missing=tuple(missing),
    )


def _without(system: System, missing: Sequence[str]) -> System:
    """Return the system without the equations that need inputs which were not recorded."""
    known = system.without(missing)
    if not known.equations:
        raise OrthosisError(f"no equation can be replayed without {', '.join(missing)}")
    return known


def _split(recordings: Sequence[Recording]) -> tuple[list[Recording], list[Recording], list[int]]:
    """Return what is fitted, the recordings whose last part judges, and the samples at which that begins.

    They are replayed from their beginning: what warms, creeps or acts late at the cut began before it.
    """
    cut = [round((1 - HELD_SHARE) * one.samples) for one in recordings]
    first = [one.part(0, at, one.name) for one, at in zip(recordings, cut, strict=True)]
    return first, [replace(one, name=f"{one.name} (end)") for one in recordings], cut


def _judged(held_out: Sequence[Recording], begins: Sequence[int]) -> list[Recording]:
    if not begins:
        return list(held_out)
    return [one.part(at, one.samples, one.name) for one, at in zip(held_out, begins, strict=True)]


def prepared(
    replay: Replay,
    training: Sequence[Recording],
    held_out: Sequence[Recording],
    settings: Section,
    begins: Sequence[int] = (),
) -> tuple[Problem, Problem, measure.Gap]:
    """Return the training and the held-out problem, whitened, and the noise floor of the latter.

    `begins`: the samples of held-out recordings at which what judges begins, if not after the warm-up.
    What noise does to a replay is found without the effects that the model has already: a model that sticks
    would make of a little noise a large offset.
    """
    system, cutoff = replay.system, settings.replay.cross_cutoff
    bare = bare_replay(replay)
    runs = [[Run(system, one, cutoff) for one in group] for group in (training, held_out)]
    _check_replayed(replay, [run for group in runs for run in group])
    noise = _noise(bare, runs[0], settings)
    numbered = [(seed, run) for group in runs for seed, run in enumerate(group)]
    skipped = [_warm_up(run, settings) for _, run in numbered]
    skipped[len(runs[0]) :] = begins or skipped[len(runs[0]) :]

    def whitened_run(place: int) -> tuple[Whitener, dict[str, float]]:
        seed, run = numbered[place]
        return noise_whitener(bare, run, noise, cutoff, skipped[place], seed)

    whitened = replay.workers.forked(whitened_run, range(len(numbered)))
    floors = [floor for _, floor in whitened[len(runs[0]) :]]
    units = {name: float(np.mean([floor[name] for floor in floors])) for name in floors[0]}
    _check_held(replay.system, units, [run.recording for run in runs[1]])
    white = dict.fromkeys([*units, measure.OVERALL], 1.0)
    scored = [
        Scored(run, whiten, skip)
        for (_, run), (whiten, _), skip in zip(numbered, whitened, skipped, strict=True)
    ]
    first, second = scored[: len(runs[0])], scored[len(runs[0]) :]
    return Problem(replay, first), Problem(replay, second), measure.Gap(units, white)


def bare_replay(replay: Replay) -> Replay:
    """Return the replay without the effects that the model has already."""
    return Replay(replay.system.bare(), replay.workers) if replay.system.simpler else replay


def _check_replayed(replay: Replay, runs: Sequence[Run]) -> None:
    for run in runs:
        for equation in replay.system.equations:
            finite = np.isfinite(replay.residuals(run, equation, (), replay.defaults(()))).all(axis=1)
            if not finite.all():
                raise OrthosisError(f"{run.recording.name}: {_endless(equation, begun=finite[:2].all())}")


def _check_held(system: System, floors: Values, recordings: Sequence[Recording]) -> None:
    """Raise OrthosisError where noise alone takes a replay as far as a channel ever goes."""
    for channel in system.channels:
        spans = [float(np.ptp(one.signals[channel.name])) for one in recordings]
        if floors.get(channel.name, 0.0) > max(spans) > 0:
            raise OrthosisError(
                f"{channel.name}: noise grows in the replay until it is as large as all that was recorded:"
                " the model leaves its recording faster than that holds it, as something unstable does;"
                f" a system of your own takes larger Model(gains={{{channel.name!r}: ...}})"
            )


def _endless(equation: Equation, begun: bool) -> str:
    """Return what is said of an equation whose replay does not stay finite; `begun`: its first step does."""
    if begun:
        return (
            f"the replay of the {equation.name} equation runs away; check the units and the zeros of its"
            " signals, and the model's parameters"
        )
    return (
        f"the {equation.name} equation gives no finite number from the first sample on; check the model's"
        " equations and parameters: is one 0 that divides?"
    )


def _warm_up(run: Run, settings: Section) -> int:
    seconds: float = settings.replay.warm_up
    return round(seconds / run.period)


def _noise(replay: Replay, runs: Sequence[Run], settings: Section) -> dict[str, float]:
    """Return the sd of the noise in each channel and sensed input, estimated, and of other inputs' steps."""
    levels = residual_noise(replay, runs, settings, (), replay.defaults(()))
    measured = {c.name: levels.get(c.name, runs[0].roughness(c.name)) for c in replay.system.channels}
    inputs = dict.fromkeys(replay.system.inputs, settings.replay.input_noise)
    recorded = {name: [run.recording.signals[name] for run in runs] for name in replay.system.sensed}
    sensed = noise_levels(recorded, [run.period for run in runs])
    return {**measured, **inputs, **sensed, **replay.system.input_noise}


def residual_noise(
    replay: Replay, runs: Sequence[Run], settings: Section, effects: Names, values: Values
) -> dict[str, float]:
    """Return the noise (sd) of the channels that are predicted, as a model's residuals show it."""
    residuals: dict[str, list[np.ndarray]] = {}
    for equation in replay.system.equations:
        for run in runs:
            rows = replay.residuals(run, equation, effects, values)[_warm_up(run, settings) :]
            for i, channel in enumerate(equation.channels):
                residuals.setdefault(channel, []).append(rows[:, i])
    return noise_levels(residuals, [run.period for run in runs])


def strained_parameters(final: Fit) -> dict[str, float]:
    """Return nuisance parameters that left their tolerance, in multiples of it."""
    nuisance = (one for one in final.free if one.name.partition(".")[0] not in final.effects)
    strain = {one.name: one.deviation(final.values) for one in nuisance}
    return {name: value for name, value in strain.items() if abs(value) > NOTABLE}
