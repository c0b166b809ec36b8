# SPDX-License-Identifier: Apache-2.0
"""The controllers behind guards: whatever comes in, finite commands within the limits go out.

Three reactions, the mildest that is safe: *hold* bridges some unusable samples with the last usable one,
*limited* cuts what is asked for to what is allowed, *vent* lets the air out: for good when a signal is
lost, for the time being while knee or pressure do not follow. The position controller asks for it by a
reference pressure of the ambient, which every later controller understands, and leads the knee back to its
reference afterwards. Without faults each returns what its controller returns, to the last bit.
"""

from __future__ import annotations

import math
from typing import Any

from pam_orthosis.control import guard
from pam_orthosis.control.inverse_valve import InverseValveModel
from pam_orthosis.control.position import PositionCommand, PositionController
from pam_orthosis.control.pressure import PressureController
from pam_orthosis.control.rates import position_belief
from pam_orthosis.control.returning import Release, Return, empty_below, vented
from pam_orthosis.control.trajectory import VALVES_CLOSED, Reference

NEAR = 0.2  # of the largest error: what is followed is caught up with
SILENT_PERIODS = 20  # without a sample, after which valves have vented by themselves
VENT_FLOW = -1.0  # kg/s: far more than a valve can pass, so that it opens fully


class _Guarded:
    """What the three have in common: guards, counters, and why they vent, for good or for the time being."""

    RELEASED = ""

    def __init__(self, parameters, guards: dict[str, guard.SignalGuard]):
        self._guards = guards
        self._unusable = guard.overdue(parameters.control.guard.hold_time, parameters)
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

    def _command_held(self, numbers) -> bool:
        """Return whether a command is unusable and to be held; vent if that lasts."""
        broken = not all(map(math.isfinite, numbers))
        self._limited += broken
        if self._unusable.step(broken):
            self._vent = self._vent or "command not finite"
        return broken

    def _finite(self, what: str, *numbers: float) -> bool:
        """Return whether results are finite; vent for good if not."""
        good = all(map(math.isfinite, numbers))
        if not good:
            self._vent = self._vent or f"{what} not finite"
        return good

    def _watch(self, overdue: bool, caught_up: bool) -> None:
        """Let go what does not follow; take hold of it again when it is caught up with."""
        self._loose = overdue or (self._loose and not caught_up)

    def _venting(self) -> bool:
        """Return whether to vent, and count it."""
        lost = [f"{name} {each.lost}" for name, each in self._guards.items() if each.lost]
        self._vent = self._vent or (lost[0] if lost else "")
        venting = bool(self._vent) or self._loose
        self._vented += venting
        return venting


class GuardedPosition(_Guarded):
    """The position controller behind guards of its measurements and its reference.

    A reference beyond the joint's limits is limited to them, an unusable one held. It vents for good when
    a signal is lost. It releases the knee when that is far from its reference, or much faster or slower, or
    when a muscle has not the pressure that was asked for, for too long. A knee that was released, and one
    that is found vented or far from its reference at the start, is led back (`Return`). When so many
    returns in a row have failed it stays released, until something else has vented the muscles meanwhile:
    an emergency stop, say.
    """

    def __init__(self, parameters, controller: PositionController):
        belief = position_belief(parameters)
        guards = {"angle": guard.angle_guard(belief)}
        guards |= {f"{name} pressure": guard.pressure_guard(belief) for name in ("extensor", "flexor")}
        super().__init__(belief, guards)
        g, joint = belief.control.guard, belief.leg.joint
        self._belief, self._controller = belief, controller
        self._low, self._high = joint.minimum, joint.maximum
        self._reference = Reference(belief.scenario.start_angle, 0.0, 0.0)
        self._distance, self._speed = g.tracking_error, g.velocity_error
        self._pressure_error = g.pressure_error
        self._ambient = belief.valve.ambient_pressure
        self._watch_anew()
        self._begun, self._trusted = False, guard.overdue(g.trust_time, belief)
        self._most, self._failed, self._returns = g.returns, 0, 0
        self._release: Release | None = None
        self._return: Return | None = None

    def health(self) -> dict[str, Any]:
        """Return what the guards did, and how often the knee was led back or is just now."""
        return {**super().health(), "returns": self._returns, "returning": self._return is not None}

    def retune(self, parameters) -> None:
        """Pass new values on to the controller."""
        self._controller.retune(parameters)

    def step(
        self,
        angle: float,
        extensor_pressure: float,
        flexor_pressure: float,
        reference: Reference,
        periods: int = 1,
    ) -> PositionCommand:
        """Return the reference pressures for one sample, whatever the numbers are.

        It is so many of the position controller's periods later than the last one.
        """
        desired = reference.angle
        if reference.planned_angle is not None:
            reference = reference.followed()
        reference = self._usable(reference)
        follows = self._release is None and self._return is None
        angle = self._guards["angle"].step(angle, reference.angle if follows else None, periods)
        extensor = self._guards["extensor pressure"].step(extensor_pressure, periods=periods)
        flexor = self._guards["flexor pressure"].step(flexor_pressure, periods=periods)
        pressures = extensor, flexor
        driven = reference.mean_pressure != VALVES_CLOSED
        away = min(abs(aim - angle) for aim in (reference.angle, desired))  # a plan begins anywhere near
        if driven and self._is_astray(away, pressures, periods):
            self._lead_back(pressures)
        wanted = self._way(reference, angle, periods)
        command = self._controller.step(angle, *pressures, wanted, periods)
        if not self._finite("estimate", *command[:6]):
            command = PositionCommand(self._ambient, self._ambient, angle, 0.0, 0.0, 0.0, False, False)
        if driven:
            command = self._judged(command, wanted, angle, pressures, periods)
        if self._venting():
            asked = self._ambient if self._vent or self._release is None else self._release.asked
            return command._replace(extensor_pressure=asked, flexor_pressure=asked)
        return command

    def _is_astray(self, away: float, pressures, periods: int) -> bool:
        """Whether the knee may be anywhere, at the start or after a long silence, and is not at its place."""
        first, self._begun = not self._begun, True
        if self._release is not None or not (first or periods >= SILENT_PERIODS):
            return False
        return vented(pressures, self._belief) or away > NEAR * self._distance

    def _way(self, reference: Reference, angle: float, periods: int) -> Reference:
        """Return what the controller is to follow."""
        if reference.mean_pressure == VALVES_CLOSED:
            return reference
        if self._release is not None:
            return Reference(angle, 0.0, 0.0, reference.mean_pressure)
        return reference if self._return is None else self._return.reference(angle, reference, periods)

    def _judged(
        self, command: PositionCommand, wanted: Reference, angle: float, pressures, periods: int
    ) -> PositionCommand:
        """Return the command as it rises, after a look at knee and muscles; release what does not follow."""
        if self._release is not None:
            if self._release.step(pressures, command.velocity, periods):
                self._try_again(pressures)
            elif self._release.held_empty:
                self._failed = 0  # what fails is not the return
            return command
        if self._return is not None:
            extensor, flexor = self._return.pressures(command[:2])
            command = command._replace(extensor_pressure=extensor, flexor_pressure=flexor)
        self._watch_motion(wanted, angle, command, pressures, periods)
        if self._return is not None and self._return.over:
            self._return = None
        if self._trusted.step(self._failed > 0 and self._return is None, periods):
            self._failed = 0
        return command

    def _watch_motion(self, wanted: Reference, angle: float, command, pressures, periods: int) -> None:
        away, faster = abs(wanted.angle - angle), abs(command.velocity - wanted.velocity)
        far = self._far.step(away > self._distance, periods)
        swings = self._swings.step(faster > self._speed)
        short = any(map(self._is_short, command[:2], pressures))
        if far or swings or self._unfilled.step(short, periods):
            self.RELEASED = "knee does not follow" if far or swings else "pressure does not follow"
            self._loose, self._release, self._return = True, Release(self._belief), None
            self._failed += 1

    def _is_short(self, asked: float, pressure: float) -> bool:
        """Whether a muscle has not what is asked for: of a low pressure half is missed already."""
        least = 0.5 * (asked + self._ambient)
        return abs(asked - pressure) > self._pressure_error or pressure < least

    def _try_again(self, pressures) -> None:
        if self._failed > self._most:
            self.RELEASED = f"knee does not follow, given up after {self._most} returns"
        else:
            self._lead_back(pressures)

    def _lead_back(self, pressures) -> None:
        self._controller.restart()
        self._watch_anew()
        self._loose, self._release, self._return = False, None, Return(pressures, self._belief)
        self._returns += 1

    def _watch_anew(self) -> None:
        g = self._belief.control.guard
        self._far = guard.overdue(g.tracking_time, self._belief)
        self._swings = guard.overdue(g.hold_time, self._belief)
        self._unfilled = guard.overdue(g.pressure_time, self._belief)

    def _usable(self, reference: Reference) -> Reference:
        if self._command_held(number for number in reference[:4] if number is not None):
            return self._reference._replace(velocity=0.0, acceleration=0.0)
        if not self._low <= reference.angle <= self._high:
            self._limited += 1
            nearest = min(max(reference.angle, self._low), self._high)
            reference = reference._replace(angle=nearest, velocity=0.0, acceleration=0.0)
        self._reference = reference
        return reference


class GuardedPressure(_Guarded):
    """The pressure controller of one muscle behind guards.

    A reference beyond the limits is limited, and that of the ambient vents, whatever the sensor shows. It
    vents for good when its signal is lost, and while the pressure is far from its reference for too long.
    An empty muscle's pressure that stands still is no lost signal: something else may keep it vented.
    """

    RELEASED = "pressure does not follow"

    def __init__(self, parameters, controller: PressureController):
        belief = parameters.belief()
        super().__init__(belief, {"pressure": guard.pressure_guard(belief)})
        g = belief.control.guard
        self._controller = controller
        self._low, self._high = belief.valve.ambient_pressure, belief.control.position.maximum_pressure
        self._distance, self._far = g.pressure_error, guard.overdue(g.pressure_time, belief)
        self._empty = empty_below(belief)
        self._wanted = (VALVES_CLOSED, belief.scenario.start_angle, 0.0)

    def retune(self, parameters) -> None:
        """Pass new values on to the controller."""
        self._controller.retune(parameters)

    def step(
        self,
        pressure: float,
        reference: float,
        angle: float,
        velocity: float,
        periods: int = 1,
        age: float = 0.0,
    ) -> float:
        """Return the mass flow into the muscle, kg/s, finite whatever the numbers are.

        The sample is so many control periods later than the last one; reference and estimate are so old, s.
        """
        wanted = self._usable(reference, angle, velocity)
        followed = None if wanted[0] == VALVES_CLOSED else wanted[0]
        pressure = self._guards["pressure"].step(
            pressure, None if pressure < self._empty else followed, periods
        )
        away = 0.0 if followed is None else abs(followed - pressure)
        self._watch(self._far.step(away > self._distance, periods), away < NEAR * self._distance)
        flow = self._controller.step(pressure, *wanted, periods, age)
        good = self._finite("mass flow", flow)
        return VENT_FLOW if self._venting() or not good or followed == self._low else flow

    def _usable(self, *wanted: float) -> tuple[float, ...]:
        if self._command_held(wanted):
            return self._wanted
        reference, *estimate = wanted
        if reference != VALVES_CLOSED and not self._low <= reference <= self._high:
            self._limited += 1
            reference = min(max(reference, self._low), self._high)
        self._wanted = (reference, *estimate)
        return self._wanted


class GuardedValve(_Guarded):
    """The inverse valve model behind guards: no voltage leaves it that is not finite and in range."""

    def __init__(self, parameters, model: InverseValveModel):
        belief = parameters.belief()
        super().__init__(belief, {"pressure": guard.pressure_guard(belief)})
        self._model = model
        self._low, self._high = belief.valve.minimum_voltage, belief.valve.maximum_voltage
        self._flow = 0.0

    def step(self, mass_flow: float, pressure: float, periods: int = 1) -> float:
        """Return the valve voltage, V, finite and in range whatever the numbers are.

        The sample is so many control periods later than the last one.
        """
        flow = self._usable(mass_flow)
        pressure = self._guards["pressure"].step(pressure, periods=periods)
        voltage = self._model.step(flow, pressure, periods)
        good = self._finite("voltage", voltage)
        return self._low if self._venting() or not good else min(max(voltage, self._low), self._high)

    def _usable(self, mass_flow: float) -> float:
        if not self._command_held((mass_flow,)):
            self._flow = min(max(mass_flow, VENT_FLOW), -VENT_FLOW)
            self._limited += self._flow != mass_flow
        return self._flow
