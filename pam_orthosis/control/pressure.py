# SPDX-License-Identifier: Apache-2.0
"""Backstepping pressure controller of one muscle, from the gas dynamics of Eq. (6)."""

from __future__ import annotations

import math

import casadi as ca

from pam_orthosis.control import effects
from pam_orthosis.control.anticipation import Pending
from pam_orthosis.control.effects import Sensors
from pam_orthosis.control.trajectory import VALVES_CLOSED
from pam_orthosis.model import pneumatics
from pam_orthosis.model.compiled import compiled

LIVE = ("control.pressure.gain", "control.pressure.reference_filter")


def mass_flow_function(belief, muscle: str) -> ca.Function:
    """Return (pressure, wanted rate, angle, velocity, time) -> mass flow, kg/s, and its slope by the rate.

    With e = p_ref - p and V = e^2 / 2 the wanted rate p_ref-dot + c e makes V-dot = -c e^2. Believed
    effects on volume, exponent and temperature are in Eq. (6) as they are in the model.
    """
    rate, time = ca.SX.sym("rate"), ca.SX.sym("time")
    model = effects.gas_model(belief)
    s = model.signals

    def of_muscle(name: str):
        return getattr(s, f"{muscle}_{name}")

    flow = pneumatics.required_mass_flow(
        of_muscle("pressure"), rate, of_muscle("rate"), of_muscle("volume") + of_muscle("dead_volume"),
        of_muscle("volume_by_pressure"), of_muscle("volume_by_contraction"), s,
    )  # fmt: skip
    flow = ca.substitute(flow, model.u, ca.vertcat(0, 0, 0, time))
    inputs = [of_muscle("pressure"), rate, s.angle, s.velocity, time]
    return ca.Function(f"{muscle}_mass_flow", inputs, [ca.vertcat(flow, ca.gradient(flow, rate))])


def flow_limits(belief) -> ca.Function:
    """Return absolute pressure -> least and most mass flow into a muscle that the valve can give, kg/s."""
    pressure, valve = ca.SX.sym("pressure"), belief.valve
    ends = [pneumatics.valve_flow(opening, pressure, valve.supply_pressure, valve) for opening in (-1, 1)]
    return ca.Function("flow_limits", [pressure], [ca.vertcat(*ends)])


class PressureController:
    """Pressure controller of the `extensor` or the `flexor`; knows the belief only.

    With a lag of the valves in the belief the error is that of the pressure once the flows on their way
    have arrived.
    """

    def __init__(self, parameters, muscle: str):
        belief = parameters.belief()
        self._flow = compiled(mass_flow_function(belief, muscle))
        self._sensors, self._channel = Sensors(belief), f"{muscle}_pressure"
        lag = effects.command_lag(belief)
        self._pending = Pending(lag, belief.scenario.control_period) if lag else None
        self._limits = compiled(flow_limits(belief)) if lag else None
        self._steps = 0
        self._period = belief.scenario.control_period
        self._filtered: float | None = None
        self.retune(belief)

    def retune(self, parameters) -> None:
        """Take the values of `LIVE`; the filter goes on from where it is."""
        settings = parameters.control.pressure
        self._gain = settings.gain
        self._forget = math.exp(-settings.reference_filter * self._period)

    def step(
        self,
        pressure: float,
        reference: float,
        angle: float,
        velocity: float,
        periods: int = 1,
        age: float = 0.0,
    ) -> float:
        """Return the mass flow into the muscle, kg/s (absolute Pa, estimated rad and rad/s).

        The sample is so many control periods later than the last one. Reference and estimate are of an
        instant so long before, s: the reference is held, the knee goes on at its velocity. A reference of
        `VALVES_CLOSED` asks for no flow at all.
        """
        angle += age * velocity
        time = self._steps * self._period
        self._steps += periods
        if self._pending is not None:
            self._pending.hold(periods)
        if reference == VALVES_CLOSED:
            self._filtered = None
            if self._pending is not None:
                self._pending.note(0.0)
            return 0.0
        pressure = self._sensors.true(self._channel, pressure)
        pressure = self._ahead(pressure, angle, velocity, time)
        rate = self._reference_rate(reference, periods) + self._gain * (reference - pressure)
        flow = float(self._flow(pressure, rate, angle, velocity, time)[0][0])
        return flow if self._pending is None else self._noted(flow, pressure)

    def _ahead(self, pressure: float, angle: float, velocity: float, time: float) -> float:
        """Return the pressure when a command of now begins to act; Eq. (6) is linear in flow and rate."""
        if self._pending is None:
            return pressure
        still, slope = self._flow(pressure, 0.0, angle, velocity, time)[0].tolist()
        return pressure + sum(duration * (flow - still) for flow, duration, _ in self._pending) / slope

    def _noted(self, flow: float, pressure: float) -> float:
        """Remember what the valve can give of a flow; return the flow."""
        least, most = self._limits(pressure)[0].tolist()
        self._pending.note(min(max(flow, least), most))
        return flow

    def _reference_rate(self, reference: float, periods: int) -> float:
        """Return the rate of the filtered reference pressure since the last sample, Pa/s.

        Of a reference that rises steadily it is the slope, whatever the periods between the samples.
        """
        before = reference if self._filtered is None else self._filtered
        self._filtered = reference + (before - reference) * self._forget**periods
        return (self._filtered - before) / (periods * self._period)
