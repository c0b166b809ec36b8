# SPDX-License-Identifier: Apache-2.0
"""Backstepping pressure controller of one actuator, from the gas dynamics of Eq. (6)."""

import math

import casadi as ca

from pam_orthosis.control import effects
from pam_orthosis.control.anticipation import Pending
from pam_orthosis.control.effects import Sensors
from pam_orthosis.control.reference import PressureReference, Valve
from pam_orthosis.model.compiled import compiled
from pam_orthosis.model.components import pneumatics
from pam_orthosis.model.parameters import Parameters


def mass_flow_function(nominal: Parameters, actuator: str) -> ca.Function:
    """Return (pressure, wanted rate, position, velocity, time) -> mass flow, kg/s, and its slope by the rate.

    With e = p_ref - p and V = e^2 / 2 the wanted rate p_ref-dot + c e makes V-dot = -c e^2. Expected
    effects on volume, exponent and temperature are in Eq. (6) as they are in the model.
    """
    rate, time = ca.SX.sym("rate"), ca.SX.sym("time")
    model = effects.gas_model(nominal)
    s = model.signals
    a = s.actuators[actuator]
    volume, slopes = a.volume + a.dead_volume, (a.volume_by_pressure, a.volume_by_contraction)
    flow = pneumatics.required_mass_flow(a.pressure, rate, a.rate, volume, *slopes, a.air)
    flow = ca.substitute(flow, model.u, effects.inputs(nominal, time))
    inputs = [a.pressure, rate, s.coordinate, s.velocity, time]
    return ca.Function(f"{actuator}_mass_flow", inputs, [ca.vertcat(flow, ca.gradient(flow, rate))])


def flow_limits(nominal: Parameters) -> ca.Function:
    """Return absolute pressure -> least and most mass flow that the valve can give, kg/s."""
    pressure, valve = ca.SX.sym("pressure"), nominal.valve
    ends = [pneumatics.valve_flow(opening, pressure, valve.supply_pressure, valve) for opening in (-1, 1)]
    return ca.Function("flow_limits", [pressure], [ca.vertcat(*ends)])


class PressureController:
    """Pressure controller of an actuator; knows the nominal model only.

    With a lag of the valves in the nominal model the error is that of the pressure once the flows on their
    way have arrived.
    """

    def __init__(self, parameters: Parameters, actuator: str):
        nominal = parameters.nominal()
        self._flow = compiled(mass_flow_function(nominal, actuator))
        self._sensors, self._channel = Sensors(nominal), f"{actuator}_pressure"
        self._pending = Pending(effects.command_lag(nominal), nominal.scenario.control_period)
        self._limits = compiled(flow_limits(nominal))
        self._steps = 0
        self._period = nominal.scenario.control_period
        self._filtered: float | None = None
        self.retune(nominal)

    def retune(self, parameters: Parameters) -> None:
        """Take the values of `live.PRESSURE`; the filter goes on from where it is."""
        settings = parameters.control.pressure
        self._gain = settings.gain
        self._forget = math.exp(-settings.reference_filter * self._period)

    def step(
        self,
        pressure: float,
        reference: PressureReference,
        position: float,
        velocity: float,
        periods: int = 1,
        age: float = 0.0,
    ) -> float:
        """Return the mass flow into the actuator, kg/s (absolute Pa, estimated rad or m, and its rate).

        The sample is so many control periods later than the last one. Reference and estimate are of an
        instant so long before, s: the reference is held, the load goes on at its velocity. A closed valve is
        asked for no flow at all.
        """
        position += age * velocity
        time = self._steps * self._period
        self._steps += periods
        self._pending.hold(periods)
        if reference is Valve.CLOSED:
            self._filtered = None
            self._pending.note(0.0)
            return 0.0
        pressure = self._ahead(self._sensors.true(self._channel, pressure), position, velocity, time)
        rate = self._reference_rate(reference, periods) + self._gain * (reference - pressure)
        flow = float(self._flow(pressure, rate, position, velocity, time)[0][0])
        least, most = self._limits(pressure)[0].tolist()
        self._pending.note(min(max(flow, least), most))  # what the valve can give
        return flow

    def _ahead(self, pressure: float, position: float, velocity: float, time: float) -> float:
        """Return the pressure when a command of now begins to act; Eq. (6) is linear in flow and rate."""
        still, slope = map(float, self._flow(pressure, 0.0, position, velocity, time)[0])
        return pressure + sum(duration * (flow - still) for flow, duration, _ in self._pending) / slope

    def _reference_rate(self, reference: float, periods: int) -> float:
        """Return the rate of the filtered reference pressure since the last sample, Pa/s.

        Of a reference that rises steadily it is the slope, whatever the periods between the samples.
        """
        before = reference if self._filtered is None else self._filtered
        self._filtered = reference + (before - reference) * self._forget**periods
        rate: float = (self._filtered - before) / (periods * self._period)
        return rate
