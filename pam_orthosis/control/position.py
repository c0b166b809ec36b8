# SPDX-License-Identifier: Apache-2.0
"""Backstepping position controller with built-in observer, Eqs. (33)-(37)."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca

from pam_orthosis.control import effects, live, observer
from pam_orthosis.control.anticipation import Anticipation
from pam_orthosis.control.effects import EffectTorque, Sensors
from pam_orthosis.control.knee import Pair, kinematics, leg_mechanics
from pam_orthosis.control.observer import Observer
from pam_orthosis.control.rates import position_belief
from pam_orthosis.control.trajectory import VALVES_CLOSED, Reference
from pam_orthosis.model import muscle as muscle_model
from pam_orthosis.model.compiled import compiled

TAUT = Pair(0.0, 0.0)  # neither muscle is rid of the other one
NOTHING_ADDED = Pair(0.0, 0.0)
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
    terms = leg_mechanics(estimate[0], estimate[1], belief)
    wanted = desired_acceleration(estimate, reference, gains.c1, gains.c2)
    return terms.inertia * wanted + terms.coriolis + terms.gravity + estimate[2]


class Allocation(NamedTuple):
    """Gauge pressures of extensor and flexor, Pa, and what limits them.

    `missed`: the torque is out of reach, and cut. `let_go`: share by which each muscle should be rid of the
    other one.
    """

    extensor: Any
    flexor: Any
    missed: Any
    let_go: Pair


def pressures_for_torque(
    torque, q, velocity, mean_pressure, belief, let_go=TAUT, added_force=NOTHING_ADDED
) -> Allocation:
    """Return the pressures that give a torque, N m.

    With both muscles taut, Eqs. (14) and (27) make the torque linear in both pressures: the pairs
    that give it lie on a line. On it the pair with the mean p_im (absolute) is taken; where that leaves the
    limits, the nearest pair inside them: stiffness gives way before torque. Where one muscle comes near
    its highest pressure the other should be let go slack: it pulls and drags no more. `let_go` is the share
    by which each muscle is rid of the other one; in between the torque is exceeded by less than that pull.
    `added_force` is what effects add to the elastic force of each muscle, N: a taut one pulls with it and
    without it.
    """
    settings, ambient = belief.control.position, belief.valve.ambient_pressure
    m = belief.muscle.dmsp_20
    contraction, rate = kinematics(q, velocity, belief)
    area = _both(lambda dl: muscle_model.area(dl, m), contraction)
    counter = _both(lambda dl: muscle_model.counterforce(dl, m), contraction)
    damping = _both(lambda v: muscle_model.damping_force(v, m), rate)
    # without it, too: from there the torque of the effects is counted
    slackening = _both(lambda force, added: force - ca.fmin(added, 0), counter, added_force)
    low = _both(lambda *of: _lowest_pressure(*of, settings, ambient), area, slackening, damping)
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
    pull = 2 * torque / belief.leg.cogwheel_diameter
    alone = Pair(
        (counter.extensor + damping.extensor - pull) / area.extensor,
        (counter.flexor + damping.flexor + pull) / area.flexor,
    )
    needed = Pair((area.flexor * low.flexor - level) / area.extensor, least)
    near = _both(lambda p: ca.fmin(ca.fmax((p - high) / settings.slack_reserve + 1, 0), 1), needed)
    # what is needed may be beyond the limit at which both were cut
    wanted = _both(ca.fmax, Pair(extensor, flexor), needed)
    wanted = _both(lambda p, lone, share: p + share * (lone - p), wanted, alone, let_go)
    missed = ca.logic_or(wanted.extensor > high, wanted.flexor > high)
    slack = settings.minimum_pressure - ambient
    extensor = ca.fmin(wanted.extensor, high) + let_go.flexor * (slack - ca.fmin(wanted.extensor, high))
    flexor = ca.fmin(wanted.flexor, high) + let_go.extensor * (slack - ca.fmin(wanted.flexor, high))
    return Allocation(ca.fmax(extensor, slack), ca.fmax(flexor, slack), missed, near)


def pressures_with_effects(torque, estimate, reference, mean, effect, belief, let_go) -> Allocation:
    """Return what `pressures_for_torque` does, for the muscles and the believed effects together.

    `effect` is (extensor, flexor gauge pressure) -> torque and forces that the effects add along the
    reference. They hardly depend on the pressures, so that a few corrections find those at which both add up
    to the torque.
    """
    allocated = pressures_for_torque(torque, estimate[0], estimate[1], mean, belief, let_go)
    for _ in range(0 if effect is None else effects.CORRECTIONS + 1):
        added, forces = effect(allocated[0], allocated[1])
        rest, forces = torque - added, Pair(forces[0], forces[1])
        allocated = pressures_for_torque(rest, estimate[0], estimate[1], mean, belief, let_go, forces)
    return allocated


def command_function(belief) -> ca.Function:
    """Return the position law as a function of numbers.

    (estimate, reference, mean pressure, share let go of each muscle, states of the effects, time, tuned
    values) -> (absolute pressures, saturated, clamped, share to let go). A locked joint is asked for no
    torque: its motion cannot be fed back.
    """
    belief, tuned = live.with_symbols(belief, _OF_COMMAND)
    estimate, reference, mean = ca.SX.sym("estimate", 3), ca.SX.sym("reference", 3), ca.SX.sym("mean")
    law, ambient = effects.added_by_effects(belief), belief.valve.ambient_pressure
    let_go = ca.SX.sym("let_go", 2)
    states, time = ca.SX.sym("states", law.size1_in(3) if law else 0), ca.SX.sym("time")

    def effect(extensor, flexor):
        pressures = ca.vertcat(extensor + ambient, flexor + ambient)
        return law(reference[0], reference[1], pressures, states, time)

    torque = 0.0 if belief.leg.joint.locked else required_torque(estimate, reference, belief)
    extensor, flexor, saturated, near = pressures_with_effects(
        torque, estimate, reference, mean, effect if law else None, belief, Pair(let_go[0], let_go[1])
    )
    contraction, _ = kinematics(estimate[0], estimate[1], belief)
    m = belief.muscle.dmsp_20
    clamped = ca.logic_or(
        muscle_model.outside_box(contraction.extensor, extensor, m),
        muscle_model.outside_box(contraction.flexor, flexor, m),
    )
    pressures = ca.vertcat(extensor + ambient, flexor + ambient)
    inputs = [estimate, reference, mean, let_go, states, time, tuned]
    outputs = [pressures, saturated, clamped, ca.vertcat(near.extensor, near.flexor)]
    return ca.Function("position_command", inputs, outputs)


class PositionController:
    """Observer and backstepping law; knows the belief only.

    With effects in the belief their torque along the reference is a known input of the observer and
    of the law. With a lag of the valves in the belief the law plans for the instant at which it acts.
    """

    def __init__(self, parameters):
        belief = position_belief(parameters)
        self._observer = Observer(belief)
        self._command = compiled(command_function(belief))
        self._tuned = live.values(belief, _OF_COMMAND)
        self._mean = belief.control.position.mean_pressure
        self._let_go = [0.0, 0.0]
        self._change = belief.scenario.control_period / belief.control.position.slack_time
        self._sensors = Sensors(belief)
        self._ahead = Anticipation(belief)
        self._now = EffectTorque(belief)
        self._then = EffectTorque(belief, self._ahead.horizon)

    def retune(self, parameters) -> None:
        """Take the values of `LIVE`; estimate and references go on from where they are."""
        self._tuned = live.values(parameters, _OF_COMMAND)
        self._observer.retune(parameters)

    def restart(self) -> None:
        """Begin anew at the next sample, wherever the knee is then; what lives in the leg goes on."""
        self._observer.restart()
        self._let_go = [0.0, 0.0]
        self._ahead.restart()
        self._now.restart()
        self._then.restart()

    def step(
        self,
        angle: float,
        extensor_pressure: float,
        flexor_pressure: float,
        reference: Reference,
        periods: int = 1,
    ) -> PositionCommand:
        """Return the reference pressures for one sample (rad, absolute Pa; finite numbers).

        It is so many of the position controller's periods later than the last one.
        """
        angle = self._sensors.true("angle", angle)
        pressures = (
            self._sensors.true("extensor_pressure", extensor_pressure),
            self._sensors.true("flexor_pressure", flexor_pressure),
        )
        known = self._now.step(reference, *pressures, periods)
        estimate = self._observer.step(angle, *pressures, known, periods)
        mean = self._mean if reference.mean_pressure is None else reference.mean_pressure
        if mean == VALVES_CLOSED:
            return PositionCommand(VALVES_CLOSED, VALVES_CLOSED, *estimate, False, False)
        wanted = self._wanted(estimate, reference, mean, pressures, periods)
        (extensor, flexor), saturated, clamped = wanted
        return PositionCommand(extensor, flexor, *estimate, saturated, clamped)

    def _wanted(self, estimate, reference: Reference, mean: float, pressures, periods: int):
        """Return the reference pressures and what limits them, at the instant at which they act."""
        if not self._ahead.horizon:
            return self._law(estimate[:3], reference, mean, self._now, periods)
        then = self._ahead.reference(reference, periods)
        self._then.step(then, *pressures, periods)
        point = self._ahead.estimate(estimate, reference, then)
        c1, c2 = self._tuned[:2].tolist()
        self._ahead.note(desired_acceleration(point, then, c1, c2) - then.acceleration)
        return self._law(point, then, mean, self._then, periods)

    def _law(self, estimate, reference: Reference, mean: float, effect: EffectTorque, periods: int):
        states, time, change = effect.states, effect.time, periods * self._change
        result = self._command(estimate, reference[:3], mean, self._let_go, states, time, self._tuned)
        pressures, saturated, clamped, near = result
        self._let_go = [
            min(max(wanted, now - change), now + change)
            for wanted, now in zip(near.tolist(), self._let_go, strict=True)
        ]
        return pressures.tolist(), bool(saturated[0]), bool(clamped[0])


def _both(function, *pairs: Pair) -> Pair:
    return Pair(function(*(pair.extensor for pair in pairs)), function(*(pair.flexor for pair in pairs)))


def _lowest_pressure(area, counterforce, damping, settings, ambient):
    """Return the gauge pressure below which a muscle hangs slack, at rest or as it shortens, Pa.

    Without the damping a muscle that shortens fast would be asked for a torque that it has not.
    """
    taut = (counterforce + ca.fmax(damping, 0)) / area + settings.slack_margin
    return ca.fmax(settings.minimum_pressure - ambient, taut)
