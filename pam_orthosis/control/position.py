# SPDX-License-Identifier: Apache-2.0
"""Backstepping position controller with built-in observer, Eqs. (33)-(37)."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from pam_orthosis.control import live, observer
from pam_orthosis.control.knee import Pair, kinematics
from pam_orthosis.control.observer import Observer
from pam_orthosis.control.trajectory import VALVES_CLOSED, Reference
from pam_orthosis.model import leg as leg_model
from pam_orthosis.model import muscle as muscle_model
from pam_orthosis.model.compiled import compiled

_OF_COMMAND = ("control.position.c1", "control.position.c2", "leg.person.mass")
LIVE = tuple(dict.fromkeys((*_OF_COMMAND, *observer.LIVE)))


class PositionCommand(NamedTuple):
    """Reference pressures (absolute Pa), the estimate behind them, and what limited them.

    A reference pressure of `VALVES_CLOSED` (0) keeps the valve closed.
    `saturated`: the pressures' limits do not allow the torque that is needed.
    `clamped`: the estimate lies outside the box in which the muscle model was identified.
    """

    extensor_pressure: float
    flexor_pressure: float
    angle: float
    velocity: float
    disturbance: float
    residual: float
    saturated: bool
    clamped: bool


def desired_acceleration(estimate, reference, c1, c2):
    """Return the q-double-dot that fulfils the condition of Eq. (37), rad/s^2.

    e1 = q_d - q, Eq. (33); e2 = q_d-dot - q-dot + c1 e1, Eq. (36). In the bracket of Eq. (37) the
    paper prints q_d-dot; differentiating Eq. (36) gives q_d-double-dot, used here, so that
    V2-dot = -c1 e1^2 - c2 e2^2 for the function V1 of Eq. (34) plus e2^2 / 2, V1 having been made
    decreasing by Eq. (35).
    """
    e1 = reference[0] - estimate[0]
    e2 = reference[1] - estimate[1] + c1 * e1
    return reference[2] + e1 + c1 * (e2 - c1 * e1) + c2 * e2


def required_torque(estimate, reference, belief):
    """Return the muscles' torque that gives the desired acceleration: Eq. (26) solved for M_k, N m."""
    gains = belief.control.position
    terms = leg_model.mechanics(estimate[0], estimate[1], belief.leg)
    wanted = desired_acceleration(estimate, reference, gains.c1, gains.c2)
    return terms.inertia * wanted + terms.coriolis + terms.gravity + estimate[2]


def pressures_for_torque(torque, q, velocity, mean_pressure, belief):
    """Return gauge pressures of extensor and flexor, Pa, and whether the torque is out of reach.

    With both muscles taut, Eqs. (14) and (27) make the torque linear in both pressures: the pairs
    that give it lie on a line. On it the pair with the mean p_im (absolute) is taken; where that leaves the
    limits, the nearest pair inside them: stiffness gives way before torque. Only where the line
    misses the limits altogether is the torque cut.
    """
    settings, ambient = belief.control.position, belief.valve.ambient_pressure
    m = belief.muscle.dmsp_20
    contraction, rate = kinematics(q, velocity, belief)
    area = _both(lambda dl: muscle_model.area(dl, m), contraction)
    counter = _both(lambda dl: muscle_model.counterforce(dl, m), contraction)
    damping = _both(lambda v: muscle_model.damping_force(v, m), rate)
    low = _both(lambda a, f: _lowest_pressure(a, f, settings, ambient), area, counter)
    high = settings.maximum_pressure - ambient
    mean = mean_pressure - ambient
    # area_f p_f - area_e p_e = level
    level = 2 * torque / belief.leg.cogwheel_diameter
    level += counter.flexor - counter.extensor + damping.flexor - damping.extensor
    flexor = (level + 2 * mean * area.extensor) / (area.extensor + area.flexor)
    least = ca.fmax(low.flexor, (level + area.extensor * low.extensor) / area.flexor)
    most = ca.fmin(high, (level + area.extensor * high) / area.flexor)
    flexor = ca.fmin(ca.fmax(ca.fmin(ca.fmax(flexor, least), most), low.flexor), high)
    extensor = (area.flexor * flexor - level) / area.extensor
    extensor = ca.fmin(ca.fmax(extensor, low.extensor), high)
    return extensor, flexor, least > most


def command_function(belief) -> ca.Function:
    """Return (estimate, reference, mean pressure, tuned values) -> (pressures, saturated, clamped).

    Pressures absolute. A locked joint is asked for no torque: its motion cannot be fed back.
    """
    belief, tuned = live.with_symbols(belief, _OF_COMMAND)
    estimate, reference, mean = ca.SX.sym("estimate", 3), ca.SX.sym("reference", 3), ca.SX.sym("mean")
    torque = 0.0 if belief.leg.joint.locked else required_torque(estimate, reference, belief)
    extensor, flexor, saturated = pressures_for_torque(torque, estimate[0], estimate[1], mean, belief)
    contraction, _ = kinematics(estimate[0], estimate[1], belief)
    m = belief.muscle.dmsp_20
    clamped = ca.logic_or(
        muscle_model.outside_box(contraction.extensor, extensor, m),
        muscle_model.outside_box(contraction.flexor, flexor, m),
    )
    ambient = belief.valve.ambient_pressure
    pressures = ca.vertcat(extensor + ambient, flexor + ambient)
    inputs = [estimate, reference, mean, tuned]
    return ca.Function("position_command", inputs, [pressures, saturated, clamped])


class PositionController:
    """Observer and backstepping law; knows the belief only."""

    def __init__(self, parameters):
        belief = parameters.belief()
        self._observer = Observer(belief)
        self._command = compiled(command_function(belief))
        self._tuned = live.values(belief, _OF_COMMAND)
        self._mean = belief.control.position.mean_pressure

    def retune(self, parameters) -> None:
        """Take the values of `LIVE`; estimate and references go on from where they are."""
        self._tuned = live.values(parameters, _OF_COMMAND)
        self._observer.retune(parameters)

    def step(
        self, angle: float, extensor_pressure: float, flexor_pressure: float, reference: Reference
    ) -> PositionCommand:
        """Return the reference pressures for one sample (rad, absolute Pa; finite numbers)."""
        estimate = self._observer.step(angle, extensor_pressure, flexor_pressure)
        mean = self._mean if reference.mean_pressure is None else reference.mean_pressure
        if mean == VALVES_CLOSED:
            return PositionCommand(VALVES_CLOSED, VALVES_CLOSED, *estimate, False, False)
        pressures, saturated, clamped = self._command(estimate[:3], reference[:3], mean, self._tuned)
        extensor, flexor = pressures.tolist()
        return PositionCommand(extensor, flexor, *estimate, bool(saturated[0]), bool(clamped[0]))


def _both(function, *pairs: Pair) -> Pair:
    return Pair(function(*(pair.extensor for pair in pairs)), function(*(pair.flexor for pair in pairs)))


def _lowest_pressure(area, counterforce, settings, ambient):
    """Return the gauge pressure below which a muscle hangs slack or loses its shape, Pa."""
    taut = counterforce / area + settings.slack_margin
    return ca.fmax(settings.minimum_pressure - ambient, taut)
