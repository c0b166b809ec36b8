# SPDX-License-Identifier: Apache-2.0
"""The optional topics of a run: what its references ask for beside a motion, and its safety monitor."""

from __future__ import annotations

from pam_orthosis.bag.topics import ALLOWED, MEAN_PRESSURE, PLANNED
from pam_orthosis.control.diagnostic import EXPERIMENTS
from pam_orthosis.model.parameters import Parameters


def asked_beside(parameters: Parameters) -> tuple[str, ...]:
    """Return the optional topics of a run: experiments ask for a mean pressure, plans for a motion too."""
    scenario = parameters.scenario
    watched = (ALLOWED,) if parameters.control.limits.enabled else ()
    if scenario.trajectory in EXPERIMENTS:
        return (MEAN_PRESSURE, *watched)
    return (MEAN_PRESSURE, PLANNED, *watched) if scenario.plan.enabled else watched
