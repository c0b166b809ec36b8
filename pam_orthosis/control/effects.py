# SPDX-License-Identifier: Apache-2.0
"""The effects that the belief has switched on, in the form in which controllers use them.

Each function is cut out of the same assembly of equations that makes the emulated hardware and the
models of the gap workflow: an effect's equation stands in its own file and nowhere else.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from pam_orthosis.control.trajectory import Reference
from pam_orthosis.model import orthosis
from pam_orthosis.model.compiled import compiled
from pam_orthosis.model.effects import CATALOGUE
from pam_orthosis.model.effects.base import ActiveEffects, enabled
from pam_orthosis.model.integrate import runge_kutta_4
from pam_orthosis.model.parameters import Section

MECHANICAL = ("body", "force", "torque")
UNFORESEEN = ("periodic_torque",)  # its phase is another in each run: it is left to the observer
CHANNELS = ("angle", "extensor_pressure", "flexor_pressure")
PLAIN = len(orthosis.BASE_STATES)
MEMORY_STEP = 1.0e-4  # s, of the integration of an effect's states: play of 2 mrad at 10 rad/s has 20,000/s
STATE_STEP = 5.0e-4  # s, of the integration of a supply's states, which follow in 2 ms at the quickest
CORRECTIONS = 2  # of the argument of an inverse function: see `corrected`


def known(belief, *stages: str) -> tuple[str, ...]:
    """Return the names of the believed effects that enter at these stages, see `effects.base.STAGES`.

    Those that controllers cannot use are left out.
    """
    foreseen = [name for name in enabled(belief.effects) if name not in UNFORESEEN]
    return tuple(name for name in foreseen if CATALOGUE[name].stage in stages)


def assembled(belief, *names: str) -> orthosis.Assembly:
    """Return the equations that the controllers believe, with these of the believed effects."""
    m = belief.muscle.dmsp_20
    laws = dict.fromkeys(orthosis.MUSCLES, orthosis.polynomial_law(m))
    settings = Section("effects", {name: getattr(belief.effects, name) for name in names})
    return orthosis.assemble(orthosis.Hardware(belief.leg, m, belief.valve, laws, settings))


def extra_foot_mass(belief):
    """Return the mass at the ankle that the effects add, kg."""
    return assembled(belief, *known(belief, "body")).signals.extra_foot_mass


def added_by_effects(belief) -> ca.Function | None:
    """Return (angle, velocity, absolute pressures (2,), own states, time) -> what the effects add.

    It is the torque, N m, that all of them together add to the muscles', and the elastic forces of the
    muscles (2,), N: those decide whether a muscle hangs slack, Eq. (13). None if the belief has none.
    """
    names = known(belief, *MECHANICAL)
    if not names:
        return None
    whole, plain = assembled(belief, *names), assembled(belief)
    plain_x, plain_u = ca.vertcat(plain.x, plain.u), ca.vertcat(whole.x[:PLAIN], whole.u)
    with_them, without = (
        ca.vertcat(s.torque, *(getattr(s, f"{name}_force") for name in orthosis.MUSCLES))
        for s in (whole.signals, plain.signals)
    )
    inputs, added = _of_motion(belief, whole, with_them - ca.substitute(without, plain_x, plain_u))
    return ca.Function("added_by_effects", inputs, [added[0], added[1:]])


def effect_memory(belief) -> ca.Function:
    """Return (states, angle and velocity (2,) before, now, absolute pressures (2,), time) -> states now.

    In between, angle and velocity are taken as straight lines.
    """
    whole = assembled(belief, *known(belief, *MECHANICAL))
    inputs, rates = _of_motion(belief, whole, whole.rates[PLAIN:])
    rate = ca.Function("memory_rate", inputs, [rates])
    period = belief.scenario.control_period
    steps = max(1, round(period / MEMORY_STEP))
    z, motion, pressures, time = (ca.SX.sym(name, size) for name, size in _sizes(rates.shape[0]).items())
    moved = runge_kutta_4(lambda s: rate(motion[0], motion[1], pressures, s, time), z, period / steps)
    folded = ca.Function("memory_step", [z, motion, pressures, time], [moved]).fold(steps)
    z, before, pressures, time = (ca.MX.sym(name, size) for name, size in _sizes(rates.shape[0]).items())
    now = ca.MX.sym("now", 2)
    motions = before + (now - before) @ ca.DM((np.arange(steps) + 0.5) / steps).T
    after = folded(z, motions, ca.repmat(pressures, 1, steps), ca.repmat(time, 1, steps))
    return ca.Function("effect_memory", [z, before, now, pressures, time], [after])


def _sizes(states: int) -> dict[str, int]:
    """Return the inputs of an effect's memory and their sizes."""
    return {"states": states, "motion": 2, "pressures": 2, "time": 1}


class EffectTorque:
    """Torque of the believed effects along the reference motion.

    It is driven by the reference and by the measured pressures, never by the estimate: a known
    input for observer and controller, in no loop of its own. It is bounded as the effects are, it
    cannot chatter, and what reference and motion differ by is left to the observer.
    """

    def __init__(self, belief, ahead: float = 0.0):
        added = added_by_effects(belief)
        self.active = added is not None
        self.states = np.zeros(0)
        self.time = ahead
        self._period = belief.scenario.control_period
        self._motion: np.ndarray | None = None
        if added is not None:
            self._added, self._memory = compiled(added), compiled(effect_memory(belief))
            self.states = np.zeros(added.size1_in(3))

    def restart(self) -> None:
        """Take the next reference as it comes, without a motion to it."""
        self._motion = None

    def step(
        self, reference: Reference, extensor_pressure: float, flexor_pressure: float, periods: int = 1
    ) -> float:
        """Go on to a reference so many periods later; return the torque there, N m (absolute Pa)."""
        if not self.active:
            return 0.0
        motion, pressures = np.array(reference[:2]), np.array([extensor_pressure, flexor_pressure])
        if self._motion is not None:
            change = motion - self._motion
            for left in range(periods - 1, -1, -1):
                self._live_on(motion - change * (left / periods), pressures)
        self._motion = motion
        return float(self._added(motion[0], motion[1], pressures, self.states, self.time)[0][0])

    def _live_on(self, motion: np.ndarray, pressures: np.ndarray) -> None:
        """Let a period pass, to this motion."""
        self.time += self._period
        if len(self.states):
            self.states[:] = self._memory(self.states, self._motion, motion, pressures, self.time)[0]
        self._motion = motion


def flow_of_opening(belief, muscle: str) -> ca.Function:
    """Return (relative opening, absolute and supply pressure, Pa) -> mass flow with the effects, kg/s."""
    names = known(belief, "opening", "flow")
    opening, pressure, supply = (ca.SX.sym(name) for name in ("opening", "pressure", "supply"))
    whole = assembled(belief.substituted({"valve.supply_pressure": supply}), *names)
    s = SimpleNamespace(**vars(whole.signals))
    for name in orthosis.MUSCLES:
        setattr(s, f"{name}_opening", opening if name == muscle else ca.SX(0))
    active = ActiveEffects(
        CATALOGUE, Section("effects", {name: getattr(belief.effects, name) for name in names})
    )
    active.bind([])  # no effect of these stages has states
    active.stages(s, "opening")
    orthosis.flows(s)
    active.stages(s, "flow")
    index = orthosis.BASE_STATES.index(f"{muscle}_pressure")
    flow = ca.substitute(getattr(s, f"{muscle}_flow"), whole.x[index], pressure)
    return ca.Function(f"{muscle}_flow", [opening, pressure, supply], [flow])


def supply_after(belief, muscle: str) -> ca.Function | None:
    """Return (state, mass flow kg/s) -> state a period later, supply pressure Pa; None if it does not sag.

    Of the air that is drawn, that of one muscle is known: the other one's valve vents meanwhile.
    """
    if not known(belief, "supply"):
        return None
    state, flow = ca.SX.sym("state", len(supply_scales(belief))), ca.SX.sym("flow")
    drawn = {name: flow if name == muscle else 0.0 for name in orthosis.MUSCLES}
    period, after = belief.scenario.control_period, state
    steps = max(1, round(period / STATE_STEP))
    for _ in range(steps):
        after = runge_kutta_4(lambda z: supply(belief, z, drawn)[1], after, period / steps)
    return ca.Function("supply_after", [state, flow], [after, supply(belief, after, drawn)[0]])


def supply(belief, state, drawn: Mapping[str, Any]) -> tuple[Any, Any]:
    """Return supply pressure, Pa, and the rates of its state while the muscles draw mass flows, kg/s."""
    names = known(belief, "supply")
    active = ActiveEffects(
        CATALOGUE, Section("effects", {name: getattr(belief.effects, name) for name in names})
    )
    active.bind(ca.vertsplit(state))
    flows = {f"{muscle}_flow": flow for muscle, flow in drawn.items()}
    s = SimpleNamespace(supply_pressure=belief.valve.supply_pressure, **flows)
    active.stages(s, "supply")
    return s.supply_pressure, ca.vertcat(*active.rates(s))


def supply_scales(belief) -> tuple[float, ...]:
    """Return the typical size of each state of the supply."""
    return tuple(scale for name in known(belief, "supply") for scale in CATALOGUE[name].scales)


def gas_model(belief) -> orthosis.Assembly:
    """Return the assembly with the effects on volume, exponent and temperature, for Eq. (6)."""
    return assembled(belief, *known(belief, "gas"))


def sensor_readings(belief) -> dict[str, ca.Function]:
    """Return the functions true value -> reading of the channels with a believed static error."""
    names = tuple(name for name in known(belief, "sensor") if not CATALOGUE[name].states)
    whole = assembled(belief, *names)
    readings = {}
    for name in CHANNELS:
        reading = getattr(whole.signals, f"measured_{name}")
        true = whole.x[orthosis.BASE_STATES.index(name)]
        if not ca.is_equal(reading, true):
            readings[name] = ca.Function(f"{name}_reading", [true], [reading])
    return readings


class Sensors:
    """Takes the believed static errors out of readings; without any it passes them on."""

    def __init__(self, belief):
        self._inverse = {name: compiled(_unread(name, f)) for name, f in sensor_readings(belief).items()}

    def true(self, channel: str, reading: float) -> float:
        """Return the value that `angle`, `extensor_pressure` or `flexor_pressure` has at a reading."""
        inverse = self._inverse.get(channel)
        return reading if inverse is None else float(inverse(reading)[0][0])


def _unread(name: str, reading: ca.Function) -> ca.Function:
    shown = ca.SX.sym("shown")
    return ca.Function(f"true_{name}", [shown], [corrected(lambda x: x, reading, shown, 4)])


def corrected(inverse, function, wanted, corrections: int = CORRECTIONS):
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


def command_lag(belief) -> float:
    """Return the time from a sample to the slow flow that answers it, s: dead time and lag of the spool."""
    names = known(belief, "command")
    late = [name for name in names if CATALOGUE[name].late is not None]
    delay = belief.valve.delay + sum(CATALOGUE[name].late(getattr(belief.effects, name)) for name in late)
    return max(0.0, delay + _lag(belief, *(name for name in names if name not in late)))


def _lag(belief, *names: str) -> float:
    """Return the delay of slow signals between voltage and spool by these effects, s: -G'(0) / G(0)."""
    if not names:
        return 0.0
    whole = assembled(belief, *names)
    z, rates = whole.x[PLAIN:], whole.rates[PLAIN:]
    spool, voltage = whole.signals.extensor_voltage, whole.u[0]
    pairs = (rates, z), (rates, voltage), (spool, z), (spool, voltage)
    a, b, c, d = (np.array(ca.evalf(ca.jacobian(*pair))) for pair in pairs)
    once = np.linalg.solve(a, b)
    return float(((c @ np.linalg.solve(a, once)) / (d - c @ once))[0, 0])


def _of_motion(belief, whole, expression):
    """Return the inputs of a function of the motion, and the expression with the valves closed."""
    time, closed = ca.SX.sym("time"), belief.valve.closed_voltage
    inputs = [whole.x[0], whole.x[1], whole.x[2:PLAIN], whole.x[PLAIN:], time]
    return inputs, ca.substitute(expression, whole.u, ca.vertcat(closed, closed, 0, time))
