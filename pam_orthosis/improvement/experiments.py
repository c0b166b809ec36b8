# SPDX-License-Identifier: Apache-2.0
"""What is recorded to learn from and to judge by, and the recording of it in one process, without ROS."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pam_orthosis.bag.arrays import write_arrays
from pam_orthosis.bag.record import run_metadata
from pam_orthosis.bag.topics import SIGNALS
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model.parameters import Parameters, scenario_overrides

NANOSECONDS = 1e9
NOT_WRITTEN = {"disturbance", "followed_angle"}  # `write_arrays` knows no wrench and no second point
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
    """Return the experiments of a round: gait at three cadences, free decay after fast steps.

    The decay parts friction from hysteresis and shows damping and masses; one cadence and other levels of
    the decay are held out. Whoever wears the orthosis wears it in all of them.
    """
    cycle, seed = parameters.scenario.cycle_time, 100 * (parameters.scenario.seed + 1)
    decay = {k: v for k, v in scenario_overrides(DECAY).items() if k != "scenario.control_period"}
    decay["scenario.duration"] = ONCE

    def gait(share: float, duration: float) -> dict[str, Any]:
        return {"scenario.cycle_time": share * cycle, "scenario.duration": duration}

    return [
        Experiment("gait", gait(1.0, SETTLING + 3.5 * cycle), seed),
        Experiment("gait-faster", gait(0.7, SETTLING + 3.5 * cycle), seed + 1),
        Experiment("decay", decay, seed + 2),
        Experiment("held-out-gait", gait(0.85, SETTLING + 2.5 * cycle), seed + 3, True),
        Experiment("held-out-decay", {**decay, **LEVELS}, seed + 4, True),
    ]


def record(parameters: Parameters, seed: int, scenario: str, folder: Path) -> None:
    """Run the closed loop for `scenario.duration` and write a bag.

    Raises:
        OrthosisError: the folder holds a bag or cannot be written.
    """
    period = parameters.scenario.control_period
    run = ClosedLoop(parameters, seed).run(round(parameters.scenario.duration / period))
    signals = {name: values for name, values in run.items() if name in SIGNALS.keys() - NOT_WRITTEN}
    signals |= {f"estimate_{name}": run[f"estimated_{name}"] for name in ("angle", "velocity")}
    stamps = np.round(run["time"] * NANOSECONDS).astype(np.int64)
    own = parameters.changed({"scenario.seed": seed})
    write_arrays(folder, stamps, signals, run_metadata(own, scenario), own.control.position.every)
