# SPDX-License-Identifier: Apache-2.0
"""The experiment that would help next, done by the node graph on the emulated hardware of a recording."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from pam_orthosis.bag.bounded import open_bag
from pam_orthosis.bag.read import machine_of, recorded_parameters, run_record
from pam_orthosis.bag.topics import TRUTH
from pam_orthosis.cli.run import need_ros, run_graph
from pam_orthosis.discrepancy.systems.knee import ALONE
from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import filled
from pam_orthosis.model.parameters import Parameters, experiments, load, scenario_overrides
from pam_orthosis.nodes.launch import Mode
from pam_orthosis.tables import is_table

BAGS = "fitted", "held_out"


class Emulated(NamedTuple):
    """The emulated hardware that recordings are of, with its controllers.

    `done`: scenarios of these; `repeated`: whether the graph has added one.
    """

    parameters: Parameters
    done: frozenset[str]
    repeated: bool = False

    def having(self, name: str) -> Emulated:
        """Return the same with one more experiment done."""
        return self._replace(done=self.done | {name}, repeated=True)

    @property
    def experiments(self) -> list[str]:
        """The diagnostic experiments whose recordings can be used beside those that there are."""
        return [name for name in experiments() if name not in self.done and self._fits(name)]

    def _fits(self, name: str) -> bool:
        changes = self.parameters.changed(scenario_overrides(name))
        return all(changes.at(key) == self.parameters.at(key) for key in ALONE)

    def record(self, name: str, folder: Path, judged: bool) -> list[Path]:
        """Record an experiment into a new folder, to fit and, if `judged`, again to judge; return the bags.

        Raises:
            OrthosisError: the folder is used, or a run failed; then there is no folder.
        """
        experiment = self.parameters.changed(scenario_overrides(name))
        bags = BAGS[: 1 + judged]
        with filled(folder) as part:
            for number, bag in enumerate(bags, 1):
                seed = {"scenario.seed": self.parameters.scenario.seed + number}
                run_graph(experiment.changed(seed), (part / bag).resolve(), name, Mode(composed=True))
        return [folder / bag for bag in bags]


def emulated(paths: Iterable[Path], namespace: str) -> Emulated:
    """Return the emulated hardware of recordings, which only the graph is told of, never a search.

    Raises:
        OrthosisError: they are not of one joint that the graph emulated alike, or there is no ROS.
    """
    need_ros()
    if namespace:
        raise OrthosisError("--next DIR: the graph repeats runs of one joint, without --namespace")
    runs = {path: _run_of(path) for path in paths}
    (first, (parameters, _)), *others = runs.items()
    for path, (other, _) in others:
        if _hardware(other) != _hardware(parameters):
            raise OrthosisError(f"--next DIR: {first} and {path} are of different emulated hardware")
    return Emulated(parameters, frozenset(name for _, name in runs.values()))


def _hardware(parameters: Parameters) -> dict[str, Any]:
    return {key: value for key, value in parameters.flat().items() if key.startswith("plant.")}


def _run_of(path: Path) -> tuple[Parameters, str]:
    """Return what a bag of the graph was run with, but for its scenario's settings, and the scenario."""
    run = {} if is_table(path) else run_record(path)
    if not run or not _has_truth(path):
        raise OrthosisError(
            f"--next DIR: the graph did not emulate the hardware of {path}; give a FILE.csv to follow"
        )
    scenario = run.get("scenario", "")
    set_by_it: dict[str, Any] = scenario_overrides(scenario)
    recorded = recorded_parameters(path, run)
    kept = {key: value for key, value in recorded.items() if key not in set_by_it}
    return load(kept, machine_of(path, run)), scenario


def _has_truth(path: Path) -> bool:
    with open_bag(path) as opened:
        return f"/{TRUTH}" in opened.topics
