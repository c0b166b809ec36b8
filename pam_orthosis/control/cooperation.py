# SPDX-License-Identifier: Apache-2.0
"""Cooperation: the joint as a spring and damper about the reference that brings a share of the effort.

    effort = level (m(q) q̈_d + k + G) + K e* + D ė,        e = q_d - q, e* = e outside of a tunnel, else 0

Impedance control (Hogan 1985) without a force sensor: the muscles make the effort by their nominal model, and
what acts from outside meets the joint's own inertia. The mode `position` is the backstepping law. The others
are settings of the law above: `impedance` has the level 1 and no tunnel, `assist` adapts the level,
`transparent` has, but for the first `ease` s, neither stiffness nor damping and only carries the weight.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca

from pam_orthosis.control.axis import Axis
from pam_orthosis.control.position import Demand, PositionController, position_nominal, pressures_with_effects
from pam_orthosis.control.reference import Reference
from pam_orthosis.model.compiled import compiled
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.signals import Expression

ENDLESS = (-1e9, 1e9)  # rad, without a safety monitor


class Impedance(NamedTuple):
    """What the joint is to be: stiffness N m/rad, damping N m s/rad, half width of the tunnel rad, level.

    `low`, `high`: ends of the patient's range of motion, rad.
    """

    stiffness: Expression
    damping: Expression
    tunnel: Expression
    level: Expression
    low: Expression = ENDLESS[0]
    high: Expression = ENDLESS[1]


class Spring(NamedTuple):
    """What the law of a mode gives: the actuators' effort, and what it is made of.

    `correction`: by how much the acceleration leaves the reference's; `outside`: e*; `needed`: at level 1.
    """

    effort: Expression
    correction: Expression
    outside: Expression
    needed: Expression


def spring(estimate: Expression, reference: Expression, wanted: Impedance, axis: Axis) -> Spring:
    """Return the law above for (q, q-dot, disturbance) and the reference (q, q-dot, q-double-dot).

    Stiffness and damping are cut to what the lag of the pressures carries at the joint's inertia: a light
    leg on a stiff spring would swing faster than they follow.
    """
    terms = axis.terms(estimate[0], estimate[1])
    error = reference[0] - estimate[0]
    outside = error - ca.fmin(ca.fmax(error, -wanted.tunnel), wanted.tunnel)
    fastest = axis.nominal.control.cooperation.fastest
    stiffness = ca.fmin(wanted.stiffness, terms.inertia * fastest**2)
    damping = ca.fmin(wanted.damping, 2 * terms.inertia * fastest)
    pull = stiffness * outside + damping * (reference[1] - estimate[1])
    needed = terms.inertia * reference[2] + terms.coriolis + terms.gravity
    effort = wanted.level * needed + pull + edge(estimate, wanted, terms.inertia, axis)
    return Spring(effort, (effort - needed - estimate[2]) / terms.inertia, outside, needed)


def edge(estimate: Expression, wanted: Impedance, inertia: Expression, axis: Axis) -> Expression:
    """Return what keeps a soft joint inside the patient's range, before the safety monitor has to vent it.

    A spring begins within both ends, for the place at which the joint will be when the monitor looks ahead.
    """
    settings, time = axis.nominal.control.cooperation, axis.nominal.control.limits.look_ahead
    ahead = estimate[0] + time * estimate[1]
    above = ca.fmax(ahead - (wanted.high - settings.edge), 0)
    below = ca.fmax(wanted.low + settings.edge - ahead, 0)
    return ca.fmin(settings.edge_stiffness, inertia * settings.fastest**2) * (below - above)


def own_stiffness(q: Expression, mean: Expression, axis: Axis) -> Expression:
    """Return the stiffness that the actuators give by themselves at a mean pressure, held, absolute Pa."""
    place = ca.SX.sym("place")
    effort = axis.effort(place, 0, (mean, mean))
    return ca.substitute(-ca.gradient(effort, place), place, q)


def softest_mean(q: Expression, stiffness: Expression, axis: Axis) -> Expression:
    """Return the mean pressure, absolute Pa, at which the actuators give a stiffness by themselves.

    It is affine in the mean; between the limits that leave both actuators room.
    """
    settings = axis.nominal.control
    low, high = settings.cooperation.least_mean, settings.position.mean_pressure
    soft, stiff = (own_stiffness(q, ca.SX(mean), axis) for mean in (low, high))
    share = (stiffness - soft) / (stiff - soft)
    return low + ca.fmin(ca.fmax(share, 0), 1) * (high - low)


def cooperation_function(nominal: Parameters) -> ca.Function:
    """Return (estimate, reference, slack share, impedance) -> as `command_function`, and `Spring`'s rest."""
    axis, ambient = Axis(nominal), nominal.valve.ambient_pressure
    estimate, reference = ca.SX.sym("estimate", 3), ca.SX.sym("reference", 3)
    slack_share, wanted = ca.SX.sym("slack_share", 2), ca.SX.sym("wanted", len(Impedance._fields))
    law = spring(estimate, reference, Impedance(*ca.vertsplit(wanted)), axis)
    mean = softest_mean(estimate[0], wanted[0], axis)
    asked = Demand(law.effort, estimate[0], estimate[1], mean, (slack_share[0], slack_share[1]))
    gauge, saturated, near = pressures_with_effects(asked, None, axis)
    outside, inputs = axis.outside(estimate[0], gauge), [estimate, reference, slack_share, wanted]
    command = ca.vertcat(*gauge) + ambient, saturated, outside, ca.vertcat(*near), law.effort
    return ca.Function("cooperation", inputs, [*command, ca.vertcat(*law[1:])])


class CooperativeController(PositionController):
    """The position controller in one of the modes of `control.cooperation.mode`, which may change on the way.

    Attributes:
        level: share of the needed effort that the orthosis brings, in the mode `assist`.
    """

    def __init__(self, parameters: Parameters):
        super().__init__(parameters)
        nominal = position_nominal(parameters)
        self._cooperate = compiled(cooperation_function(nominal))
        self._settings, self._period = nominal.control.cooperation, nominal.scenario.control_period
        self.level = 1.0
        self._begun = 0.0  # s since the mode began
        self._range = _range(nominal)

    def retune(self, parameters: Parameters) -> None:
        """Take other settings; mode, estimate and references pass on smoothly from where they are."""
        super().retune(parameters)
        if parameters.control.cooperation.mode != self._settings.mode:
            self._begun = 0.0
        self._settings = parameters.control.cooperation
        self._range = _range(parameters)

    def _ask(self, periods: int, *inputs: Any) -> Any:
        if self._settings.mode == "position":
            return super()._ask(periods, *inputs)
        estimate, reference, _, slack_share, *_ = inputs
        *command, law = self._cooperate(estimate, reference, slack_share, self._wanted_impedance())
        passed = periods * self._period
        self._begun += passed
        _, outside, needed = law.tolist()
        self._adapt(outside, needed, passed)
        return command

    def _correction(self, point: Sequence[float], reference: Reference) -> float:
        if self._settings.mode == "position":
            return super()._correction(point, reference)
        law = self._cooperate(point, reference[:3], self._slack_share, self._wanted_impedance())[-1]
        return float(law[0])

    def _wanted_impedance(self) -> Impedance:
        s = self._settings
        if s.mode == "transparent":
            left = max(0.0, 1.0 - self._begun / s.ease)  # who holds against it is not flung
            return Impedance(left * s.stiffness, left * s.damping, 0.0, 1.0, *self._range)
        if s.mode == "impedance":
            return Impedance(s.stiffness, s.damping, 0.0, 1.0, *self._range)
        return Impedance(s.stiffness, s.damping, s.tunnel, self.level, *self._range)

    def _adapt(self, outside: float, needed: float, passed: float) -> None:
        """Raise the level where the needed effort is missing; let it fade inside the tunnel."""
        s = self._settings
        need = s.learning * outside * (1 if needed > 0 else -1)
        self.level += passed * (need - s.forgetting * self.level * (outside == 0))
        self.level = min(max(self.level, 0.0), 1.0)


def _range(parameters: Parameters) -> tuple[float, float]:
    limits = parameters.control.limits
    return (limits.low, limits.high) if limits.enabled else ENDLESS
