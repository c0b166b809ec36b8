# SPDX-License-Identifier: Apache-2.0
"""Stage 1: are these recordings fit for a search, and what can they not tell?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pam_orthosis.discrepancy.data import Recording
from pam_orthosis.discrepancy.system import System
from pam_orthosis.errors import OrthosisError

LEAST_SAMPLES = 500
LEAST_LEVELS = 8  # distinct values of a channel that is alive
LEAST_MOTION = 20  # range of a channel over its noise
HELD_SHARE = 0.9  # of samples that repeat the one before: recorded at a lower rate than stamped


def check(system: System, recordings: Sequence[Recording], warm_up: float) -> list[str]:
    """Return remarks on what the recordings cannot show.

    Raises:
        OrthosisError: a recording is unfit, with the reason.
    """
    remarks: list[str] = []
    for one in recordings:
        if one.samples * one.period < 2 * warm_up + 1.0 or one.samples < LEAST_SAMPLES:
            raise OrthosisError(
                f"{one.name} lasts {one.duration:.1f} s: the search needs more than {2 * warm_up + 1.0:.0f} s"
                " (gap.replay.warm_up is left out at the start)"
            )
        for channel in system.channels:
            _check_channel(one, channel.name)
        remarks += [*one.remarks, *_remarks_on_inputs(system, one)]
    return remarks


def check_divisible(recordings: Sequence[Recording], share: float, warm_up: float) -> None:
    """Check that a share of each recording is long enough to judge by.

    Raises:
        OrthosisError: a recording is too short to be divided.
    """
    least = (warm_up + 1.0) / share
    for one in recordings:
        if one.duration < least:
            raise OrthosisError(
                f"{one.name} lasts {one.duration:.1f} s: too short to judge by its last {share:.0%}; record"
                f" {least:.0f} s or more, or name another recording with --held-out"
            )


def missing_inputs(system: System, recordings: Sequence[Recording]) -> list[str]:
    """Return the inputs that some recording does not have."""
    return [name for name in system.inputs if any(name not in one.signals for one in recordings)]


def _check_channel(one: Recording, name: str) -> None:
    values = one.signals[name]
    if len(np.unique(values)) < LEAST_LEVELS:
        raise OrthosisError(
            f"{one.name}: {name} hardly changes ({len(np.unique(values))} values): stuck sensor?"
        )
    repeated = float(np.mean(np.diff(values) == 0))
    if repeated > HELD_SHARE:
        raise OrthosisError(
            f"{one.name}: {100 * repeated:.0f} % of the samples of {name} repeat the one before; it was"
            " recorded at a lower rate than its stamps say"
        )


def _remarks_on_inputs(system: System, one: Recording) -> list[str]:
    remarks = []
    for name in system.inputs:
        if name not in one.signals:
            remarks.append(f"{one.name} has no {name}: what it drives cannot be judged")
        elif np.ptp(one.signals[name]) == 0:
            remarks.append(f"{one.name}: {name} never changes")
    return remarks
