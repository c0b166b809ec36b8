# SPDX-License-Identifier: Apache-2.0
"""Blind cases of the test rig: a second realisation of the rig with hidden effects, and the answer.

Muscles, valves and gas are those of `hidden.physics`; the carriage's friction is LuGre's, the muscles'
hysteresis is Maxwell-slip, a leak is an orifice, creep has two time constants. It shares no code with
`model.rig`. The rig's own controllers run it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from pam_orthosis.control.linearisation import slack_pressure
from pam_orthosis.control.rig_loop import DIAGNOSTIC_START, Rig, diagnostic_procedure
from pam_orthosis.discrepancy.hidden import physics
from pam_orthosis.discrepancy.hidden.case import TOLERANCE_SHARE, Case, force_waves
from pam_orthosis.discrepancy.hidden.effects import SIZES, HiddenEffect
from pam_orthosis.discrepancy.hidden.physics import STEP, Apparatus, Hidden, Maps, _compiled
from pam_orthosis.discrepancy.hidden.plant import PRESSURE_NOISE, PRESSURE_RESOLUTION, VOLTAGE_RESOLUTION
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import load
from pam_orthosis.model.rig import RigMeasurement, RigTruth, at_rig

SPECIMEN = "dmsp_20"
POSITION_NOISE, POSITION_RESOLUTION = 5.0e-6, 1.0e-5  # m
FORCE_NOISE, FORCE_RESOLUTION = 2.0, 1.0  # N
BRISTLE_STIFFNESS = 2.0e4  # 1/m: 50 um of pre-sliding
STRIBECK, STRIBECK_VELOCITY = 0.2, 0.005  # rise at low speed, m/s
MAP_SD = (3.5, 20.0)  # N, of the waves of either muscle's map in the class `realistic`
X, V, PE, PF, BRISTLE, CE1, CE2, CF1, CF2 = range(9)
STATES = 9

EFFECTS = {
    effect.name: effect
    for effect in (
        HiddenEffect("carriage_friction", "coulomb", "coulomb", (3.0, 10.0, 30.0), "LuGre bristles"),
        HiddenEffect("muscle_hysteresis", "half_width", "hysteresis", (4.0, 12.0, 40.0), "Maxwell slip"),
        HiddenEffect("creep", "stiffness", "creep", (500.0, 2000.0, 6000.0), "two time constants"),
        HiddenEffect(
            "specimen_leak", "coefficient", "leak_e", (1.0e-11, 5.0e-11, 3.0e-10), "orifice"
        ),
        HiddenEffect("valve_dead_band", "half_width", "dead_band", (0.01, 0.05, 0.2), "edges 1.25, 0.75"),
    )
}  # fmt: skip


class Carriage(NamedTuple):
    """True values of the rig itself."""

    mass: float
    position_offset: float
    load_cell_scale: float
    load_cell_offset: float


@_compiled
def carriage_friction(bristle, v, h):
    """Return LuGre's force and the rate of its bristle (in units of the Coulomb force)."""
    if h.coulomb == 0.0:
        return 0.0, 0.0
    level = 1 + STRIBECK * np.exp(-((v / STRIBECK_VELOCITY) ** 2))
    rate = BRISTLE_STIFFNESS * (v - abs(v) * bristle / level)
    return h.coulomb * (bristle + 2.0e-4 * rate), rate


@_compiled
def rates(x, out, t, ue, uf, anchors, c, ae, af, h, me, mf):
    """Write the rates of all states; return the tension of the investigated muscle, N."""
    xe, xf, re = x[X], c.position_offset - x[X], x[V]
    ge, gf = x[PE] - ae.ambient, x[PF] - af.ambient
    oe = physics.spool_opening(ue, h.valve_gain_e, me.valve_waves[0], ae, h)
    of = physics.spool_opening(uf, h.valve_gain_f, me.valve_waves[1], af, h)
    fe = physics.valve_flow(oe, x[PE], ae.supply, ae, h)
    ff = physics.valve_flow(of, x[PF], af.supply, af, h)
    out[PE] = physics.pressure_rate(x[PE], fe, xe, re, ge, h.leak_e, 0.0, me.volume_waves[0], t, ae, h, me)
    out[PF] = physics.pressure_rate(x[PF], ff, xf, -re, gf, h.leak_f, 0.0, mf.volume_waves[1], t, af, h, mf)
    out[CE1], out[CE2] = re - x[CE1] / 0.6, re - x[CE2] / 1.8
    out[CF1], out[CF2] = -re - x[CF1] / 0.6, -re - x[CF2] / 1.8
    ce, cf = 0.6 * x[CE1] + 0.4 * x[CE2], 0.6 * x[CF1] + 0.4 * x[CF2]
    scale = ae.extensor_force * h.force_scale_e
    te = physics.muscle(xe, re, ge, ce, scale, anchors[0], me.force_waves[0], ae, h, me)
    tf = physics.muscle(xf, -re, gf, cf, af.flexor_force, anchors[1], mf.force_waves[1], af, h, mf)
    rubbing, out[BRISTLE] = carriage_friction(x[BRISTLE], x[V], h)
    out[X] = x[V]
    out[V] = (te - tf - rubbing) / c.mass
    return te


@_compiled
def advance(x, anchors, t, steps, ue, uf, c, ae, af, h, me, mf):
    """Advance all states by `steps` with the valve voltages (above closed, V) held."""
    k1, k2, middle = np.zeros(STATES), np.zeros(STATES), np.zeros(STATES)
    for n in range(steps):
        rates(x, k1, t + n * STEP, ue, uf, anchors, c, ae, af, h, me, mf)
        for i in range(STATES):
            middle[i] = x[i] + STEP * k1[i]
        rates(middle, k2, t + (n + 1) * STEP, ue, uf, anchors, c, ae, af, h, me, mf)
        for i in range(STATES):
            x[i] += 0.5 * STEP * (k1[i] + k2[i])
        for i in range(physics.ELEMENTS):
            d, xf = physics.slip_distance(i), c.position_offset - x[X]
            anchors[0, i] = physics.clip(anchors[0, i], x[X] - d, x[X] + d)
            anchors[1, i] = physics.clip(anchors[1, i], xf - d, xf + d)


class HiddenRig:
    """Emulated rig for blind tests, with the interface of `model.rig.RigPlant`.

    Args:
        parameters: the belief; what the rig is without deviations, misfits and hidden effects.
        hidden: sizes of the hidden effects.
        deviations: ordinary parameters' deviations, by the names of the rig's calibrations.
        misfits: arrays of `Maps` that differ from none.
        seed: of the sensor noise.
    """

    def __init__(self, parameters, hidden: Hidden, deviations: Mapping[str, float], misfits, seed: int = 0):
        parameters = at_rig(parameters)
        period = parameters.scenario.control_period
        self.period_ns, self._steps = round(period * 1e9), round(period / STEP)
        self._hidden, self._d = hidden, dict(deviations)
        self._physics = (
            carriage(parameters, self._d),
            apparatus(parameters, parameters.muscle.dmsp_20, self._d),
            apparatus(parameters, parameters.muscle.mas_40, self._d),
            hidden,
            maps(parameters.muscle.dmsp_20, misfits),
            maps(parameters.muscle.mas_40, misfits),
        )
        self._closed, self._half_span = parameters.valve.closed_voltage, self._physics[1].half_span
        self._noise, self._index, self._held = np.random.default_rng(seed), 0, (0.0, 0.0)
        self.x = np.zeros(STATES)
        at = DIAGNOSTIC_START
        taut = float(slack_pressure(at, parameters))
        self.x[:4] = at, 0.0, parameters.valve.ambient_pressure, taut
        self._anchors = np.outer([at, self._physics[0].position_offset - at], np.ones(physics.ELEMENTS))

    def measure(self) -> RigMeasurement:
        """Return noisy, quantised sensor readings; draws noise once a call."""
        noise, d, c = self._noise.standard_normal(4), self._d, self._physics[0]
        pressures = (
            self.x[PE] + d.get("specimen_pressure_offset", 0.0),
            self.x[PF] + d.get("positioner_pressure_offset", 0.0),
        )
        force = (1 + c.load_cell_scale) * self._tension() + c.load_cell_offset
        true = (self.x[X], *pressures, force)
        spread = (POSITION_NOISE, PRESSURE_NOISE, PRESSURE_NOISE, FORCE_NOISE)
        steps = (POSITION_RESOLUTION, PRESSURE_RESOLUTION, PRESSURE_RESOLUTION, FORCE_RESOLUTION)
        rows = zip(true, spread, steps, noise, strict=True)
        return RigMeasurement(*(float(np.round((v + s * n) / step) * step) for v, s, step, n in rows))

    def advance(self, specimen_voltage: float, positioner_voltage: float, hand: float | None = None) -> None:
        """Integrate one control period with the voltages held (there is no hand)."""
        volts = (specimen_voltage, positioner_voltage)
        limited = (min(max(v - self._closed, -self._half_span), self._half_span) for v in volts)
        shifts = (self._d.get(f"{m}_closed_voltage", 0.0) for m in ("specimen", "positioner"))
        self._held = tuple(
            round(v / VOLTAGE_RESOLUTION) * VOLTAGE_RESOLUTION + s
            for v, s in zip(limited, shifts, strict=True)
        )
        time = self._index * self._steps * STEP
        advance(self.x, self._anchors, time, self._steps, *self._held, *self._physics)
        self._index += 1

    def truth(self) -> RigTruth:
        """Return what the plant tells; what nobody records is not a number."""
        x, nan = self.x.tolist(), float("nan")
        return RigTruth(x[X], x[V], self._tension(), nan, x[PE], x[PF], nan, nan)

    def _tension(self) -> float:
        return rates(self.x, np.zeros(STATES), 0.0, *self._held, self._anchors, *self._physics)


def carriage(parameters, d: Mapping[str, float]) -> Carriage:
    """Return the true values of the rig itself."""
    return Carriage(
        mass=parameters.rig.carriage_mass * (1 + d.get("carriage_mass", 0.0)),
        position_offset=parameters.rig.position_offset + d.get("position_offset", 0.0),
        load_cell_scale=d.get("load_cell_scale", 0.0),
        load_cell_offset=d.get("load_cell_offset", 0.0),
    )


def apparatus(parameters, m, d: Mapping[str, float]) -> Apparatus:
    """Return the true values of one muscle with its valve; what belongs to a leg is zero."""
    valve = parameters.valve
    investigated = m is parameters.muscle.dmsp_20
    known = {
        "damping": m.force.damping * (1 + d.get("specimen_damping", 0.0))
        if investigated
        else m.force.damping + d.get("positioner_damping", 0.0),
        "extensor_force": 1 + d.get("specimen_force", 0.0),
        "flexor_force": 1 + d.get("positioner_force", 0.0),
        "stroke_scale": m.map_length / m.length,
        "box_contraction": m.box.maximum_contraction,
        "box_gauge": m.box.maximum_pressure_gauge,
        "ambient": valve.ambient_pressure,
        "supply": valve.supply_pressure * (1 + d.get("supply_pressure", 0.0)),
        "temperature": valve.temperature,
        "exponent": valve.polytropic_exponent * (1 + d.get("polytropic_exponent", 0.0)),
        "conductance": valve.conductance * (1 + d.get("conductance", 0.0)),
        "critical_ratio": valve.critical_ratio * (1 + d.get("critical_ratio", 0.0)),
        "half_span": valve.maximum_voltage - valve.closed_voltage,
        "hose_conductance": valve.hose.conductance,
        "hose_volume": valve.hose.volume * (1 + d.get("hose_volume", 0.0)),
    }
    return Apparatus(**{name: known.get(name, 0.0) for name in Apparatus._fields})


def maps(m, misfits) -> Maps:
    """Return the maps of one muscle, with misfits."""
    arrays = {
        **{name: np.array(getattr(m.force, name)) for name in ("a", "b")},
        **{name: np.array(getattr(m.volume, name)) for name in ("v", "w")},
        "leg": np.zeros((6, 2)),
        "force_waves": np.zeros((2, 1, 4)),
        "valve_waves": np.zeros((2, 3)),
        "volume_waves": np.zeros((2, 3)),
        "torque": np.zeros(2),
    }
    return Maps(**(arrays | dict(misfits)))


def belief():
    """Return what is known of the rig of all cases: the nominal model, without any effect."""
    return load({"valve.dead_band": 0.0})


def make_rig_case(seed: int, class_: str = "clean", size: str = "medium", effect: str | None = None) -> Case:
    """Draw a case of the rig and record it: two diagnostic runs to fit, one held out.

    Args:
        seed: everything that is drawn follows from it.
        class_: `clean`, or `realistic`: both force maps are off in shape.
        size: small, medium or large.
        effect: one of `EFFECTS`; None: nothing is hidden.

    Raises:
        OrthosisError: no such effect.
    """
    if effect is not None and effect not in EFFECTS:
        raise OrthosisError(f"no effect {effect!r} to hide at the rig; there are: {', '.join(EFFECTS)}")
    from pam_orthosis.discrepancy.rig import test_rig

    rng = np.random.default_rng([seed, 5])
    parameters = belief()
    calibrations = test_rig(parameters, SPECIMEN).calibrations
    deviations = {one.name: TOLERANCE_SHARE * one.sd * rng.standard_normal() for one in calibrations}
    # a damper that pushes is none
    deviations["positioner_damping"] = abs(deviations["positioner_damping"])
    misfits = {}
    if class_ == "realistic":
        misfits["force_waves"] = force_waves(rng, np.array(MAP_SD)[:, None] * rng.standard_normal((2, 4)))
    value = EFFECTS[effect].sizes[SIZES.index(size)] * rng.uniform(0.85, 1.2) if effect else 0.0
    hidden = Hidden(**{EFFECTS[effect].field: value}) if effect else Hidden()
    secret = (hidden, deviations, misfits)
    training = {f"run_{k}": record(rng, parameters, secret) for k in range(2)}
    held_out = {"run": record(rng, parameters, secret)}
    answer: dict[str, Any] = {
        "seed": seed,
        "class": class_,
        "size": size,
        "effects": {effect: {EFFECTS[effect].parameter: value}} if effect else {},
        "deviations": deviations,
    }
    return Case(training, held_out, parameters, answer)


def record(rng, parameters, secret) -> dict[str, np.ndarray]:
    """Return one diagnostic run in closed loop at drawn pressures and places."""
    hidden, deviations, misfits = secret
    plant = HiddenRig(parameters, hidden, deviations, misfits, int(rng.integers(2**31)))
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
