# SPDX-License-Identifier: Apache-2.0
"""What is recorded to learn from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from pam_orthosis.model.parameters import Parameters, scenario_overrides

LEVELS = {"scenario.diagnostic.low_angle": 0.45, "scenario.diagnostic.high_angle": 1.0}
DECAY = "diagnostic-decay"
ONCE = 11.0  # s, in which the experiment of the decay runs through once
SETTLING = 3.0  # s, until the gait has its cadence


class Experiment(NamedTuple):
    """A recording to make: what is set beside the run's own parameters, seed, whether it is held out."""

    name: str
    changes: Mapping[str, Any]
    seed: int
    held_out: bool = False


def experiments(parameters: Parameters) -> list[Experiment]:
    """Return the experiments of a round: three cadences, and free decays if the machine has experiments.

    The decay parts friction from hysteresis and shows damping and masses; one cadence and other levels of
    the decay are held out. Whoever wears the orthosis wears it in all of them.
    """
    cycle, seed = parameters.scenario.cycle_time, 100 * (parameters.scenario.seed + 1)
    decay = {k: v for k, v in scenario_overrides(DECAY).items() if k != "scenario.control_period"}
    decay["scenario.duration"] = ONCE

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
