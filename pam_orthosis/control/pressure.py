# SPDX-License-Identifier: Apache-2.0
"""Backstepping pressure controller of one muscle, from the gas dynamics of Eq. (6)."""

from __future__ import annotations

import math

import casadi as ca

from pam_orthosis.control.knee import kinematics
from pam_orthosis.control.trajectory import VALVES_CLOSED
from pam_orthosis.model import muscle as muscle_model
from pam_orthosis.model import pneumatics
from pam_orthosis.model.compiled import compiled
from pam_orthosis.model.orthosis import volume_terms

LIVE = ("control.pressure.gain", "control.pressure.reference_filter")


def mass_flow_function(belief, muscle: str) -> ca.Function:
    """Return (pressure, wanted rate, angle, velocity) -> mass flow, kg/s.

    With e = p_ref - p and V = e^2 / 2 the wanted rate p_ref-dot + c e makes V-dot = -c e^2.
    """
    p, rate, q, velocity = (ca.SX.sym(name) for name in ("p", "rate", "q", "velocity"))
    contraction, contraction_rate = kinematics(q, velocity, belief)
    m, valve = belief.muscle.dmsp_20, belief.valve
    volume, by_pressure, by_contraction = volume_terms(
        lambda dl, gauge: muscle_model.volume(dl, gauge, m),
        getattr(contraction, muscle),
        p - valve.ambient_pressure,
    )
    flow = pneumatics.required_mass_flow(
        p, rate, getattr(contraction_rate, muscle), volume + valve.hose.volume,
        by_pressure, by_contraction, valve,
    )  # fmt: skip
    return ca.Function(f"{muscle}_mass_flow", [p, rate, q, velocity], [flow])


class PressureController:
    """Pressure controller of the `extensor` or the `flexor`; knows the belief only."""

    def __init__(self, parameters, muscle: str):
        belief = parameters.belief()
        self._flow = compiled(mass_flow_function(belief, muscle))
        self._period = belief.scenario.control_period
        self._filtered: float | None = None
        self.retune(belief)

    def retune(self, parameters) -> None:
        """Take the values of `LIVE`; the filter goes on from where it is."""
        settings = parameters.control.pressure
        self._gain = settings.gain
        self._bandwidth = settings.reference_filter
        self._forget = math.exp(-settings.reference_filter * self._period)

    def step(self, pressure: float, reference: float, angle: float, velocity: float) -> float:
        """Return the mass flow into the muscle, kg/s (absolute Pa, estimated rad and rad/s).

        A reference of `VALVES_CLOSED` asks for no flow at all.
        """
        if reference == VALVES_CLOSED:
            self._filtered = None
            return 0.0
        rate = self._reference_rate(reference) + self._gain * (reference - pressure)
        return float(self._flow(pressure, rate, angle, velocity)[0][0])

    def _reference_rate(self, reference: float) -> float:
        """Return the filtered derivative of the reference pressure, Pa/s."""
        if self._filtered is None:
            self._filtered = reference
        self._filtered = reference + (self._filtered - reference) * self._forget
        return self._bandwidth * (reference - self._filtered)
