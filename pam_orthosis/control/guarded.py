# SPDX-License-Identifier: Apache-2.0
"""The controllers behind guards: whatever comes in, finite commands within the limits go out.

Three reactions, the mildest that is safe: *hold* bridges some unusable samples with the last usable one,
*limited* cuts what is asked for to what is allowed, *vent* lets the air out: for good when a signal is
lost, for the time being while joint or pressure do not follow. The position controller asks for it by a
reference pressure of the ambient, which every later controller understands, and leads the joint back to its
reference afterwards. Without faults each returns what its controller returns, to the last bit.
"""

from typing import Any

from pam_orthosis.control import guard
from pam_orthosis.control.guard import Guarded
from pam_orthosis.control.inverse_valve import InverseValveModel
from pam_orthosis.control.position import PositionCommand, PositionController, position_nominal
from pam_orthosis.control.pressure import PressureController
from pam_orthosis.control.reference import PressureReference, Pressures, Reference, Valve
from pam_orthosis.control.returning import Release, Return, empty_below, vented
from pam_orthosis.model.components.spool import as_commanded
from pam_orthosis.model.parameters import Parameters

NEAR = 0.2  # of the largest error: what is followed is caught up with
VENT_FLOW = -1.0  # kg/s: far more than a valve can pass, so that it opens fully


class GuardedPosition(Guarded):
    """The position controller behind guards of its measurements and its reference.

    A reference beyond the joint's limits is limited to them, an unusable one held. It vents for good when
    a signal is lost. It releases the joint when that is far from its reference, or much faster or slower, or
    when an actuator has not the pressure that was asked for, for too long. A joint that was released, and one
    that is found vented or far from its reference at the start, is led back (`Return`). When so many
    returns in a row have failed it stays released, until something else has vented the actuators meanwhile:
    an emergency stop, say.
    """

    def __init__(self, parameters: Parameters, controller: PositionController):
        nominal = position_nominal(parameters)
        machine = nominal.declared
        guards = {machine.coordinate.name: guard.position_guard(nominal)}
        guards |= {f"{name} pressure": guard.pressure_guard(nominal) for name in machine.names}
        super().__init__(nominal, guards)
        g, self._lost = nominal.control.guard, f"{machine.name} does not follow"
        self._nominal, self._controller = nominal, controller
        self._low, self._high = machine.mechanism(nominal).limits
        self._reference = Reference(nominal.at(machine.start), 0.0, 0.0)
        self._distance, self._speed = g.tracking_error, g.velocity_error
        self._pressure_error: float = g.pressure_error
        self._ambient = nominal.valve.ambient_pressure
        self._lowest = nominal.control.position.minimum_pressure
        self._watch_anew()
        self._begun, self._trusted = False, guard.overdue(g.trust_time, nominal)
        self._most, self._failed, self._returns = g.returns, 0, 0
        self._release: Release | None = None
        self._untold = ""
        self._return: Return | None = None

    def health(self) -> dict[str, Any]:
        """Return what the guards did, and how often the joint was led back or is just now."""
        return {**super().health(), "returns": self._returns, "returning": self._return is not None}

    @property
    def latched(self) -> str:
        """Why it vents until somebody acts, if it does: it may have given up."""
        given_up = self._release is not None and self._failed > self._most
        return super().latched or (self.RELEASED if given_up else "")

    def reset(self) -> None:
        """Lead the joint back if it was let go for good, once it rests and both actuators answer."""
        if not self.latched:
            return
        super().reset()
        self._controller.restart()
        self._watch_anew()
        self._failed, self._return, self._release = 0, None, Release(self._nominal)
        self.RELEASED, self._loose = self._lost, True

    def released(self) -> str:
        """Return why the joint was released since this was last asked, if it was."""
        reason, self._untold = self._untold, ""
        return reason

    def retune(self, parameters: Parameters) -> None:
        """Pass new values on to the controller."""
        self._controller.retune(parameters)

    def step(
        self, position: float, pressures: Pressures, reference: Reference, periods: int = 1
    ) -> PositionCommand:
        """Return the reference pressures for one sample, whatever the numbers are.

        It is so many of the position controller's periods later than the last one.
        """
        desired = reference.position
        if reference.planned is not None:
            reference = Reference(*reference.planned, reference.mean_pressure, beside=reference.beside)
        reference = self._usable(reference, periods)
        follows = self._release is None and self._return is None
        of_position, first, second = self._guards.values()
        position = of_position.step(position, reference.position if follows else None, periods)
        pressures = first.step(pressures[0], periods=periods), second.step(pressures[1], periods=periods)
        driven = reference.mean_pressure is not Valve.CLOSED
        away = min(abs(aim - position) for aim in (reference.position, desired))  # a plan begins near
        if driven and self._is_astray(away, pressures, periods):
            self._lead_back(pressures)
        wanted = self._way(reference, position, periods)
        command = self._controller.step(position, pressures, wanted, periods)
        if not self._finite("estimate", *command.pressures, *command[1:5]):
            command = PositionCommand((self._ambient, self._ambient), position, 0.0, 0.0, 0.0, False, False)
        if driven:
            command = self._judged(command, wanted, position, pressures, periods)
        if self._venting():
            asked = self._ambient if self._vent or self._release is None else self._release.asked
            return command._replace(pressures=(asked, asked), effort=0.0)
        return command

    def _is_astray(self, away: float, pressures: Pressures, periods: int) -> bool:
        """Whether the joint is not at its place, at the start or after a long silence."""
        first, self._begun = not self._begun, True
        silent_periods = 20  # without a sample, after which valves have vented by themselves
        if self._release is not None or not (first or periods >= silent_periods):
            return False
        return vented(pressures, self._nominal) or away > NEAR * self._distance

    def _way(self, reference: Reference, position: float, periods: int) -> Reference:
        """Return what the controller is to follow."""
        if reference.mean_pressure is Valve.CLOSED:
            return reference
        if self._release is not None:
            return Reference(position, 0.0, 0.0, reference.mean_pressure, beside=reference.beside)
        return reference if self._return is None else self._return.reference(position, reference, periods)

    def _judged(
        self,
        command: PositionCommand,
        wanted: Reference,
        position: float,
        pressures: Pressures,
        periods: int,
    ) -> PositionCommand:
        """Return the command as it rises, after a look at the joint; release what does not follow."""
        if self._release is not None:
            if self._release.step(pressures, command.velocity, periods):
                self._try_again(pressures)
            elif self._release.held_empty:
                self._failed = 0  # what fails is not the return
            return command
        if self._return is not None:
            command = command._replace(pressures=self._return.pressures(command.pressures))
        self._watch_motion(wanted, position, command, pressures, periods)
        if self._return is not None and self._return.over:
            self._return = None
        if self._trusted.step(self._failed > 0 and self._return is None, periods):
            self._failed = 0
        return command

    def _watch_motion(
        self,
        wanted: Reference,
        position: float,
        command: PositionCommand,
        pressures: Pressures,
        periods: int,
    ) -> None:
        away, faster = abs(wanted.position - position), abs(command.velocity - wanted.velocity)
        far = self._far.step(away > self._distance, periods)
        swings = self._swings.step(faster > self._speed, periods)
        short = any(map(self._is_short, command.pressures, pressures))
        if far or swings or self._unfilled.step(short, periods):
            self.RELEASED = self._lost if far or swings else "pressure does not follow"
            self._loose, self._release, self._return = True, Release(self._nominal), None
            self._untold = self.RELEASED
            self._failed += 1

    def _is_short(self, asked: PressureReference, pressure: float) -> bool:
        """Whether an actuator has not what is asked for: of a low pressure half is missed already.

        Less than the lowest reference is asked for only while pressures begin to rise, and lags much.
        """
        if asked is Valve.CLOSED or asked < self._lowest:
            return False
        least: float = 0.5 * (asked + self._ambient)
        return abs(asked - pressure) > self._pressure_error or pressure < least

    def _try_again(self, pressures: Pressures) -> None:
        if self._failed > self._most:
            self.RELEASED = f"{self._lost}, given up after {self._most} returns"
        else:
            self._lead_back(pressures)

    def _lead_back(self, pressures: Pressures) -> None:
        self._controller.restart()
        self._watch_anew()
        self._loose, self._release, self._return = False, None, Return(pressures, self._nominal)
        self._returns += 1

    def _watch_anew(self) -> None:
        g = self._nominal.control.guard
        self._far = guard.overdue(g.tracking_time, self._nominal)
        self._swings = guard.overdue(g.hold_time, self._nominal)
        self._unfilled = guard.overdue(g.pressure_time, self._nominal)

    def _usable(self, reference: Reference, periods: int) -> Reference:
        if self._command_held((number for number in reference[:4] if number is not None), periods):
            return self._reference._replace(velocity=0.0, acceleration=0.0)
        if not self._low <= reference.position <= self._high:
            self._limited += 1
            nearest = min(max(reference.position, self._low), self._high)
            reference = reference._replace(position=nearest, velocity=0.0, acceleration=0.0)
        self._reference = reference
        return reference


class GuardedPressure(Guarded):
    """The pressure controller of one actuator behind guards.

    A reference beyond the limits is limited, and that of the ambient vents, whatever the sensor shows. It
    vents for good when its signal is lost, and while the pressure is far from its reference for too long.
    An empty actuator's pressure that stands still is no lost signal: something else may keep it vented.
    """

    RELEASED = "pressure does not follow"

    def __init__(self, parameters: Parameters, controller: PressureController):
        nominal = parameters.nominal()
        super().__init__(nominal, {"pressure": guard.pressure_guard(nominal)})
        g = nominal.control.guard
        self._controller = controller
        self._low = nominal.valve.ambient_pressure
        self._high = nominal.control.position.maximum_pressure
        self._distance, self._far = g.pressure_error, guard.overdue(g.pressure_time, nominal)
        self._empty = empty_below(nominal)
        self._wanted: PressureReference = Valve.CLOSED
        self._estimate = nominal.at(nominal.declared.start), 0.0

    def retune(self, parameters: Parameters) -> None:
        """Pass new values on to the controller."""
        self._controller.retune(parameters)

    def step(
        self,
        pressure: float,
        reference: PressureReference,
        position: float,
        velocity: float,
        periods: int = 1,
        age: float = 0.0,
    ) -> float:
        """Return the mass flow into the actuator, kg/s, finite whatever the numbers are.

        The sample is so many control periods later than the last one; reference and estimate are so old, s.
        """
        self._take(reference, position, velocity, periods)
        wanted = self._wanted
        followed = None if wanted is Valve.CLOSED else wanted
        pressure = self._guards["pressure"].step(
            pressure, None if pressure < self._empty else followed, periods
        )
        away = 0.0 if followed is None else abs(followed - pressure)
        self._watch(self._far.step(away > self._distance, periods), away < NEAR * self._distance)
        flow = self._controller.step(pressure, wanted, *self._estimate, periods, age)
        good = self._finite("mass flow", flow)
        return VENT_FLOW if self._venting() or not good or followed == self._low else flow

    def _take(self, reference: PressureReference, position: float, velocity: float, periods: int) -> None:
        """Keep what is asked for, within the limits, and the estimate, if they are usable."""
        if self._command_held((reference, position, velocity), periods):
            return
        if reference is not Valve.CLOSED and not self._low <= reference <= self._high:
            self._limited += 1
            reference = min(max(reference, self._low), self._high)
        self._wanted, self._estimate = reference, (position, velocity)


class GuardedValve(Guarded):
    """The inverse valve model behind guards: no voltage leaves it that is not finite and in range."""

    def __init__(self, parameters: Parameters, model: InverseValveModel):
        nominal = parameters.nominal()
        super().__init__(nominal, {"pressure": guard.pressure_guard(nominal)})
        self._model = model
        self._valve = nominal.valve
        self._low: float = nominal.valve.minimum_voltage
        self._high: float = nominal.valve.maximum_voltage
        self._flow = 0.0

    def step(self, mass_flow: float, pressure: float, periods: int = 1) -> float:
        """Return the valve voltage, V, finite and in range whatever the numbers are.

        It is one that a position of the spool gives to the bit. The sample is so many control periods later
        than the last one.
        """
        flow = self._usable(mass_flow, periods)
        pressure = self._guards["pressure"].step(pressure, periods=periods)
        voltage = self._model.step(flow, pressure, periods)
        good = self._finite("voltage", voltage)
        if self._venting() or not good:
            return self._low
        return as_commanded(min(max(voltage, self._low), self._high), self._valve)

    def _usable(self, mass_flow: float, periods: int) -> float:
        if not self._command_held((mass_flow,), periods):
            self._flow = min(max(mass_flow, VENT_FLOW), -VENT_FLOW)
            self._limited += self._flow != mass_flow
        return self._flow
