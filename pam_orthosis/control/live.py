# SPDX-License-Identifier: Apache-2.0
"""Keys of the parameters that controllers take while they run, without becoming inconsistent.

It loads no mathematics: nodes that need none declare their parameters by it too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pam_orthosis.model.machine import Machine

GAINS = ("control.position.c1", "control.position.c2")
PRESSURE = ("control.pressure.gain", "control.pressure.reference_filter")
_MODES = ("mode", "stiffness", "damping", "tunnel", "learning", "forgetting")
COOPERATION = (
    *(f"control.cooperation.{name}" for name in _MODES),
    *("control.limits.low", "control.limits.high"),  # of the patient
)


def of_observer(machine: Machine) -> tuple[str, ...]:
    """Return the keys that the observer takes, in the order of its function's input."""
    return ("control.observer.pole", *machine.live)


def of_position(machine: Machine) -> tuple[str, ...]:
    """Return the keys that the position controller takes."""
    return (*GAINS, *of_observer(machine))


def of_cooperation(machine: Machine) -> tuple[str, ...]:
    """Return the keys that the position controller takes with the modes of cooperation."""
    return (*of_position(machine), *COOPERATION)
