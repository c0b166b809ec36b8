# SPDX-License-Identifier: Apache-2.0
"""Registers of the terminal: what driver and terminal have in common.

0 .. 1   knee angle, int32, millionths of a rad
2 .. 3   absolute pressure of the extensor, int32, Pa
4 .. 5   absolute pressure of the flexor, int32, Pa
6        spool of the extensor's valve, int16, ten-thousandths: -10000 vent, 0 closed, 10000 fill
7        spool of the flexor's valve
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

SENSORS, VALVES = 6, 2
UNITS = (1e-6, 1.0, 1.0)
SPOOL_UNIT = 1e-4


def of_sample(sample: Sequence[float]) -> list[int]:
    """Return the registers of an angle (rad) and two pressures (Pa)."""
    numbers = [round(value / unit) for value, unit in zip(sample, UNITS, strict=True)]
    return list(struct.unpack(">6H", struct.pack(">3i", *numbers)))


def sample_of(registers: Sequence[int]) -> tuple[float, ...]:
    """Return the angle (rad) and two pressures (Pa) of registers."""
    numbers = struct.unpack(">3i", struct.pack(">6H", *registers))
    return tuple(number * unit for number, unit in zip(numbers, UNITS, strict=True))


def of_spool(spool: float) -> int:
    """Return the register of a relative position of a spool."""
    return round(spool / SPOOL_UNIT) & 0xFFFF


def spool_of(register: int) -> float:
    """Return the relative position of a spool of a register."""
    return SPOOL_UNIT * (register - 0x10000 if register & 0x8000 else register)
