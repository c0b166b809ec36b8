# SPDX-License-Identifier: Apache-2.0
"""The knee with its two muscles as one set of equations: mechanics, gas, valves and effects.

The same assembly serves the emulated hardware, the controllers' model and the gap workflow; they
differ in parameters, in the muscle law and in the effects that are on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace

import casadi as ca

from pam_orthosis.model import leg as leg_model
from pam_orthosis.model import muscle as muscle_model
from pam_orthosis.model import pneumatics
from pam_orthosis.model.effects import CATALOGUE
from pam_orthosis.model.effects.base import ActiveEffects

MUSCLES = ("extensor", "flexor")
BASE_STATES = ("angle", "velocity", "extensor_pressure", "flexor_pressure")
# `time` is that since the start of the run, s
INPUTS = ("extensor_voltage", "flexor_voltage", "external_torque", "time")
# what a model reports beside its states, in this order
OUTPUTS = (
    "torque",
    "extensor_contraction",
    "flexor_contraction",
    "extensor_rate",
    "flexor_rate",
    "extensor_tension",
    "flexor_tension",
    "extensor_flow",
    "flexor_flow",
    "measured_angle",
    "measured_extensor_pressure",
    "measured_flexor_pressure",
)


@dataclass(frozen=True)
class MuscleLaw:
    """Static force and volume of one muscle as functions of contraction and gauge pressure."""

    force: object
    volume: object


@dataclass(frozen=True)
class Hardware:
    """What an assembly is built from: sections of parameters, one law a muscle, effect settings."""

    leg: object
    muscle: object
    valve: object
    laws: dict[str, MuscleLaw]
    effects: object
    # (angle, velocity, leg, extra foot mass) -> Mechanics; the gap workflow gives tabulated terms
    mechanics: Callable = leg_model.mechanics


@dataclass(frozen=True)
class Assembly:
    """State-space form: names, symbols and expressions (x, u -> rates, outputs)."""

    states: tuple[str, ...]
    x: ca.SX
    u: ca.SX
    rates: ca.SX
    outputs: ca.SX
    signals: SimpleNamespace = field(repr=False)

    @property
    def measured(self) -> ca.SX:
        """What noise-free sensors would show: angle, both pressures."""
        s = self.signals
        return ca.vertcat(s.measured_angle, s.measured_extensor_pressure, s.measured_flexor_pressure)

    def function(self, name: str) -> ca.Function:
        """Return the CasADi function (x, u) -> (rates, outputs)."""
        return ca.Function(name, [self.x, self.u], [self.rates, self.outputs])


def polynomial_law(m) -> MuscleLaw:
    """Return the law that controllers believe: Eqs. (14) and (16)-(17)."""
    return MuscleLaw(
        lambda dl, p: muscle_model.towing_force(dl, p, m),
        lambda dl, p: muscle_model.volume(dl, p, m),
    )


def geometric_law(m, scale=1.0, shortened=0.0) -> MuscleLaw:
    """Return the law of the braid's geometry; `scale` is the specimen's force / nominal force.

    `shortened` is by how much more than believed it is contracted as it is mounted, m.
    """
    return MuscleLaw(
        lambda dl, p: scale * muscle_model.geometric_force(dl + shortened, p, m),
        lambda dl, p: muscle_model.geometric_volume(dl + shortened, p, m),
    )


def assemble(hardware: Hardware) -> Assembly:
    """Return the equations of motion and gas with all effects that are on."""
    effects = ActiveEffects(CATALOGUE, hardware.effects)
    names = (*BASE_STATES, *effects.states)
    x, u = ca.SX.sym("x", len(names)), ca.SX.sym("u", len(INPUTS))
    effects.bind(ca.vertsplit(x)[len(BASE_STATES) :])
    signals = _signals(x, u, hardware)
    valves_to_forces(signals, hardware.laws, effects)
    _tensions(signals, hardware)
    _torque(signals, hardware)
    effects.stages(signals, "torque")
    _motion(signals, hardware)
    _sensors(signals)
    effects.stages(signals, "sensor")
    rates = [signals.velocity, signals.acceleration]
    rates += [signals.extensor_pressure_rate, signals.flexor_pressure_rate, *effects.rates(signals)]
    outputs = ca.vertcat(*(getattr(signals, name) for name in OUTPUTS))
    return Assembly(names, x, u, ca.vertcat(*rates), outputs, signals)


def valves_to_forces(signals: SimpleNamespace, laws: dict[str, MuscleLaw], effects: ActiveEffects) -> None:
    """Evaluate a pair of muscles with valves and gas, from the voltages to the static forces."""
    effects.stages(signals, "body", "supply", "command", "spool")
    _openings(signals)
    effects.stages(signals, "opening")
    flows(signals)
    effects.stages(signals, "flow")
    _volumes(signals, laws)
    effects.stages(signals, "gas")
    gas(signals)
    _static_forces(signals, laws)
    effects.stages(signals, "force")


def _signals(x, u, hardware: Hardware) -> SimpleNamespace:
    q, velocity, pe, pf = x[0], x[1], x[2], x[3]
    contraction_e, contraction_f = leg_model.contractions(q, hardware.leg)
    ambient = hardware.valve.ambient_pressure
    return SimpleNamespace(
        angle=q,
        velocity=velocity,
        extensor_pressure=pe,
        flexor_pressure=pf,
        extensor_gauge=pe - ambient,
        flexor_gauge=pf - ambient,
        extensor_contraction=contraction_e,
        flexor_contraction=contraction_f,
        extensor_rate=ca.jtimes(contraction_e, q, velocity),
        flexor_rate=ca.jtimes(contraction_f, q, velocity),
        extensor_voltage=u[0],
        flexor_voltage=u[1],
        external_torque=u[2],
        time=u[3],
        supply_pressure=hardware.valve.supply_pressure,
        extra_foot_mass=0.0,
        extensor_dead_volume=hardware.valve.hose.volume,
        flexor_dead_volume=hardware.valve.hose.volume,
        polytropic_exponent=hardware.valve.polytropic_exponent,
        temperature=hardware.valve.temperature,
        extensor_line_drop=0.0,
        flexor_line_drop=0.0,
        valve=hardware.valve,
        leg=hardware.leg,
        muscle=hardware.muscle,
        extensor_length=hardware.muscle.length,
        flexor_length=hardware.muscle.length,
    )


def _openings(s) -> None:
    for name in MUSCLES:
        opening = pneumatics.relative_opening(getattr(s, f"{name}_voltage"), s.valve)
        setattr(s, f"{name}_opening", opening)


def flows(s) -> None:
    """Set the mass flows, kg/s, that the openings pass."""
    for name in MUSCLES:
        opening, pressure = getattr(s, f"{name}_opening"), getattr(s, f"{name}_pressure")
        flow = pneumatics.valve_flow(opening, pressure, s.supply_pressure, s.valve)
        setattr(s, f"{name}_flow", flow)


def _volumes(s, laws: dict[str, MuscleLaw]) -> None:
    for name in MUSCLES:
        contraction, gauge = getattr(s, f"{name}_contraction"), getattr(s, f"{name}_gauge")
        terms = volume_terms(laws[name].volume, contraction, gauge)
        for kind, term in zip(("volume", "volume_by_pressure", "volume_by_contraction"), terms, strict=True):
            setattr(s, f"{name}_{kind}", term)


def gas(s) -> None:
    """Set the rates of the pressures, Pa/s, from the mass flows."""
    state = SimpleNamespace(polytropic_exponent=s.polytropic_exponent, temperature=s.temperature)
    for name in MUSCLES:
        rate = pneumatics.pressure_rate(
            getattr(s, f"{name}_pressure"),
            getattr(s, f"{name}_flow"),
            getattr(s, f"{name}_rate"),
            getattr(s, f"{name}_volume") + getattr(s, f"{name}_dead_volume"),
            getattr(s, f"{name}_volume_by_pressure"),
            getattr(s, f"{name}_volume_by_contraction"),
            state,
        )
        setattr(s, f"{name}_pressure_rate", rate)


def _static_forces(s, laws: dict[str, MuscleLaw]) -> None:
    for name in MUSCLES:
        law = laws[name]
        contraction, gauge = getattr(s, f"{name}_contraction"), getattr(s, f"{name}_gauge")
        setattr(s, f"{name}_force", law.force(contraction, gauge))


def _tensions(s, hardware: Hardware) -> None:
    for name in MUSCLES:
        elastic, rate = getattr(s, f"{name}_force"), getattr(s, f"{name}_rate")
        setattr(s, f"{name}_tension", muscle_model.tension(elastic, rate, hardware.muscle))


def _torque(s, hardware: Hardware) -> None:
    s.torque = leg_model.knee_torque(s.extensor_tension, s.flexor_tension, hardware.leg)
    s.torque += leg_model.stop_torque(s.angle, s.velocity, hardware.leg.joint)
    s.torque += s.external_torque


def _motion(s, hardware: Hardware) -> None:
    if hardware.leg.joint.locked:
        s.acceleration = ca.SX(0)
        return
    terms = hardware.mechanics(s.angle, s.velocity, hardware.leg, s.extra_foot_mass)
    s.acceleration = acceleration(s.torque, terms)


def _sensors(s) -> None:
    s.measured_angle = s.angle
    s.measured_extensor_pressure = s.extensor_pressure + s.extensor_line_drop
    s.measured_flexor_pressure = s.flexor_pressure + s.flexor_line_drop


def acceleration(torque, terms):
    """Return q-double-dot of Eq. (26) for the sum of all torques on the knee, rad/s^2."""
    return (torque - terms.coriolis - terms.gravity) / terms.inertia


def volume_terms(law, contraction, gauge):
    """Return V, dV/dp and dV/d(dL) of a volume law, for Eq. (6)."""
    dl, p = ca.SX.sym("dl"), ca.SX.sym("p")
    volume = law(dl, p)
    terms = [volume, ca.gradient(volume, p), ca.gradient(volume, dl)]
    return ca.substitute(terms, [dl, p], [ca.SX(contraction), ca.SX(gauge)])
