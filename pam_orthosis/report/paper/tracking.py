# SPDX-License-Identifier: Apache-2.0
"""Fig. 9: the knee follows the gait; error over time and over the gait cycle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pam_orthosis.bag.tracking import steady_state_error
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model import parameters as tree

CYCLES = 5  # whole cycles at full cadence


@dataclass(frozen=True)
class Tracking:
    """The gait without a person on the emulated hardware; angles in degrees.

    Attributes:
        parameters: of the run.
        time, reference, angle, error: (n,); error = reference - measured angle.
        phase: (n,) of the gait cycle from heel strike, counted on from cycle to cycle; NaN while the
            cadence rises.
        steady_state: mean |error| at rest before the step.
    """

    parameters: Any
    time: np.ndarray
    reference: np.ndarray
    angle: np.ndarray
    error: np.ndarray
    phase: np.ndarray
    steady_state: float

    @property
    def largest(self) -> float:
        """The largest |error|."""
        return float(np.abs(self.error).max())

    @property
    def rms(self) -> float:
        """The root of the mean squared error."""
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def worst_phase(self) -> float:
        """Where in the gait cycle the largest |error| lies, once the cadence is reached."""
        return float(self.phase[np.nanargmax(np.where(np.isnan(self.phase), np.nan, np.abs(self.error)))] % 1)


def track(overrides: Mapping[str, Any] | None = None, seed: int = 1) -> Tracking:
    """Let the knee walk as the default scenario does, for some whole cycles."""
    p = tree.load(overrides)
    s = p.scenario
    begin = s.start_hold + s.start_ramp / 2  # the rise of the cadence covers half of what a step would
    seconds = begin + CYCLES * s.cycle_time
    run = ClosedLoop(p, seed).run(round(seconds / s.control_period))
    error = np.degrees(run["reference_angle"] - run["angle"])
    stamps = np.round(run["time"] * 1e9).astype(np.int64)
    phase = s.start_phase + (run["time"] - begin) / s.cycle_time
    phase[run["time"] < s.start_hold + s.start_ramp] = np.nan
    return Tracking(
        p, run["time"], np.degrees(run["reference_angle"]), np.degrees(run["angle"]), error, phase,
        steady_state_error(stamps, error, run["reference_velocity"]),
    )  # fmt: skip
