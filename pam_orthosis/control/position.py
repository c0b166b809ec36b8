# SPDX-License-Identifier: Apache-2.0
"""Backstepping position controller with built-in observer, Eqs. (33)-(37)."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import casadi as ca

from pam_orthosis.control import effects
from pam_orthosis.control.anticipation import Anticipation
from pam_orthosis.control.axis import Axis, Pair
from pam_orthosis.control.coupling import Coupling
from pam_orthosis.control.effects import AddedEffort, Sensors
from pam_orthosis.control.live import GAINS
from pam_orthosis.control.observer import Estimate, Observer
from pam_orthosis.control.reference import PressureReference, Pressures, Reference, Valve
from pam_orthosis.model.compiled import compiled
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.signals import Expression

# gauge pressures of both actuators -> effort and forces (2,) that effects add
Added = Callable[[Pair], tuple[Expression, Expression]]
# estimate, reference, model -> the effort that is asked of both actuators
EffortOf = Callable[[Expression, Expression, Axis], Expression]
Limited = tuple[Pressures, bool, bool, float]  # absolute pressures; saturated; clamped; effort

NONE: Pair = (0.0, 0.0)


class PositionCommand(NamedTuple):
    """Reference pressures (absolute Pa), the estimate behind them, and what limited them.

    `saturated`: the pressures' limits do not allow the torque or force that is needed.
    `clamped`: the estimate lies outside the box in which an actuator's laws were identified.
    `effort`: torque or force in the direction of the coordinate that is asked of the actuators; 0 if none is.
    """

    pressures: tuple[PressureReference, PressureReference]
    position: float
    velocity: float
    disturbance: float
    residual: float
    saturated: bool
    clamped: bool
    effort: float = 0.0


def desired_acceleration(
    estimate: Sequence[Expression], reference: Sequence[Expression], c1: Expression, c2: Expression
) -> Expression:
    """Return the q-double-dot that fulfils the condition of Eq. (37).

    e1 = q_d - q, Eq. (33); e2 = q_d-dot - q-dot + c1 e1, Eq. (36). In its bracket Eq. (37) prints
    q_d-dot, where differentiating e2 gives q_d-double-dot, used here. Then
    V2-dot = -c1 e1^2 - c2 e2^2 for the function V1 of Eq. (34) plus e2^2 / 2, V1 having been made
    decreasing by Eq. (35).
    """
    e1 = reference[0] - estimate[0]
    e2 = reference[1] - estimate[1] + c1 * e1
    return reference[2] + e1 + c1 * (e2 - c1 * e1) + c2 * e2


def required_effort(estimate: Expression, reference: Expression, axis: Axis) -> Expression:
    """Return the actuators' effort that gives the desired acceleration: Eq. (26) solved for M_k."""
    gains = axis.nominal.control.position
    terms = axis.terms(estimate[0], estimate[1])
    wanted = desired_acceleration(estimate, reference, gains.c1, gains.c2)
    return terms.inertia * wanted + terms.coriolis + terms.gravity + estimate[2]


class Allocation(NamedTuple):
    """Gauge pressures of both actuators, Pa, and what limits them.

    `missed`: the effort is out of reach, and cut. `slack_share`: by which each muscle should be free of the
    other one.
    """

    pressures: Pair
    missed: Expression
    slack_share: Pair


class Demand(NamedTuple):
    """What is asked of both actuators at a motion.

    Attributes:
        effort: torque or force in the direction of the coordinate.
        q, velocity: of the coordinate.
        mean_pressure: absolute, Pa.
        slack_share: by which each muscle is free of the other one, which is slackened.
        added_force: what effects add to the elastic force of each, N: a taut muscle pulls with it and
            without it.
        about: gauge pressures about which forces that are not affine in them are linearised, Pa; None: the
            mean.
    """

    effort: Expression
    q: Expression
    velocity: Expression
    mean_pressure: Expression
    slack_share: Pair = NONE
    added_force: Pair = NONE
    about: Pair | None = None


def pressures_for_effort(asked: Demand, axis: Axis) -> Allocation:
    """Return the pressures that give an effort.

    With both actuators taut, Eqs. (14) and (27) make the effort linear in both pressures: the pairs
    that give it lie on a line. On it the pair with the mean p_im is taken; where that leaves the
    limits, the nearest pair inside them: stiffness gives way before effort. Where one actuator comes near
    its highest pressure the other, if it is a muscle, should be slackened: it pulls and drags no more.
    While it is slackened the effort is exceeded by less than that pull.
    """
    settings, ambient = axis.nominal.control.position, axis.nominal.valve.ambient_pressure
    mean, high = asked.mean_pressure - ambient, settings.maximum_pressure - ambient
    slack = settings.minimum_pressure - ambient
    area, counter, damping = axis.forces(asked.q, asked.velocity, asked.about or (mean, mean))
    share, arm = axis.lever(asked.q)
    added = share * asked.added_force[0], asked.added_force[1]
    # without what effects add, too: from there their effort is counted
    slackening = _both(lambda force, more: force - ca.fmin(more, 0), counter, added)
    muscles = axis.actuators[0].pulls_only, axis.actuators[1].pulls_only
    # a muscle is taut at rest and as it shortens: else it would be asked for an effort that it has not
    taut = _both(lambda a, f, d: (f + ca.fmax(d, 0)) / a + settings.slack_margin, area, slackening, damping)
    low = _both(lambda muscle, p: ca.fmax(slack, p) if muscle else slack, muscles, taut)
    pull = asked.effort / arm
    # area[1] p[1] - area[0] p[0] = level
    level = pull + (counter[1] - counter[0] + damping[1] - damping[0])
    second = second_of_mean(level, mean, area)
    least = ca.fmax(low[1], (level + area[0] * low[0]) / area[1])
    most = ca.fmin(high, (level + area[0] * high) / area[1])
    second = _within(_within(second, least, most), low[1], high)
    first = _within((area[1] * second - level) / area[0], low[0], high)
    alone = (counter[0] + damping[0] - pull) / area[0], (counter[1] + damping[1] + pull) / area[1]
    needed = (area[1] * low[1] - level) / area[0], least
    # what is needed may be beyond the limit at which both were cut
    wanted = _both(ca.fmax, (first, second), needed)
    wanted = _both(lambda p, lone, share: p + share * (lone - p), wanted, alone, asked.slack_share)
    missed = ca.logic_or(wanted[0] > high, wanted[1] > high)
    cut = _both(lambda p: ca.fmin(p, high), wanted)
    slackened = _both(
        lambda p, share: p + share * (slack - p), cut, (asked.slack_share[1], asked.slack_share[0])
    )
    pressures = _both(lambda p: ca.fmax(p, slack), slackened)
    near = _both(lambda p: _within((p - high) / settings.slack_reserve + 1, 0, 1), needed)
    slack_share = _both(lambda share, slackens: share if slackens else 0.0, near, (muscles[1], muscles[0]))
    return Allocation(pressures, missed, slack_share)


def second_of_mean(level: Expression, mean: Expression, area: Pair) -> Expression:
    """Return the second gauge pressure of the pair with a mean where area[1] p[1] - area[0] p[0] = level."""
    return (level + 2 * mean * area[0]) / (area[0] + area[1])


def pressures_with_effects(asked: Demand, effect: Added | None, axis: Axis) -> Allocation:
    """Return what `pressures_for_effort` does, for the actuators and the nominal effects together.

    `effect` gives what the effects add along the reference. That hardly depends on the pressures, so that a
    few corrections find those at which both add up to the effort; so they do where a force is linearised.
    """
    allocated, rest = pressures_for_effort(asked, axis), asked
    for _ in range(0 if effect is None and axis.affine else effects.CORRECTIONS + 1):
        if effect is not None:
            added, forces = effect(allocated.pressures)
            rest = asked._replace(effort=asked.effort - added, added_force=(forces[0], forces[1]))
        allocated = pressures_for_effort(rest._replace(about=allocated.pressures), axis)
    return allocated


def given_effort(estimate: Expression, reference: Expression, axis: Axis) -> Expression:
    """Return an effort that is given in the place of the disturbance: of a law that is no expression."""
    return estimate[2]


def command_function(nominal: Parameters, effort_of: EffortOf = required_effort) -> ca.Function:
    """Return the position law as a function of numbers.

    (estimate, reference, mean pressure, slack share of each muscle, states of the effects, time, tuned
    values) -> (absolute pressures, saturated, clamped, wanted slack share, effort). A locked joint is asked
    for no effort: its motion cannot be fed back.
    """
    nominal, tuned = nominal.symbolic((*GAINS, *nominal.declared.live))
    axis, ambient = Axis(nominal), nominal.valve.ambient_pressure
    estimate = ca.SX.sym("estimate", 3)
    reference = ca.SX.sym("reference", 3)
    mean = ca.SX.sym("mean")
    law: Any = effects.added_by_effects(nominal)
    slack_share = ca.SX.sym("slack_share", 2)
    states, time = ca.SX.sym("states", law.size1_in(3) if law else 0), ca.SX.sym("time")

    def effect(gauge: Pair) -> tuple[Expression, Expression]:
        added, forces = law(reference[0], reference[1], ca.vertcat(*gauge) + ambient, states, time)
        return added, forces

    effort = 0.0 if axis.mechanism.locked else effort_of(estimate, reference, axis)
    asked = Demand(effort, estimate[0], estimate[1], mean, (slack_share[0], slack_share[1]))
    gauge, saturated, near = pressures_with_effects(asked, effect if law else None, axis)
    inputs = [estimate, reference, mean, slack_share, states, time, tuned]
    outputs = [ca.vertcat(*gauge) + ambient, saturated, axis.outside(estimate[0], gauge), ca.vertcat(*near)]
    outputs.append(ca.SX(effort))
    return ca.Function("position_command", inputs, outputs)


class PositionController:
    """Observer and backstepping law; knows the nominal model only.

    With effects in the nominal model their torque along the reference is a known input of the observer and
    of the law. With a lag of the valves in the nominal model the law plans for the instant at which it acts.
    """

    EFFORT: EffortOf = staticmethod(required_effort)

    def __init__(self, parameters: Parameters):
        nominal = position_nominal(parameters)
        self._channels = nominal.declared.channels
        self._observer = Observer(nominal)
        self._command = compiled(command_function(nominal, self.EFFORT))
        self._tuned = _tuned(nominal)
        self._mean = nominal.control.position.mean_pressure
        self._feedback: bool = nominal.control.position.feedback
        self._slack_share = [0.0, 0.0]
        self._change = nominal.scenario.control_period / nominal.control.position.slack_time
        self._sensors = Sensors(nominal)
        self._ahead = Anticipation(nominal)
        self._coupling = Coupling(nominal)
        self._now = AddedEffort(nominal)
        self._then = AddedEffort(nominal, self._ahead.horizon)

    def retune(self, parameters: Parameters) -> None:
        """Take the values of `live.of_position`; estimate and references go on from where they are."""
        self._tuned = _tuned(parameters)
        self._observer.retune(parameters)
        self._coupling.retune(parameters)

    def restart(self) -> None:
        """Begin anew at the next sample, wherever the load is then; what lives in the actuators goes on."""
        self._observer.restart()
        self._slack_share = [0.0, 0.0]
        self._ahead.restart()
        self._now.restart()
        self._then.restart()

    def step(
        self, position: float, pressures: Pressures, reference: Reference, periods: int = 1
    ) -> PositionCommand:
        """Return the reference pressures for one sample (rad or m, absolute Pa; finite numbers).

        It is so many of the position controller's periods later than the last one.
        """
        position, first, second = map(self._sensors.true, self._channels, (position, *pressures))
        pressures = first, second
        coupled = self._coupling.effort(reference)
        known = self._now.step(reference, pressures, periods) - coupled
        estimate = self._observer.step(position, pressures, known, periods)
        mean = self._mean if reference.mean_pressure is None else reference.mean_pressure
        if mean is Valve.CLOSED:
            return PositionCommand((Valve.CLOSED, Valve.CLOSED), *estimate, False, False)
        wanted, saturated, clamped, effort = self._wanted(estimate, reference, mean, pressures, periods)
        return PositionCommand(wanted, *estimate, saturated, clamped, effort)

    def _wanted(
        self,
        estimate: Estimate,
        reference: Reference,
        mean: float,
        pressures: Pressures,
        periods: int,
    ) -> Limited:
        """Return the reference pressures and what limits them, at the instant at which they act."""
        horizon, then, point, effect = self._ahead.horizon, reference, estimate[:3], self._now
        if horizon:
            then, effect = self._ahead.reference(reference, periods), self._then
            effect.step(then, pressures, periods)
            point = self._ahead.estimate(estimate, reference, then)
        point = *point[:2], point[2] + self._coupling.effort(then, horizon)
        asked = self._law(self._fed_back(point, then), then, mean, effect, periods)
        if horizon:
            self._ahead.note(self._correction(point, then))
        return asked

    def _fed_back(self, estimate: Sequence[float], reference: Reference) -> Sequence[float]:
        """Return the estimate or, without feedback, what the reference would have it be."""
        return estimate if self._feedback else (reference.position, reference.velocity, 0.0)

    def _correction(self, point: Sequence[float], reference: Reference) -> float:
        """Return by how much the acceleration that is asked for is beyond that of the reference."""
        c1, c2 = self._tuned[:2]
        wanted: float = desired_acceleration(point, reference[:3], c1, c2)
        return wanted - reference.acceleration

    def _ask(self, periods: int, *inputs: Any) -> Any:
        """Return pressures, saturated, clamped, wanted slack shares and effort, see `command_function`."""
        return self._command(*inputs)

    def _law(
        self, estimate: Sequence[float], reference: Reference, mean: float, effect: AddedEffort, periods: int
    ) -> Limited:
        """Return what the pressures are to be; called once a step, before `_correction`."""
        states, time, change = effect.states, effect.time, periods * self._change
        inputs = estimate, reference[:3], mean, self._slack_share, states, time, self._tuned
        pressures, saturated, clamped, near, effort = self._ask(periods, *inputs)
        self._slack_share = [
            min(max(wanted, now - change), now + change)
            for wanted, now in zip(near.tolist(), self._slack_share, strict=True)
        ]
        first, second = pressures.tolist()
        return (first, second), bool(saturated[0]), bool(clamped[0]), float(effort[0])


def _tuned(parameters: Parameters) -> list[float]:
    return [parameters.at(key) for key in (*GAINS, *parameters.declared.live)]


def _both(function: Callable[..., Expression], *pairs: Pair) -> Pair:
    return function(*(pair[0] for pair in pairs)), function(*(pair[1] for pair in pairs))


def _within(value: Expression, low: Expression, high: Expression) -> Expression:
    return ca.fmin(ca.fmax(value, low), high)


def position_nominal(parameters: Parameters) -> Parameters:
    """Return the position controller's nominal model: its control period, s, is that of its own instants."""
    nominal, every = parameters.nominal(), parameters.control.position.every
    if every == 1:
        return nominal
    return nominal.substituted({"scenario.control_period": every * nominal.scenario.control_period})
