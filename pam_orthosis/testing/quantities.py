# SPDX-License-Identifier: Apache-2.0
"""What the hidden plant is made of: true parameters, sizes of what may be hidden, arrays; what it reads."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Apparatus(NamedTuple):
    """True values of the parameters."""

    radius: float
    symmetric_angle: float
    symmetric_contraction: float
    damping: float
    extensor_force: float
    flexor_force: float
    stroke_scale: float  # specimen's length / muscle's length
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


class Maps(NamedTuple):
    """Arrays: polynomials of the muscles, table of the leg, misfits, torque from outside."""

    a: np.ndarray
    b: np.ndarray
    v: np.ndarray
    w: np.ndarray
    leg: np.ndarray  # (6, n): m, dm/dq, G of the apparatus; the same of 1 kg at the ankle
    force_waves: np.ndarray  # (2, k, 4): amplitude N, wave numbers of contraction and pressure, phase
    valve_waves: np.ndarray  # (2, 3): relative amplitude, wave number of the opening, phase
    volume_waves: np.ndarray  # (2, 3): relative amplitude, wave number of the contraction, phase
    torque: np.ndarray  # (n,) N m at whole milliseconds
