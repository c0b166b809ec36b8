# SPDX-License-Identifier: Apache-2.0
"""Two legs that walk: the same orthosis twice, half a cycle apart."""

from __future__ import annotations

from typing import Any

from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.model.parameters import Parameters

PERIODIC = ("gait", "sine")


def differences(parameters: Parameters) -> dict[str, dict[str, Any]]:
    """Return by leg what differs from the parameters: none on the left.

    The right leg has noise of its own, and its cycle, if there is one, begins half a cycle later in
    the shape, at the angle that the shape has there.
    """
    right: dict[str, Any] = {"scenario.seed": parameters.scenario.seed + 1}
    if parameters.scenario.trajectory in PERIODIC:
        right["scenario.start_phase"] = (parameters.scenario.start_phase + 0.5) % 1.0
        right["scenario.start_angle"] = make_trajectory(parameters.changed(right)).sample(0).position
    return {"left": {}, "right": right}
