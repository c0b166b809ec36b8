# SPDX-License-Identifier: Apache-2.0
"""The effects that the nominal model has switched on, in the form in which controllers use them.

Each function is cut out of the same assembly of equations that makes the emulated hardware and the
models of the gap workflow: an effect's equation stands in its own file and nowhere else.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from pam_orthosis.control.reference import Pressures, Reference
from pam_orthosis.model import assembly
from pam_orthosis.model.compiled import compiled
from pam_orthosis.model.effects.base import ActiveEffects, Effect, enabled
from pam_orthosis.model.effects.described import Described
from pam_orthosis.model.integrate import runge_kutta_4
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.rows import Section
from pam_orthosis.model.signals import Expression

Array: TypeAlias = NDArray[np.float64]

MECHANICAL = ("body", "force", "torque")
UNFORESEEN = ("periodic_torque",)  # its phase is another in each run: it is left to the observer
CORRECTIONS = 2  # of the argument of an inverse function: see `corrected`


def known(nominal: Parameters, *stages: str) -> tuple[str, ...]:
    """Return the names of the nominal effects that enter at these stages, see `effects.base.STAGES`.

    Those that controllers cannot use are left out.
    """
    machine = nominal.declared
    own = {name: machine.possible[name] for name in enabled(nominal.at(machine.branch))}
    return tuple(
        name
        for name, effect in own.items()
        if effect.stage in stages and _is_usable(effect, values(nominal, name))
    )


def _is_usable(effect: Effect, settings: Section) -> bool:
    """Return whether controllers can foresee what an effect does: a drift is another in each run."""
    if not isinstance(effect, Described):
        return effect.name not in UNFORESEEN
    return effect.stage in MECHANICAL and settings.coordinate != "time"


def assembled(nominal: Parameters, *names: str) -> assembly.Assembly:
    """Return the equations of the controllers' nominal model, with these of the nominal effects."""
    return assembly.assemble(assembly.nominal(nominal.declared, nominal, _settings(nominal, names)))


def values(nominal: Parameters, name: str) -> Section:
    """Return the settings of a nominal effect."""
    of: Section = nominal.at(f"{nominal.declared.branch}.{name}")
    return of


def _active(nominal: Parameters, names: Sequence[str], states: ca.SX) -> ActiveEffects:
    active = ActiveEffects(nominal.declared.possible, _settings(nominal, names))
    active.bind(ca.vertsplit(states))
    return active


def _settings(nominal: Parameters, names: Sequence[str]) -> Section:
    return Section("effects", {name: values(nominal, name) for name in names})


def inputs(nominal: Parameters, time: Expression) -> Expression:
    """Return the inputs of an assembly at a time, valves closed and nothing acting from outside."""
    machine = nominal.declared
    voltages, external = len(machine.names), len(machine.inputs) - len(machine.names) - 1
    return ca.vertcat(*[nominal.valve.closed_voltage] * voltages, *[0] * external, time)


def extra_mass(nominal: Parameters) -> Expression:
    """Return the mass that the effects add to the load, kg."""
    return assembled(nominal, *known(nominal, "body")).signals.extra_mass


def added_by_effects(nominal: Parameters) -> ca.Function | None:
    """Return (coordinate, velocity, absolute pressures, own states, time) -> what the effects add.

    It is the torque or force that all of them together add to the actuators', and the actuators' elastic
    forces, N: those decide whether a muscle hangs slack, Eq. (13). None if the nominal model has none.
    """
    names = known(nominal, *MECHANICAL)
    if not names:
        return None
    whole, plain = assembled(nominal, *names), assembled(nominal)
    plain_x = ca.vertcat(plain.x, plain.u)
    plain_u = ca.vertcat(whole.x[: len(plain.states)], whole.u)
    with_them, without = (
        ca.vertcat(s.effort, *(a.force for a in s.actuators.values())) for s in (whole.signals, plain.signals)
    )
    of, added = _of_motion(nominal, whole, with_them - ca.substitute(without, plain_x, plain_u))
    return ca.Function("added_by_effects", of, [added[0], added[1:]])


def effect_memory(nominal: Parameters) -> ca.Function:
    """Return (states, coordinate and velocity (2,) before, now, absolute pressures, time) -> states now.

    In between, coordinate and velocity are taken as straight lines.
    """
    whole = assembled(nominal, *known(nominal, *MECHANICAL))
    of, rates = _of_motion(nominal, whole, whole.rates[len(nominal.declared.states) :])
    rate = ca.Function("memory_rate", of, [rates])
    period = nominal.scenario.control_period
    memory_step = 1.0e-4  # s, of the integration: play of 2 mrad at 10 rad/s has 20,000/s
    steps = max(1, round(period / memory_step))
    sizes = rate.size1_in(3), 2, rate.size1_in(2), 1
    z, motion, pressures, time = (ca.SX.sym("of_step", size) for size in sizes)
    moved = runge_kutta_4(lambda s: rate(motion[0], motion[1], pressures, s, time), z, period / steps)
    folded = ca.Function("memory_step", [z, motion, pressures, time], [moved]).fold(steps)
    first, before, held, at = (ca.MX.sym("of_period", size) for size in sizes)
    now = ca.MX.sym("now", 2)
    motions = before + (now - before) @ ca.DM((np.arange(steps) + 0.5) / steps).T
    after = folded(first, motions, ca.repmat(held, 1, steps), ca.repmat(at, 1, steps))
    return ca.Function("effect_memory", [first, before, now, held, at], [after])


class AddedEffort:
    """Torque or force of the nominal effects along the reference motion.

    It is driven by the reference and by the measured pressures, never by the estimate: a known
    input for observer and controller, in no loop of its own. It is bounded as the effects are, it
    cannot chatter, and what reference and motion differ by is left to the observer.
    """

    def __init__(self, nominal: Parameters, ahead: float = 0.0):
        added = added_by_effects(nominal)
        self.active = added is not None
        self.states = np.zeros(0)
        self.time = ahead
        self._period = nominal.scenario.control_period
        self._motion: Array | None = None
        if added is not None:
            self._added, self._memory = compiled(added), compiled(effect_memory(nominal))
            self.states = np.zeros(added.size1_in(3))

    def restart(self) -> None:
        """Take the next reference as it comes, without a motion to it."""
        self._motion = None

    def step(self, reference: Reference, pressures: Pressures, periods: int = 1) -> float:
        """Go on to a reference so many periods later; return what is added there (absolute Pa)."""
        if not self.active:
            return 0.0
        motion, held = np.array(reference[:2]), np.array(pressures)
        if (before := self._motion) is not None:
            change = motion - before
            for left in range(periods - 1, -1, -1):
                now = motion - change * (left / periods)
                self._live_on(before, now, held)
                before = now
        self._motion = motion
        return float(self._added(motion[0], motion[1], held, self.states, self.time)[0][0])

    def _live_on(self, before: Array, now: Array, pressures: Array) -> None:
        """Let a period pass, from one motion to another."""
        self.time += self._period
        if len(self.states):
            self.states[:] = self._memory(self.states, before, now, pressures, self.time)[0]


def flow_of_opening(nominal: Parameters, actuator: str) -> ca.Function:
    """Return (relative opening, absolute and supply pressure, Pa) -> mass flow with the effects, kg/s."""
    names = known(nominal, "opening", "flow")
    opening, pressure, supply = (ca.SX.sym(name) for name in ("opening", "pressure", "supply"))
    whole = assembled(nominal.substituted({"valve.supply_pressure": supply}), *names)
    s = whole.signals.copy()
    for name, a in s.actuators.items():
        a.opening = opening if name == actuator else ca.SX(0)
    active = _active(nominal, names, ca.SX(0, 1))  # no effect of these stages has states
    active.stages(s, "opening")
    assembly.set_flows(s)
    active.stages(s, "flow")
    flow = ca.substitute(s.actuators[actuator].flow, whole.signals.actuators[actuator].pressure, pressure)
    return ca.Function(f"{actuator}_flow", [opening, pressure, supply], [flow])


def supply_after(nominal: Parameters, actuator: str) -> ca.Function | None:
    """Return (state, mass flow kg/s) -> state a period later, supply pressure Pa; None if it does not sag.

    Of the air that is drawn, that of one actuator is known: the other one's valve vents meanwhile.
    """
    if not known(nominal, "supply"):
        return None
    state, flow = ca.SX.sym("state", len(supply_scales(nominal))), ca.SX.sym("flow")
    drawn = {name: flow if name == actuator else 0.0 for name in nominal.declared.names}
    period, after = nominal.scenario.control_period, state
    state_step = 5.0e-4  # s, of the integration of a supply's states, which follow in 2 ms at the quickest
    steps = max(1, round(period / state_step))
    for _ in range(steps):
        after = runge_kutta_4(lambda z: supply(nominal, z, drawn)[1], after, period / steps)
    return ca.Function("supply_after", [state, flow], [after, supply(nominal, after, drawn)[0]])


def supply(
    nominal: Parameters, state: ca.SX, drawn: Mapping[str, Expression]
) -> tuple[Expression, Expression]:
    """Return supply pressure, Pa, and the rates of its state while the actuators draw mass flows, kg/s."""
    s, active = assembled(nominal).signals, _active(nominal, known(nominal, "supply"), state)
    for name, flow in drawn.items():
        s.actuators[name].flow = flow
    active.stages(s, "supply")
    return s.air.supply_pressure, ca.vertcat(*active.rates(s))


def supply_scales(nominal: Parameters) -> tuple[float, ...]:
    """Return the typical size of each state of the supply."""
    catalogue = nominal.declared.catalogue
    return tuple(scale for name in known(nominal, "supply") for scale in catalogue[name].scales)


def gas_model(nominal: Parameters) -> assembly.Assembly:
    """Return the assembly with the effects on volume, exponent and temperature, for Eq. (6)."""
    return assembled(nominal, *known(nominal, "gas"))


def sensor_readings(nominal: Parameters) -> dict[str, ca.Function]:
    """Return the functions true value -> reading of the channels with a nominal static error."""
    machine = nominal.declared
    whole = assembled(nominal, *(n for n in known(nominal, "sensor") if not machine.catalogue[n].states))
    readings = {}
    for name, reading in zip(machine.channels, ca.vertsplit(whole.measured), strict=True):
        true = whole.x[machine.states.index(name)]
        if not ca.is_equal(reading, true):
            readings[name] = ca.Function(f"{name}_reading", [true], [reading])
    return readings


class Sensors:
    """Takes the nominal static errors out of readings; without any it passes them on."""

    def __init__(self, nominal: Parameters):
        self._inverse = {}
        for name, reading in sensor_readings(nominal).items():
            shown = ca.SX.sym("shown")
            true = corrected(lambda x: x, reading, shown, 4)
            self._inverse[name] = compiled(ca.Function(f"true_{name}", [shown], [true]))

    def true(self, channel: str, reading: float) -> float:
        """Return the value that a channel of the machine has at a reading."""
        inverse = self._inverse.get(channel)
        return reading if inverse is None else float(inverse(reading)[0][0])


def corrected(
    inverse: Callable[[Expression], Expression],
    function: Callable[[Expression], Expression],
    wanted: Expression,
    corrections: int = CORRECTIONS,
) -> Expression:
    """Return x with function(x) = wanted, from the inverse of a function that is nearly the same.

    Each correction asks the known inverse for what was missed; the rest shrinks by the relative
    difference of the two functions each time.
    """
    asked = wanted
    x = inverse(asked)
    for _ in range(corrections):
        asked = asked + (wanted - function(x))
        x = inverse(asked)
    return x


def command_lag(nominal: Parameters) -> float:
    """Return the time from a sample to the slow flow that answers it, s: dead time and lag of the spool."""
    names = known(nominal, "command")
    late = {name: of for name in names if (of := nominal.declared.catalogue[name].late) is not None}
    delay: float = nominal.valve.delay + sum(of(values(nominal, name)) for name, of in late.items())
    return max(0.0, delay + _lag(nominal, *(name for name in names if name not in late)))


def _lag(nominal: Parameters, *names: str) -> float:
    """Return the delay of slow signals between voltage and spool by these effects, s: -G'(0) / G(0)."""
    if not names:
        return 0.0
    whole = assembled(nominal, *names)
    plain = len(nominal.declared.states)
    z, rates = whole.x[plain:], whole.rates[plain:]
    spool, voltage = whole.signals.actuators[nominal.declared.names[0]].voltage, whole.u[0]
    pairs = (rates, z), (rates, voltage), (spool, z), (spool, voltage)
    a, b, c, d = (np.array(ca.evalf(ca.jacobian(*pair))) for pair in pairs)
    once = np.linalg.solve(a, b)
    return float(((c @ np.linalg.solve(a, once)) / (d - c @ once))[0, 0])


def _of_motion(nominal: Parameters, whole: assembly.Assembly, expression: ca.SX) -> tuple[list[ca.SX], ca.SX]:
    """Return the inputs of a function of the motion, and the expression with the valves closed."""
    time, plain = ca.SX.sym("time"), len(nominal.declared.states)
    of = [whole.x[0], whole.x[1], whole.x[2:plain], whole.x[plain:], time]
    return of, ca.substitute(expression, whole.u, inputs(nominal, time))
