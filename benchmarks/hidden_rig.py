# SPDX-License-Identifier: Apache-2.0
"""Blind recordings of the test rig: a second realisation of it, with the interface of `model.rig.RigPlant`.

Muscles, valves and gas are those of `physics`; the carriage's friction is LuGre's.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from pam_orthosis.control.rig_loop import DIAGNOSTIC_START, Rig, diagnostic_procedure
from pam_orthosis.model.parameters import Parameters, Section, load
from pam_orthosis.testing import physics
from pam_orthosis.testing.case import Recording
from pam_orthosis.testing.physics import STEP, compiled
from pam_orthosis.testing.plant import NO_DEVIATION, PRESSURE_NOISE, PRESSURE_RESOLUTION, VOLTAGE_RESOLUTION
from pam_orthosis.testing.quantities import Apparatus, Hidden, maps, muscle_and_valve, muscle_laws

POSITION_NOISE, POSITION_RESOLUTION = 5.0e-6, 1.0e-5  # m
FORCE_NOISE, FORCE_RESOLUTION = 2.0, 1.0  # N
BRISTLE_STIFFNESS = 2.0e4  # 1/m: 50 um of pre-sliding
STRIBECK, STRIBECK_VELOCITY = 0.2, 0.005  # rise at low speed, m/s
SPECIMEN = "dmsp_20"
MUSCLES = "specimen", "positioner"
X, V, PE, PF, BRISTLE, CE1, CE2, CF1, CF2 = range(9)
STATES = 9


class RigMeasurement(NamedTuple):
    """One sample of the sensors: carriage position m, absolute pressures Pa, load cell N."""

    position: float
    specimen_pressure: float
    positioner_pressure: float
    force: float


class RigTruth(NamedTuple):
    """The true state as far as it is known here: m, m/s, N, absolute Pa."""

    position: float
    velocity: float
    specimen_force: float
    specimen_pressure: float
    positioner_pressure: float


@compiled
def carriage_friction(bristle, v, h):
    """Return LuGre's force and the rate of its bristle (in units of the Coulomb force)."""
    if h.coulomb == 0.0:
        return 0.0, 0.0
    level = 1 + STRIBECK * np.exp(-((v / STRIBECK_VELOCITY) ** 2))
    rate = BRISTLE_STIFFNESS * (v - abs(v) * bristle / level)
    return h.coulomb * (bristle + 2.0e-4 * rate), rate


@compiled
def rates(x, out, t, ue, uf, anchors, mass, offset, ae, af, h, me, mf):
    """Write the rates of all states; return the tension of the investigated muscle, N."""
    xe, xf, re = x[X], offset - x[X], x[V]
    ge, gf = x[PE] - ae.ambient, x[PF] - af.ambient
    oe = physics.spool_opening(ue, h.valve_gain_e, me.valve_waves[0], ae, h)
    of = physics.spool_opening(uf, h.valve_gain_f, me.valve_waves[1], af, h)
    fe = physics.valve_flow(oe, x[PE], ae.supply, ae, h)
    ff = physics.valve_flow(of, x[PF], af.supply, af, h)
    out[PE] = physics.pressure_rate(x[PE], fe, xe, re, h.leak_e, 0.0, me.volume_waves[0], t, ae, h, me)
    out[PF] = physics.pressure_rate(x[PF], ff, xf, -re, h.leak_f, 0.0, mf.volume_waves[1], t, af, h, mf)
    out[CE1], out[CE2] = re - x[CE1] / 0.6, re - x[CE2] / 1.8
    out[CF1], out[CF2] = -re - x[CF1] / 0.6, -re - x[CF2] / 1.8
    ce, cf = 0.6 * x[CE1] + 0.4 * x[CE2], 0.6 * x[CF1] + 0.4 * x[CF2]
    scale = ae.force * h.force_scale_e
    te = physics.muscle(xe, re, ge, ce, scale, anchors[0], me.force_waves[0], ae, h, me)
    tf = physics.muscle(xf, -re, gf, cf, af.force, anchors[1], mf.force_waves[1], af, h, mf)
    rubbing, out[BRISTLE] = carriage_friction(x[BRISTLE], x[V], h)
    out[X] = x[V]
    out[V] = (te - tf - rubbing) / mass
    return te


@compiled
def advance(x, anchors, t, steps, ue, uf, mass, offset, ae, af, h, me, mf):
    """Advance all states by `steps` with the valve voltages (above closed, V) held."""
    k1, k2, middle = np.zeros(STATES), np.zeros(STATES), np.zeros(STATES)
    for n in range(steps):
        rates(x, k1, t + n * STEP, ue, uf, anchors, mass, offset, ae, af, h, me, mf)
        for i in range(STATES):
            middle[i] = x[i] + STEP * k1[i]
        rates(middle, k2, t + (n + 1) * STEP, ue, uf, anchors, mass, offset, ae, af, h, me, mf)
        for i in range(STATES):
            x[i] += 0.5 * STEP * (k1[i] + k2[i])
        for i in range(physics.ELEMENTS):
            d, xf = physics.slip_distance(i), offset - x[X]
            anchors[0, i] = physics.clip(anchors[0, i], x[X] - d, x[X] + d)
            anchors[1, i] = physics.clip(anchors[1, i], xf - d, xf + d)


class HiddenRig:
    """Emulated rig for blind tests, advanced one control period at a time.

    Args:
        parameters: the nominal model; what the rig is without hidden effects.
        hidden: sizes of the hidden effects.
        deviations: of the nuisance parameters, by the names of the rig's calibrations.
        position: of the carriage at the start, m; the investigated muscle begins at ambient pressure, the
            MAS-40 at the pressure at which it begins to pull.
        seed: of the sensor noise.
    """

    def __init__(
        self,
        parameters: Parameters,
        hidden: Hidden,
        deviations: Mapping[str, float],
        position: float,
        seed: int,
    ):
        rig, valve, muscles = parameters.rig, parameters.valve, parameters.muscle
        self._off = off = defaultdict(float, deviations)
        self.period_ns, self._steps = round(rig.control_period * 1e9), round(rig.control_period / STEP)
        self._physics = (
            rig.carriage_mass * (1 + off["carriage_mass"]),
            rig.position_offset + off["position_offset"],
            apparatus(parameters, muscles.dmsp_20, off, "specimen"),
            apparatus(parameters, muscles.mas_40, off, "positioner"),
            hidden,
            maps(muscle_laws(muscles.dmsp_20)),
            maps(muscle_laws(muscles.mas_40)),
        )
        self._closed, self._half_span = valve.closed_voltage, valve.maximum_voltage - valve.closed_voltage
        self._noise, self._index, self._held = np.random.default_rng(seed), 0, (0.0, 0.0)
        taut = valve.ambient_pressure + slack_gauge(rig.position_offset - position, muscles.mas_40)
        self.x = np.zeros(STATES)
        self.x[:4] = position, 0.0, valve.ambient_pressure, taut
        self._anchors = np.outer([position, self._physics[1] - position], np.ones(physics.ELEMENTS))

    def measure(self) -> RigMeasurement:
        """Return noisy, quantised sensor readings; draws noise once a call."""
        pressures = (
            self.x[p] + self._off[f"{m}_pressure_offset"] for p, m in ((PE, MUSCLES[0]), (PF, MUSCLES[1]))
        )
        force = (1 + self._off["load_cell_scale"]) * self._tension() + self._off["load_cell_offset"]
        true = (self.x[X], *pressures, force)
        spread = (POSITION_NOISE, PRESSURE_NOISE, PRESSURE_NOISE, FORCE_NOISE)
        steps = (POSITION_RESOLUTION, PRESSURE_RESOLUTION, PRESSURE_RESOLUTION, FORCE_RESOLUTION)
        rows = zip(true, spread, steps, self._noise.standard_normal(4), strict=True)
        return RigMeasurement(*(float(np.round((v + s * n) / step) * step) for v, s, step, n in rows))

    def advance(self, specimen_voltage: float, positioner_voltage: float, hand: float | None = None) -> None:
        """Integrate one control period with the voltages held (there is no hand)."""
        volts = (specimen_voltage, positioner_voltage)
        limited = (min(max(v - self._closed, -self._half_span), self._half_span) for v in volts)
        self._held = tuple(
            round(v / VOLTAGE_RESOLUTION) * VOLTAGE_RESOLUTION + self._off[f"{m}_closed_voltage"]
            for v, m in zip(limited, MUSCLES, strict=True)
        )
        time = self._index * self._steps * STEP
        advance(self.x, self._anchors, time, self._steps, *self._held, *self._physics)
        self._index += 1

    def truth(self) -> RigTruth:
        """Return the true state."""
        position, velocity, *pressures = self.x[:4].tolist()
        return RigTruth(position, velocity, self._tension(), *pressures)

    def _tension(self) -> float:
        return rates(self.x, np.zeros(STATES), 0.0, *self._held, self._anchors, *self._physics)


def slack_gauge(contraction: float, m: Section) -> float:
    """Return the gauge pressure at which a muscle begins to pull, Pa."""
    place = physics.clip(contraction * (m.map_length / m.length), 0.0, m.box.maximum_contraction)
    area, counterforce = (physics.polynomial(np.array(c), place)[0] for c in (m.force.a, m.force.b))
    return counterforce / area


def apparatus(parameters: Parameters, m: Section, off: Mapping[str, float], muscle: str) -> Apparatus:
    """Return the true values of one muscle with its valve."""
    damping = off[f"{muscle}_damping"]
    known = muscle_and_valve(m, parameters.valve, off) | {
        "damping": m.force.damping * (1 + damping) if muscle == MUSCLES[0] else m.force.damping + damping,
        "force": 1 + off[f"{muscle}_force"],
        "supply": parameters.rig.supply_pressure * (1 + off["supply_pressure"]),
    }
    return Apparatus(**(dict.fromkeys(Apparatus._fields, 0.0) | known))


def nominal() -> Parameters:
    """Return what is known of the rig of all cases: the nominal model, without any effect."""
    return load({"valve.dead_band": 0.0})


def record(
    rng: np.random.Generator,
    parameters: Parameters,
    hidden: Hidden,
    deviations: Mapping[str, float] = NO_DEVIATION,
) -> Recording:
    """Return one diagnostic run in closed loop at drawn pressures and places; arguments as of `HiddenRig`."""
    plant = HiddenRig(parameters, hidden, deviations, DIAGNOSTIC_START, int(rng.integers(2**31)))
    pressures = np.array([3.2e5, 5.5e5]) + rng.uniform(-2e4, 4e4, 2)
    places = rng.permutation([0.15, 0.5, 0.8, 1.0])
    rig = Rig(parameters, SPECIMEN, position=DIAGNOSTIC_START, plant=plant)
    rows = [
        (s.time_ns * 1e-9, s.measured.position, s.measured.force, *s.measured[1:3], *s.voltages)
        for s in diagnostic_procedure(rig, pressures[rng.permutation(2)].tolist(), places.tolist())
    ]
    names = ("time", "rig_position", "rig_force", "rig_pressure", "rig_positioner_pressure",
             "rig_voltage", "rig_positioner_voltage")  # fmt: skip
    return dict(zip(names, np.array(rows).T, strict=True))
