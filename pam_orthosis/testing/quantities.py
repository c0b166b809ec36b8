# SPDX-License-Identifier: Apache-2.0
"""What the hidden plant is made of: true parameters, sizes of what may be hidden, arrays.

numba's cache looks at the file of a function only: after fields were reordered here, or `physics` was changed
and the rig is used, delete `__pycache__`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pam_orthosis.model.parameters import Parameters, Section

if TYPE_CHECKING:
    from pam_orthosis.model.machine import ActuatorOf

# a chamber's laws are straight lines, known everywhere
CHAMBER = {"stroke_scale": 1.0, "box_start": -np.inf, "box_contraction": np.inf, "box_gauge": np.inf}


class Apparatus(NamedTuple):
    """True values of the parameters, of one actuator and of what it moves; zero what a machine has not."""

    radius: float
    symmetric_angle: float
    symmetric_contraction: float
    damping: float
    force: float  # true / nominal
    stroke_scale: float  # specimen's length / muscle's length
    box_start: float
    box_contraction: float
    box_gauge: float
    ambient: float
    supply: float
    temperature: float
    exponent: float
    conductance: float
    critical_ratio: float
    half_span: float  # V from closed to fully open
    hose_conductance: float
    hose_volume: float
    stop_low: float
    stop_high: float
    stop_stiffness: float
    stop_damping: float
    table_start: float
    table_step: float
    locked: float
    load_damping: float
    middle: float  # of the range: where a hidden spring is free
    unit: float  # of widths and speeds of the load's effects
    pushes: float  # 1: a chamber, which can push


class Hidden(NamedTuple):
    """Sizes of what may be hidden; the defaults hide nothing."""

    coulomb: float = 0.0
    viscosity: float = 0.0
    pressure_damping: float = 0.0
    direction_damping: float = 0.0
    hysteresis: float = 0.0
    creep: float = 0.0
    elasticity: float = 0.0
    foot_mass: float = 0.0
    play: float = 0.0
    reflex_gain: float = 0.0
    reflex_threshold: float = 1.0
    reflex_delay: float = 0.04
    constant_torque: float = 0.0
    periodic_torque: float = 0.0
    periodic_frequency: float = 1.0
    periodic_phase: float = 0.0
    force_scale_e: float = 1.0
    force_scale_f: float = 1.0
    dead_band: float = 0.0
    valve_gain_e: float = 1.0
    valve_gain_f: float = 1.0
    valve_lag: float = 0.0
    valve_delay: float = 0.0
    leak_e: float = 0.0
    leak_f: float = 0.0
    hose: float = 0.0
    dead_volume_e: float = 0.0
    dead_volume_f: float = 0.0
    exponent_shift: float = 0.0
    sag: float = 0.0
    warming: float = 0.0
    warming_time: float = 20.0
    angle_offset: float = 0.0
    angle_gain: float = 1.0
    angle_delay: float = 0.0
    pressure_offset_e: float = 0.0
    pressure_offset_f: float = 0.0
    pressure_gain_e: float = 1.0
    pressure_gain_f: float = 1.0
    pressure_delay_e: float = 0.0
    pressure_delay_f: float = 0.0
    # outside the catalogue
    cogging: float = 0.0
    cross_talk: float = 0.0
    gain_drift: float = 0.0
    spool_play: float = 0.0
    drag: float = 0.0
    detent: float = 0.0
    jet: float = 0.0
    cross_leak: float = 0.0


class Maps(NamedTuple):
    """Arrays: polynomials of an actuator, tables of the load, misfits, torque from outside."""

    a: np.ndarray
    b: np.ndarray
    v: np.ndarray
    w: np.ndarray
    load: np.ndarray  # (6, n): m, dm/dq, G of the apparatus; the same of 1 kg that an effect adds
    strokes: np.ndarray  # (4, n): contraction and its slope of both; (4, 0): a sprocket winds them
    force_waves: np.ndarray  # (2, k, 4): amplitude N, wave numbers of contraction and pressure, phase
    valve_waves: np.ndarray  # (2, 3): relative amplitude, wave number of the opening, phase
    volume_waves: np.ndarray  # (2, 3): relative amplitude, wave number of the contraction, phase
    torque: np.ndarray  # (n,) N m at whole milliseconds


def muscle_and_valve(m: Section, valve: Section, off: Mapping[str, float]) -> dict[str, float]:
    """Return what `Apparatus` has of an actuator and its valve: nominal values times one plus deviation.

    Args:
        m: section of the actuator's parameters.
        valve: section of the valve's.
        off: deviation of any name, 0 if there is none.
    """
    return {
        **(_box(m) if "box" in dict(m.items()) else CHAMBER),
        "ambient": valve.ambient_pressure,
        "temperature": valve.temperature,
        "exponent": valve.polytropic_exponent * (1 + off["polytropic_exponent"]),
        "conductance": valve.conductance * (1 + off["conductance"]),
        "critical_ratio": valve.critical_ratio * (1 + off["critical_ratio"]),
        "half_span": valve.maximum_voltage - valve.closed_voltage,
        "hose_conductance": valve.hose.conductance * (1 + off["hose_conductance"]),
        "hose_volume": valve.hose.volume * (1 + off["hose_volume"]),
    }


def _box(m: Section) -> dict[str, float]:
    """Return where a muscle's laws are known."""
    return {
        "stroke_scale": m.map_length / m.length,
        "box_start": 0.0,
        "box_contraction": m.box.maximum_contraction,
        "box_gauge": m.box.maximum_pressure_gauge,
    }


def damping_of(one: ActuatorOf, parameters: Parameters, off: Mapping[str, float]) -> float:
    """Return the true damping of an actuator, N s/m."""
    m = parameters.at(one.parameters)
    damping: float = one.parallel * (m if one.kind == "cylinder" else m.force).damping
    if one.kind == "cylinder":
        return damping
    small = one.parameters == "muscle.dmsp_10"
    return damping * (1 + off["small_muscle_damping" if small else "muscle_damping"])


def laws(one: ActuatorOf, parameters: Parameters) -> dict[str, np.ndarray]:
    """Return the polynomials of an actuator: area a and counterforce b, volume v(contraction) w(pressure)."""
    m, count = parameters.at(one.parameters), one.parallel
    if one.kind == "cylinder":
        area = count * m.area
        known = {"a": [area], "b": [0.0], "v": [count * m.volume, area], "w": [1.0]}
        return {name: np.array(values) for name, values in known.items()}
    return muscle_laws(m, count)


def muscle_laws(m: Section, count: int = 1) -> dict[str, np.ndarray]:
    """Return the polynomials of so many muscles side by side."""
    return {
        **{name: count * np.array(getattr(m.force, name)) for name in ("a", "b")},
        "v": count * np.array(m.volume.v),
        "w": np.array(m.volume.w),
    }


def maps(known: Mapping[str, np.ndarray], **others: np.ndarray) -> Maps:
    """Return the polynomials of an actuator and other arrays of `Maps`; what is not given is zero."""
    arrays = {
        **known,
        "load": np.zeros((6, 2)),
        "strokes": np.zeros((4, 0)),
        "force_waves": np.zeros((2, 1, 4)),
        "valve_waves": np.zeros((2, 3)),
        "volume_waves": np.zeros((2, 3)),
        "torque": np.zeros(2),
    }
    return Maps(**(arrays | others))
