# SPDX-License-Identifier: Apache-2.0
"""Two rates in one cascade: the position controller may work at each n-th control period only."""

from __future__ import annotations

from pam_orthosis.model.parameters import Parameters


def position_belief(parameters: Parameters) -> Parameters:
    """Return the belief of the position controller, whose control period is that of its own instants, s."""
    belief, every = parameters.belief(), parameters.control.position.every
    if every == 1:
        return belief
    return belief.substituted({"scenario.control_period": every * belief.scenario.control_period})
