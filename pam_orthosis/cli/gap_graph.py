# SPDX-License-Identifier: Apache-2.0
"""The experiment that would help next, done by the node graph on the emulated hardware of a recording."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

from pam_orthosis.bag.bounded import check_bag, open_bag
from pam_orthosis.bag.read import machine_of, recorded_parameters, run_record
from pam_orthosis.bag.topics import TRUTH
from pam_orthosis.cli.run import need_ros, run_graph
from pam_orthosis.discrepancy.systems.knee import ALONE
from pam_orthosis.errors import OrthosisError, naming
from pam_orthosis.files import refuse_used
from pam_orthosis.model.parameters import Parameters, experiments, load, scenario_overrides
from pam_orthosis.nodes.launch import Mode
from pam_orthosis.tables import is_table

BAGS = "fitted", "held_out"
OF_MOTION = "scenario.", "plant.external_"  # what a scenario sets of the motion alone


class Emulated(NamedTuple):
    """The emulated hardware that recordings are of, with its controllers.

    `done`, `seeds`: scenarios of these, and seeds of their sensor noise; `repeated`: whether the graph has
    added one.
    """

    parameters: Parameters
    done: frozenset[str]
    seeds: frozenset[int]
    repeated: bool = False

    @property
    def experiments(self) -> list[str]:
        """The diagnostic experiments whose recordings can be used beside those that there are."""
        return [name for name in experiments() if name not in self.done and self._fits(name)]

    def _fits(self, name: str) -> bool:
        changes = self.parameters.changed(scenario_overrides(name))
        return all(changes.at(key) == self.parameters.at(key) for key in ALONE)

    def record(self, name: str, folder: Path, judged: bool) -> tuple[list[Path], Emulated]:
        """Record an experiment, to fit and, if `judged`, again to judge; return the bags, and what is known.

        Raises:
            OrthosisError: the folder is used, or a run failed; it says what is left of it.
        """
        experiment, seeds = self.parameters.changed(scenario_overrides(name)), self.seeds
        refuse_used(folder)
        bags = [folder / bag for bag in BAGS[: 1 + judged]]
        for bag in bags:
            seed = next(one for one in count(1) if one not in seeds)  # two with one seed have one noise
            run_graph(experiment.changed({"scenario.seed": seed}), bag.resolve(), name, Mode(composed=True))
            seeds |= {seed}
        return bags, Emulated(self.parameters, self.done | {name}, seeds, repeated=True)


def emulated(paths: Iterable[Path], namespace: str) -> Emulated:
    """Return the emulated hardware of recordings, which only the graph is told of, never a search.

    Raises:
        OrthosisError: they are not of one joint that the graph emulated alike, or there is no ROS.
    """
    need_ros()
    if namespace:
        raise OrthosisError("--next DIR: the graph repeats runs of one joint, without --namespace")
    runs = {path: _run_of(path) for path in paths}
    (first, (parameters, *_)), *others = runs.items()
    for path, (other, *_) in others:
        if _hardware(other) != _hardware(parameters):
            raise OrthosisError(f"--next DIR: {first} and {path} are of different emulated hardware")
    done = frozenset(scenario for _, scenario, _ in runs.values())
    return Emulated(parameters, done, frozenset(seed for *_, seed in runs.values()))


def _hardware(parameters: Parameters) -> dict[str, Any]:
    return {key: value for key, value in parameters.flat().items() if key.startswith("plant.")}


def _run_of(path: Path) -> tuple[Parameters, str, int]:
    """Return with what a bag of the graph was run, but for its motion; its scenario and its seed."""
    if not is_table(path):
        check_bag(path)
    run = {} if is_table(path) else run_record(path)
    recorded = recorded_parameters(path, run)
    if not any(key.startswith("plant.") for key in recorded) or run.get("legs") or not _has_truth(path):
        raise OrthosisError(
            f"--next DIR: {path} is no run of one emulated joint by `run`; give a FILE.csv to follow"
        )
    machine, scenario = machine_of(path, run), run.get("scenario", "")
    if not machine.experiments:
        raise OrthosisError(f"--next: there are experiments for the knee, none for the {machine.name}")
    motion = {key for key in scenario_overrides(scenario) if key.startswith(OF_MOTION)}
    kept = {key: value for key, value in recorded.items() if key not in motion}
    with naming(path):
        return load(kept, machine), scenario, int(recorded["scenario.seed"])


def _has_truth(path: Path) -> bool:
    with open_bag(path) as opened:
        return f"/{TRUTH}" in opened.topics
