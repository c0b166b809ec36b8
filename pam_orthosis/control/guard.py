# SPDX-License-Identifier: Apache-2.0
"""Guards of signals: what is unusable is bridged for a moment, then the signal counts as lost.

A guard passes what is usable on unchanged, to the last bit. What it counts is reported in `/diagnostics`.
"""

import math
from collections.abc import Iterable
from typing import Any

from pam_orthosis.control.reference import PressureReference, Valve
from pam_orthosis.model.parameters import Parameters, Section


class SignalGuard:
    """Guards one measured signal.

    A sample is unusable if it is not finite, outside what the quantity can be, or farther from the last
    usable one than the quantity can get in that time. While it is for no longer than `hold` the last usable
    one stands in (reaction: hold); then the signal is lost, for good. It is lost too when it repeats one
    value to the last bit for as long as `frozen` while what it should follow moves on.

    Args:
        low, high: limits of the plausible values.
        step: largest plausible change in a period.
        hold: periods that are bridged.
        frozen: periods of one value, and `moved`: change of what it should follow in that time.
        start: stands in if the first sample is unusable.
    """

    def __init__(
        self, low: float, high: float, step: float, hold: int, frozen: float, moved: float, start: float
    ):
        self._low, self._high, self._step = low, high, step
        self._hold, self._frozen, self._moved = hold, frozen, moved
        self.last, self._started = start, False
        self._missed = self._same = 0  # periods without a usable sample, and of one value
        self._since = 0  # periods, of the last usable sample
        self._followed: float | None = None
        self.held = 0
        self.lost = ""

    def step(self, value: float, followed: float | None = None, periods: int = 1) -> float:
        """Return the value to use; `followed` is what the signal should follow, if it should.

        The sample is so many periods later than the last. When the signal is lost, `lost` says why, and the
        last usable value is returned.
        """
        self._since += periods
        fault = self._fault(value)
        if fault:
            self._missed += periods if self._missed else 1
            self.held += 1
            if self._missed > self._hold:
                self.lost = self.lost or fault
            return self.last
        self._watch_motion(value, followed, periods)
        self.last, self._started, self._missed, self._since = value, True, 0, 0
        return value

    def trust(self) -> None:
        """Take the next usable sample for what it is, as at the start, though the signal was lost."""
        self.lost, self._started, self._followed = "", False, None
        self._missed = self._same = self._since = 0

    def _fault(self, value: float) -> str:
        if not math.isfinite(value):
            return "not finite"
        if not self._low <= value <= self._high:
            return "out of range"
        if self._started and abs(value - self.last) > self._step * self._since:
            return "jumped"
        return ""

    def _watch_motion(self, value: float, followed: float | None, periods: int) -> None:
        if followed is None or value != self.last or self._followed is None:
            self._same, self._followed = 0, followed
            return
        self._same += periods
        if self._same >= self._frozen and abs(followed - self._followed) > self._moved:
            self.lost = self.lost or "frozen"


class Overdue:
    """Notices a condition that lasts longer than it may."""

    def __init__(self, limit: int):
        self._limit = limit
        self._count = 0

    def step(self, holds: bool, periods: int = 1) -> bool:
        """Take a sample of the condition; return whether it has lasted for more than the limit, periods.

        The sample is so many periods later than the last one. Since when a condition holds that did not then
        is not known: one period counts.
        """
        self._count += periods if self._count else 1
        if not holds:
            self._count = 0
        return self._count > self._limit


class Guarded:
    """What guarded controllers share: guards, counters, and why they vent, for good or for the time being."""

    RELEASED = ""

    def __init__(self, parameters: Parameters, guards: dict[str, SignalGuard]):
        self._guards = guards
        self._unusable = overdue(parameters.control.guard.hold_time, parameters)
        self._vent = ""
        self._loose = False
        self._limited = self._vented = 0

    def health(self) -> dict[str, Any]:
        """Return the counters of the reactions and why it vents; zero or empty while all is well."""
        return {
            "held_samples": sum(each.held for each in self._guards.values()),
            "limited_samples": self._limited,
            "vented_samples": self._vented,
            "vent": self._vent or (self.RELEASED if self._loose else ""),
        }

    @property
    def latched(self) -> str:
        """Why it vents until somebody acts, if it does."""
        return self._vent

    def reset(self) -> None:
        """Vent for good no longer: trust each signal until it is lost again."""
        self._vent = ""
        for each in self._guards.values():
            each.trust()

    def _command_held(self, command: Iterable[PressureReference], periods: int) -> bool:
        """Return whether a command is unusable and to be held; vent if that lasts."""
        broken = not all(math.isfinite(number) for number in command if number is not Valve.CLOSED)
        self._limited += broken
        if self._unusable.step(broken, periods):
            self._vent = self._vent or "command not finite"
        return broken

    def _finite(self, what: str, *results: PressureReference) -> bool:
        """Return whether results are finite; vent for good if not."""
        good = all(math.isfinite(number) for number in results if number is not Valve.CLOSED)
        if not good:
            self._vent = self._vent or f"{what} not finite"
        return good

    def _watch(self, late: bool, caught_up: bool) -> None:
        """Let go what does not follow; take hold of it again when it is caught up with."""
        self._loose = late or (self._loose and not caught_up)

    def _venting(self) -> bool:
        """Return whether to vent, and count it."""
        lost = [f"{name} {each.lost}" for name, each in self._guards.items() if each.lost]
        self._vent = self._vent or (lost[0] if lost else "")
        venting = bool(self._vent) or self._loose
        self._vented += venting
        return venting


def driven(voltage: float, valve: Section) -> float:
    """Return what a valve's drive makes of a voltage, V: within its range, the vent's if it is no number."""
    least: float = valve.minimum_voltage
    most: float = valve.maximum_voltage
    return min(max(voltage, least), most) if math.isfinite(voltage) else least


def position_guard(parameters: Parameters) -> SignalGuard:
    """Return the guard of the measured position of the coordinate."""
    g = parameters.control.guard
    period = parameters.scenario.control_period
    machine = parameters.declared
    mechanism = machine.mechanism(parameters)
    low, high = mechanism.limits
    frozen = math.inf if mechanism.locked else _samples(g.frozen_time, period)
    return SignalGuard(
        low - g.angle_margin, high + g.angle_margin, g.angle_rate * period,
        _samples(g.hold_time, period), frozen, g.angle_motion, parameters.at(machine.start),
    )  # fmt: skip


def pressure_guard(parameters: Parameters) -> SignalGuard:
    """Return the guard of a measured pressure."""
    g, period = parameters.control.guard, parameters.scenario.control_period
    return SignalGuard(
        g.lowest_pressure, parameters.valve.supply_pressure + g.pressure_margin, g.pressure_rate * period,
        _samples(g.hold_time, period), _samples(g.frozen_time, period), g.pressure_motion,
        parameters.valve.ambient_pressure,
    )  # fmt: skip


def overdue(seconds: float, parameters: Parameters) -> Overdue:
    """Return what notices a condition that lasts longer than this."""
    return Overdue(_samples(seconds, parameters.scenario.control_period))


def _samples(seconds: float, period: float) -> int:
    return max(1, round(seconds / period))
