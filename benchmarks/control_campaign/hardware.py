# SPDX-License-Identifier: Apache-2.0
"""Hardware as one may get it: what the plant really is, drawn from published and assumed ranges."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pam_orthosis.model.parameters import load

VOLUME_PER_MUSCLE = 2.2e-4  # m^3, about half contracted
GAS = 287.05  # J/(kg K)


def drawn(seed: int) -> dict[str, Any]:
    """Return the overrides of `plant.*` of one specimen; 0 is the hardware of the shipped configuration."""
    if seed == 0:
        return {}
    rng = np.random.default_rng(1000 + seed)
    u = rng.uniform
    assumed, plant = load(), "plant"
    hose_length, bore = u(0.5, 2.0), u(4.0, 6.0)  # m, mm
    volume = math.pi / 4 * (bore * 1e-3) ** 2 * hose_length
    conductance = 0.029e-6 * bore**2 / math.sqrt(1e3 * hose_length / bore**1.25 + 510)  # ISO 6358 formula
    damping, faster, slower = u(50.0, 400.0), u(0.5, 1.5), u(0.5, 1.5)
    effects = {
        "joint_friction": {"coulomb": u(0.3, 1.5)},
        "viscous_friction": {"viscosity": u(0.05, 0.2)},
        "backlash": {"half_width": math.radians(u(0.0, 0.5))},
        "muscle_hysteresis": {"half_width": 1.5 * u(8.0, 18.0), "offset_share": 1 / 3},
        "creep": {"stiffness": u(300.0, 1500.0), "time_constant": math.exp(u(math.log(0.5), math.log(8.0)))},
        "direction_dependent_damping": {"asymmetry": damping * (faster - slower) / 2},
        "valve_lag": {"natural_frequency": u(70.0, 120.0)},
        "valve_dead_band": {"half_width": u(0.05, 0.3)},
        "valve_delay": {"delay": u(1e-3, 3e-3)},
        "supply_sag": {"resistance": u(0.5e7, 2.5e7)},
        **{f"{m}_leak": {"coefficient": _leak(u(300.0, 5000.0))} for m in ("extensor", "flexor")},
    }
    delay = {"valve": effects.pop("valve_delay")["delay"], "hose_length": hose_length}
    deviation = {
        "moving_mass": u(0.96, 1.04), "person_mass": u(0.97, 1.03),
        "muscle_damping": damping * (faster + slower) / 2 / assumed.muscle.dmsp_20.force.damping,
        "extensor_force": u(0.92, 1.08), "flexor_force": u(0.92, 1.08),
        "conductance": u(2.2, 2.9) / 2.75, "critical_ratio": u(0.2, 0.45) / 0.3,
        "polytropic_exponent": u(1.05, 1.39) / 1.2, "supply_pressure": u(5.5, 7.0) / 7.0,
        "hose_volume": volume / assumed.valve.hose.volume,
        "hose_conductance": conductance / assumed.valve.hose.conductance,
    }  # fmt: skip
    sensor = {"angle_noise": math.radians(u(0.01, 0.05)), "pressure_noise": u(300.0, 1000.0)}
    mounting = {muscle: u(-1e-3, 1e-3) for muscle in ("extensor", "flexor")}
    groups = {"delay": delay, "deviation": deviation, "sensor": sensor, "mounting": mounting}
    return {
        **{f"{plant}.{group}.{key}": value for group, rows in groups.items() for key, value in rows.items()},
        **{f"{plant}.effects.{name}.{key}": v for name, rows in effects.items() for key, v in rows.items()},
        **{f"{plant}.effects.{name}.enabled": True for name in effects},
    }


def _leak(time_constant: float) -> float:
    """Return the coefficient, kg/(s Pa), with which a closed muscle loses its air in a time, s."""
    return VOLUME_PER_MUSCLE / (1.2 * GAS * 293.15 * time_constant)
