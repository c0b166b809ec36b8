# SPDX-License-Identifier: Apache-2.0
"""The derivative of the investigated muscle's force in Eq. (10): neglected, differentiated, or observed."""

from dataclasses import dataclass

import numpy as np

from pam_orthosis.bag.tracking import rms
from pam_orthosis.control.linearisation import FORCE_RATES
from pam_orthosis.control.rig_loop import Rig, RigSample, force_procedure
from pam_orthosis.model.parameters import load
from pam_orthosis.progress import Progress, counted, silent

CHOICE = "rig.position.force_rate"
STILL = 1.0e-4  # m/s of the reference: the carriage rests


@dataclass(frozen=True)
class ForceRate:
    """The rig's loop with one choice for the derivative.

    Attributes:
        choice: one of `FORCE_RATES`.
        noise: standard deviation of derivative less true one while the carriage rests, N/s.
        lag: of the derivative behind the true one, s; None: there is none.
        rate_error: RMS of derivative less true one while the carriage moves, N/s.
        force_error: RMS of m_S (desired less true acceleration) while it moves: the force that it misses, N.
        position_error: largest desired less true position, m.
    """

    choice: str
    noise: float
    lag: float | None
    rate_error: float
    force_error: float
    position_error: float


def compared(progress: Progress = silent) -> list[ForceRate]:
    """Run the procedure of section 2.5 at one pressure with each choice."""
    return [measured(choice) for choice in counted(list(FORCE_RATES), progress, "rig: force derivative")]


def measured(choice: str) -> ForceRate:
    """Run the procedure of section 2.5 at one pressure with a choice for the derivative."""
    p = load({CHOICE: choice})
    samples = list(force_procedure(Rig(p, "dmsp_20", seed=1), 4.0e5))
    return judged(choice, samples, p.rig.control_period, p.rig.carriage_mass)


def judged(choice: str, samples: list[RigSample], period: float, mass: float) -> ForceRate:
    """Return what samples, a period (s) apart, say about a choice, from the first motion on."""
    first = next(number for number, s in enumerate(samples) if abs(s.reference.velocity) > STILL)
    samples = samples[first:]
    taken = np.array([s.force_rate for s in samples])
    true = np.gradient(np.array([s.truth.specimen_force for s in samples]), period)
    wanted = np.array([s.reference for s in samples])
    moving = np.abs(wanted[:, 1]) > STILL
    since = np.convolve(moving, np.ones(round(0.3 / period)))[: len(moving)]
    acceleration = np.gradient(np.array([s.truth.velocity for s in samples]), period)
    positions = np.array([s.truth.position for s in samples])
    missed = mass * (wanted[:, 2] - acceleration)[moving]
    return ForceRate(
        choice,
        noise=float((taken - true)[since == 0].std()),
        lag=lag(true, taken, period) if taken.any() else None,
        rate_error=rms((taken - true)[moving]),
        force_error=rms(missed),
        position_error=float(np.abs(wanted[:, 0] - positions).max()),
    )


def lag(true: np.ndarray, late: np.ndarray, period: float) -> float:
    """Return how late a signal repeats another one, s: the shift that leaves the least difference."""
    time = period * np.arange(len(true))
    shifts = np.arange(0.0, 0.1, period / 2)
    left = [rms(late - np.interp(time - shift, time, true)) for shift in shifts]
    return float(shifts[int(np.argmin(left))])
