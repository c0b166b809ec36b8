# SPDX-License-Identifier: Apache-2.0
"""Two rates in one cascade: the position controller may work at each n-th control period only."""

from __future__ import annotations

from pam_orthosis.model.parameters import Parameters


def position_nominal(parameters: Parameters) -> Parameters:
    """Return the position controller's nominal model: its control period, s, is that of its own instants."""
    nominal, every = parameters.nominal(), parameters.control.position.every
    if every == 1:
        return nominal
    return nominal.substituted({"scenario.control_period": every * nominal.scenario.control_period})
