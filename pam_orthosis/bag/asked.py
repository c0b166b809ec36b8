# SPDX-License-Identifier: Apache-2.0
"""What the references of a run ask for beside a motion."""

from __future__ import annotations

from pam_orthosis.bag.topics import MEAN_PRESSURE, PLANNED
from pam_orthosis.control.diagnostic import EXPERIMENTS
from pam_orthosis.model.parameters import Parameters


def asked_beside(parameters: Parameters) -> tuple[str, ...]:
    """Return the optional topics of a run: experiments ask for a mean pressure, plans for a motion too."""
    scenario = parameters.scenario
    if scenario.trajectory in EXPERIMENTS:
        return (MEAN_PRESSURE,)
    return (MEAN_PRESSURE, PLANNED) if scenario.plan.enabled else ()
