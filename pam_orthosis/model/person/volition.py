# SPDX-License-Identifier: Apache-2.0
"""What a person does at the joint by will or in a spasm: a torque from outside, held for a control period."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import casadi as ca

from pam_orthosis.model.mechanisms.base import Mechanism
from pam_orthosis.model.rows import Section
from pam_orthosis.model.shapes import scenario_shape, smooth_step

if TYPE_CHECKING:
    from pam_orthosis.model.parameters import Parameters

Motion = tuple[float, float, float]  # position, velocity, acceleration


class Volition:
    """A person with a cadence and a strength of their own.

    They feed forward a share of the effort that the scenario's motion takes, Eq. (26), and correct what is
    off their intended motion like a spring and a damper. The share falls as they tire. They may hold the
    joint for a while (`block`), and a spasm may come over them. All of it passes through straps that yield.

    Attributes:
        aim: time, s -> the motion that they intend.
    """

    def __init__(self, parameters: Parameters, mechanism: Mechanism):
        self._s, self._person = parameters.scenario, parameters.plant.person
        self._will: Section = self._person.volition
        self._shape, self._period = scenario_shape(parameters), self._s.control_period
        self._needed = needed_effort(mechanism)
        self._slip = 0.0  # rad or m, of the limb before the frame
        self._blocked_at: float | None = None
        self.aim: Callable[[float], Motion] = self.intended

    def effort(self, time: float, position: float, velocity: float) -> float:
        """Return what the frame feels from now on for a control period, N m or N; call it once a period."""
        effort = self._willed(time, position + self._slip, velocity) + self._spasm(time)
        strap = self._person.strap
        if strap.enabled:
            settled = effort / strap.stiffness
            self._slip = settled + (self._slip - settled) * math.exp(
                -self._period * strap.stiffness / strap.damping
            )
        return effort

    def intended(self, time: float) -> Motion:
        """Return the motion that the person intends at a time, s, by a cadence of their own."""
        covered, cadence, growth = smooth_step(time - self._s.start_hold, self._s.start_ramp)
        if self._will.resting:
            covered = cadence = growth = 0.0
        phase, rate, curvature = (one / self._will.cycle_time for one in (covered, cadence, growth))
        position, slope, bend = self._shape(self._s.start_phase + phase)
        return position, slope * rate, bend * rate**2 + slope * curvature

    def _willed(self, time: float, position: float, velocity: float) -> float:
        will, block = self._will, self._person.block
        if within(time, block):
            self._blocked_at = position if self._blocked_at is None else self._blocked_at
            wanted = block.stiffness * (self._blocked_at - position) - block.damping * velocity
        else:
            self._blocked_at = None
            aim = self.aim(time)
            tired = 1 - will.fatigue * (1 - math.exp(-time / will.fatigue_time))
            wanted = will.share * tired * float(self._needed(*aim))
            wanted += will.stiffness * (aim[0] - position) + will.damping * (aim[1] - velocity)
        return float(min(max(wanted, -will.strength), will.strength))

    def _spasm(self, time: float) -> float:
        spasm = self._person.spasm
        if not within(time, spasm):
            return 0.0
        rise = 1 - math.exp(-(time - spasm.start) / spasm.rise)
        effort: float = spasm.torque * rise
        return effort


def within(time: float, event: Section) -> bool:
    """Return whether an event goes on at a time, s; one that starts at a negative time never does."""
    return bool(0.0 <= event.start <= time < event.start + event.duration)


def needed_effort(mechanism: Mechanism) -> ca.Function:
    """Return (position, velocity, acceleration) -> the effort that the motion takes, Eq. (26)."""
    q, velocity, acceleration = (ca.SX.sym(name) for name in ("q", "velocity", "acceleration"))
    terms = mechanism.terms(q, velocity)
    needed = terms.inertia * acceleration + terms.coriolis + terms.gravity
    return ca.Function("needed_effort", [q, velocity, acceleration], [needed])
