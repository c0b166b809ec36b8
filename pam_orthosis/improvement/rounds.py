# SPDX-License-Identifier: Apache-2.0
"""Rounds of run, find the gap, add the effect to the controllers' model, run again with the same gains."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from pam_orthosis.bag.simulated import record_run
from pam_orthosis.bag.verdict import Verdict, judge
from pam_orthosis.discrepancy.answer.contract import as_dict
from pam_orthosis.discrepancy.apparatus import apparatus_of
from pam_orthosis.discrepancy.recordings.data import from_bag
from pam_orthosis.discrepancy.workflow import find_gap
from pam_orthosis.files import placed
from pam_orthosis.improvement import learned
from pam_orthosis.improvement.resumed import Found, read_found, write_found
from pam_orthosis.model.parameters import NOMINAL, Parameters, scenario_overrides
from pam_orthosis.model.truth import with_nominal
from pam_orthosis.progress import Progress, counted, silent

# of the evidence of another effect for which it could pass, which a further one needs (`gap.evidence.share`)
SHARE_KEY, SHARE = "gap.evidence.share", 0.01
LEVELS = {"scenario.diagnostic.low_angle": 0.45, "scenario.diagnostic.high_angle": 1.0}
DECAY = "diagnostic-decay"
SETTLING = 3.0  # s, until the gait has its cadence


class Experiment(NamedTuple):
    """A recording to make: what is set beside the run's own parameters, seed, whether it is held out."""

    name: str
    changes: Mapping[str, Any]
    seed: int
    held_out: bool = False


Bags = Mapping[str, tuple[Experiment, Path]]


def experiments(parameters: Parameters) -> list[Experiment]:
    """Return the experiments of a round: three cadences, and free decays if the machine has experiments.

    The decay parts friction from hysteresis and shows damping and masses; one cadence and other levels of
    the decay are held out. Whoever wears the orthosis wears it in all of them.
    """
    cycle, seed = parameters.scenario.cycle_time, 100 * (parameters.scenario.seed + 1)
    decay = {k: v for k, v in scenario_overrides(DECAY).items() if k != "scenario.control_period"}
    once = 11.0  # s, in which the experiment of the decay runs through once
    decay["scenario.duration"] = once

    def gait(share: float, duration: float) -> dict[str, Any]:
        return {"scenario.cycle_time": share * cycle, "scenario.duration": duration}

    made = [
        Experiment("gait", gait(1.0, SETTLING + 3.5 * cycle), seed),
        Experiment("gait-faster", gait(0.7, SETTLING + 3.5 * cycle), seed + 1),
        Experiment("decay", decay, seed + 2),
        Experiment("held-out-gait", gait(0.85, SETTLING + 2.5 * cycle), seed + 3, True),
        Experiment("held-out-decay", {**decay, **LEVELS}, seed + 4, True),
    ]
    diagnostic = parameters.declared.experiments
    return [one for one in made if diagnostic or not one.name.endswith("decay")]


@dataclass(frozen=True)
class Tracking:
    """How the machine follows with one nominal model: the verdict of each bag."""

    bags: tuple[Path, ...]
    verdicts: tuple[Verdict, ...]

    @property
    def largest(self) -> float:
        """Largest error of the worst run, in the verdicts' unit."""
        return max(v.max_abs_error for v in self.verdicts)

    @property
    def rms(self) -> float:
        """RMS error of the worst run, in the verdicts' unit."""
        return max(v.rms_error for v in self.verdicts)

    @property
    def variation(self) -> float:
        """Variation of the more nervous valve's voltage in the worst run, V/s."""
        return max(value for v in self.verdicts for value in v.voltage_variation_per_s.values())

    def as_dict(self) -> dict[str, float]:
        """Return the figures."""
        unit = self.verdicts[0].unit
        return {
            f"max_abs_error_{unit}": self.largest,
            f"rms_error_{unit}": self.rms,
            "voltage_variation_per_s": self.variation,
        }


@dataclass(frozen=True)
class Round:
    """One round: what was found, whether it was kept, tracking with it, the model up to here."""

    number: int
    found: Found | None
    kept: bool
    tracking: Tracking | None
    model: Mapping[str, Any]
    reason: str

    def as_dict(self) -> dict[str, Any]:
        """Return the round for a file: `report.improvement.table` reads it."""
        return {
            "round": self.number,
            "effects": list(self.found.effects) if self.found else [],
            "kept": self.kept,
            "reason": self.reason,
            "tracking": self.tracking.as_dict() if self.tracking else None,
            "gap": dict(self.found.told) if self.found else None,
        }


def improve(
    parameters: Parameters,
    scenario: str,
    folder: Path,
    seeds: Sequence[int],
    most: int,
    progress: Progress = silent,
) -> list[Round]:
    """Return the rounds, the first (0) without anything learned; bags and reports go below `folder`.

    What the folder holds already is not made again: an earlier call with the same arguments was cut short.
    The search gets the recordings and the nominal model, never the plant's parameters. An effect stays if the
    search names it and the worst run with it tracks better than without.

    Args:
        parameters: the whole tree; its nominal model is where learning starts.
        seeds: of the sensor noise in the runs that judge; the same in every round.
    """
    before = judged(parameters, scenario, folder / "round-0", seeds, progress)
    rounds = [Round(0, None, True, before, {}, "nothing learned")]
    known: dict[str, Any] = {}
    for number in range(1, most + 1):
        place, last = folder / f"round-{number}", rounds[-1]
        bags = recorded(with_nominal(parameters, last.model), scenario, place, progress)
        nominal = parameters.changed(known).only(*NOMINAL, "gap")  # the search cannot see the plant
        found = read_found(place)
        if found is None:
            found = find_effects(nominal, bags, progress)
            write_found(place, found)
        if not found.effects:
            rounds.append(Round(number, found, False, None, last.model, "no further effect is found"))
            break
        effects = learned.named(nominal, found.effects, found.values)
        model = {**known, **learned.calibrated(nominal, found.effects, found.values), **effects}
        after = judged(with_nominal(parameters, model), scenario, place, seeds, progress)
        kept = after.largest < before.largest
        words = "kept" if kept else f"the {parameters.declared.name} follows no better: not kept"
        rounds.append(Round(number, found, kept, after, model if kept else last.model, words))
        if not kept:
            break
        known |= effects
        before = after
    return rounds


def judged(
    parameters: Parameters, scenario: str, folder: Path, seeds: Sequence[int], progress: Progress = silent
) -> Tracking:
    """Record a run for each seed and judge it from its bag."""
    bags = tuple(folder / f"run-{seed}" for seed in seeds)
    pairs = list(zip(bags, seeds, strict=True))
    for bag, seed in counted(pairs, progress, f"{folder.name}: runs that judge"):
        _record_once(parameters, seed, scenario, bag)
    return Tracking(bags, tuple(judge(bag) for bag in bags))


def recorded(parameters: Parameters, scenario: str, folder: Path, progress: Progress = silent) -> Bags:
    """Record the experiments of a round; return name -> experiment and bag."""
    made = {}
    for experiment in counted(experiments(parameters), progress, f"{folder.name}: experiments to learn from"):
        bag = folder / experiment.name
        _record_once(parameters.changed(experiment.changes), experiment.seed, scenario, bag)
        made[experiment.name] = experiment, bag
    return made


def _record_once(parameters: Parameters, seed: int, scenario: str, bag: Path) -> None:
    """Record a bag, unless it is there: it appears whole or not at all."""
    if not bag.exists():
        with placed(bag) as unfinished:
            record_run(parameters.changed({"scenario.seed": seed}), scenario, unfinished)


def find_effects(parameters: Parameters, bags: Bags, progress: Progress) -> Found:
    """Return what the gap workflow finds in the bags; `parameters` is the nominal model and `gap`.

    Effects count here whether or not they close enough of the gap to be called its explanation, and beside
    larger ones in the same equation sooner than there: the machine judges them by how it follows.
    """
    machine = parameters.declared
    system = apparatus_of([bag for _, bag in bags.values()]).system(parameters, learned.learnable(machine))
    training, held_out = (
        [from_bag(bag, system) for experiment, bag in bags.values() if experiment.held_out == unseen]
        for unseen in (False, True)
    )
    outcome = find_gap(system, training, held_out, parameters.changed({SHARE_KEY: SHARE}).gap, progress)
    final = outcome.selection.final
    values = {key: float(value) for key, value in final.values.items()}
    return Found(tuple(final.effects), values, outcome.verdict, as_dict(outcome))
