# SPDX-License-Identifier: Apache-2.0
"""Fig. 9: the knee follows the gait; error over time and over the gait cycle, and where each step begins."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.bag.tracking import REST_SECONDS, rests, rms
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model import parameters as tree

CYCLES = 5  # whole cycles at full cadence
BRISK = 0.1  # of the time, in which the reference accelerates or decelerates most


@dataclass(frozen=True)
class Tracking:
    """The gait without a person on the emulated hardware; angles in degrees.

    Attributes:
        parameters: of the run.
        time, reference, angle, error: (n,); error = reference - measured angle.
        phase: (n,) of the gait cycle from heel strike, counted on from cycle to cycle; NaN while the
            cadence rises.
        beginnings: mean |error| at the beginning of each step, where the knee turns about heel strike.
        rests: the same of each step of the scenario `steps`, at the end of the rest before it.
    """

    parameters: Any
    time: np.ndarray
    reference: np.ndarray
    angle: np.ndarray
    error: np.ndarray
    phase: np.ndarray
    beginnings: np.ndarray
    rests: np.ndarray

    @property
    def largest(self) -> float:
        """The largest |error|."""
        return float(np.abs(self.error).max())

    @property
    def rms(self) -> float:
        """The root of the mean squared error."""
        return rms(self.error)

    @property
    def worst_phase(self) -> float:
        """Where in the gait cycle the largest |error| lies, once the cadence is reached."""
        return float(self.phase[np.nanargmax(np.where(np.isnan(self.phase), np.nan, np.abs(self.error)))] % 1)

    @property
    def accelerated(self) -> float:
        """The largest |error| in the share `BRISK` of the time in which the reference accelerates most."""
        period = self.time[1] - self.time[0]
        acceleration = np.abs(np.gradient(np.gradient(self.reference, period), period))
        most = acceleration >= np.nanquantile(np.where(np.isnan(self.phase), np.nan, acceleration), 1 - BRISK)
        return float(np.abs(self.error[most & ~np.isnan(self.phase)]).max())


def track() -> Tracking:
    """Let the knee walk as the default scenario does, for some whole cycles, and step from rest to rest."""
    p = tree.load()
    s = p.scenario
    begin = s.start_hold + s.start_ramp / 2  # the rise of the cadence covers half of what a step would
    run = ClosedLoop(p, seed=1).run(round((begin + CYCLES * s.cycle_time) / s.control_period))
    error = np.degrees(run["reference_angle"] - run["angle"])
    phase = s.start_phase + (run["time"] - begin) / s.cycle_time
    phase[run["time"] < s.start_hold + s.start_ramp] = np.nan
    return Tracking(
        p, run["time"], np.degrees(run["reference_angle"]), np.degrees(run["angle"]), error, phase,
        turning_errors(run["time"], error, run["reference_velocity"], phase), stepped(),
    )  # fmt: skip


def stepped() -> np.ndarray:
    """Let the knee step from rest to rest; return `Tracking.rests`."""
    p = tree.load(tree.scenario_overrides("steps"))
    s = p.scenario
    seconds = s.start_hold + s.start_ramp + CYCLES * s.cycle_time
    run = ClosedLoop(p, seed=1).run(round(seconds / s.control_period))
    return resting_errors(
        np.round(run["time"] * SECOND_NS).astype(np.int64),
        np.degrees(run["reference_angle"] - run["angle"]), run["reference_velocity"],
    )  # fmt: skip


def resting_errors(stamp_ns: np.ndarray, error: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Return the mean |error| over the end of each rest that a motion follows; stamps in ns, all (n,)."""
    found = []
    for rest in rests(stamp_ns, velocity):
        if rest.stop < len(stamp_ns):
            first = np.searchsorted(stamp_ns, stamp_ns[rest.stop - 1] - REST_SECONDS * SECOND_NS)
            found.append(float(np.abs(error[first : rest.stop]).mean()))
    return np.array(found)


def turning_errors(
    time: np.ndarray, error: np.ndarray, velocity: np.ndarray, phase: np.ndarray
) -> np.ndarray:
    """Return the mean |error| about the instant nearest to each heel strike at which the reference turns.

    Time in s, all (n,); the phase is that of the gait cycle, counted on, NaN where it is not judged.
    """
    turns = np.flatnonzero(np.diff(np.sign(velocity)) != 0)
    found = []
    for strike in np.arange(np.ceil(np.nanmin(phase)), np.nanmax(phase)):
        turn = time[turns[np.nanargmin(np.abs(phase[turns] - strike))]]
        found.append(float(np.abs(error[np.abs(time - turn) <= REST_SECONDS / 2]).mean()))
    return np.array(found)
