# SPDX-License-Identifier: Apache-2.0
"""Run the closed loop without ROS, with the same cores as the nodes, and write a bag of it."""

from pathlib import Path

import numpy as np

from pam_orthosis.bag.arrays import write_arrays
from pam_orthosis.bag.record import run_metadata
from pam_orthosis.bag.topics import SECOND_NS, Topics
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.parameters import Parameters


def recorded_signals(machine: Machine) -> tuple[str, ...]:
    """Return what such a bag holds: no truth, no disturbance, no plan."""
    left_out = "disturbance", f"followed_{machine.coordinate.name}"
    names = Topics(machine).signals
    return tuple(name for name in names if name not in left_out and not name.startswith("truth_"))


def record_run(parameters: Parameters, scenario: str, folder: Path) -> None:
    """Record the closed loop for `scenario.duration`; OrthosisError if the bag cannot be written."""
    settings = parameters.scenario
    period_ns = round(settings.control_period * SECOND_NS)
    steps = round(settings.duration * SECOND_NS / period_ns)
    run = ClosedLoop(parameters, settings.seed).run(steps)
    names = recorded_signals(parameters.declared)
    signals = {name: run[name] for name in names}
    every = parameters.control.position.every
    write_arrays(folder, np.arange(steps) * period_ns, signals, run_metadata(parameters, scenario), every)
