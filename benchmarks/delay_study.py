# SPDX-License-Identifier: Apache-2.0
"""The loop with its delay: how the knee follows on the shipped hardware and on worse; resumable, one row a run.

    python benchmarks/delay_study.py run [--out FILE] [--seeds 10] [--only NAME...] [--jobs 2]
    python benchmarks/delay_study.py table [FILE]
    python benchmarks/delay_study.py figure FILE frontier.png

Closed loop without ROS, all controllers as configured. Each row says which gains it was made with, so that
a row that is there already is not made again, and a change of the gains makes new ones.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model.parameters import load, scenario_overrides

OUT = Path(__file__).parent / "results" / "delay_study.jsonl"
DURATION = 9.0  # s
WEARERS = {"nobody": "default", "person": "person"}
MUSCLES = ("extensor", "flexor")
LIMIT = 3.0  # deg
FRICTION = {"plant.effects.joint_friction.coulomb": 2.4, "plant.effects.viscous_friction.viscosity": 0.3}
HYSTERESIS = {"plant.effects.muscle_hysteresis.half_width": 36.0}
ENCODER = {"plant.sensor.angle_resolution": math.radians(0.1)}
SUPPLY = {"plant.deviation.supply_pressure": 6.0 / 7.0}
LAG = "plant.effects.valve_lag.natural_frequency"
NO_DELAY = {f"plant.delay.{name}": 0.0 for name in ("computing", "converter", "valve", "hose_length")}
NO_DELAY |= {f"plant.effects.{muscle}_pressure_delay.enabled": False for muscle in MUSCLES}


def loop_delay(parameters) -> float:
    """Return the dead time of the emulated hardware, from a sample of the pressure to the flow, s."""
    d, sensor = parameters.plant.delay, parameters.plant.effects.extensor_pressure_delay
    line = d.computing + d.converter + d.valve + d.hose_length * d.hose_per_metre
    return line + sensor.delay * sensor.enabled


def delayed(seconds: float) -> dict[str, Any]:
    """Return the overrides that give the hardware this dead time in all: in its sensors, the rest in the valves."""
    sensor = load().plant.effects.extensor_pressure_delay.delay
    return {
        **{f"plant.delay.{name}": 0.0 for name in ("computing", "converter", "hose_length")},
        "plant.delay.valve": seconds - sensor,
    }


def hardware() -> dict[str, dict[str, Any]]:
    """Return the perturbations of the shipped hardware."""
    believed = load().valve.delay
    return {
        "as shipped": {},
        "5 ms more than believed": delayed(believed + 5e-3),
        "5 ms less than believed": delayed(believed - 5e-3),
        "valve of 30 Hz": {LAG: 30.0},
        "friction x3": FRICTION,
        "hysteresis x3": HYSTERESIS,
        "supply of 6 bar": SUPPLY,
        "encoder of 0.1 deg": ENCODER,
        "control at 100 Hz": {"scenario.control_period": 0.01},
        "together": {**FRICTION, **HYSTERESIS, LAG: 50.0, **ENCODER, **SUPPLY},
    }


def follow(scenario: str, overrides: dict[str, Any], seed: int, duration: float = DURATION) -> dict[str, float]:
    """Return how the knee follows: errors in degrees, variation of each valve's voltage in V/s."""
    p = load({**scenario_overrides(scenario), **overrides})
    run = ClosedLoop(p, seed).run(round(duration / p.scenario.control_period))
    error = np.degrees(run["reference_angle"] - run["angle"])
    rest = (run["time"] > 0.5) & (run["time"] < 1.0)
    moved = {f"{m}_variation": float(np.abs(np.diff(run[f"{m}_voltage"])).sum()) / duration for m in MUSCLES}
    return {
        "maximum": float(np.abs(error).max()),
        "rms": float(np.sqrt(np.mean(error**2))),
        "steady": float(np.abs(error[rest]).mean()),
        **moved,
    }
