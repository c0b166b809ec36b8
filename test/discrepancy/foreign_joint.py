# SPDX-License-Identifier: Apache-2.0
"""A joint that is none of this package's: an arm between two braided muscles of another make, in the plane.

Muscles after Chou & Hannaford (1996), chambers as first-order lags of their references, voltages in
proportion to what is missing. Its sensors are better than the knee's.
"""

import csv
import math

import numpy as np

PERIOD, SUBSTEPS, SECONDS = 0.002, 10, 8.0
AMBIENT, MEAN, SWING = 101325.0, 3.0e5, 1.2e5  # Pa
INERTIA, DAMPING, RADIUS, CENTRE = 0.1, 1.5, 0.04, 0.75  # kg m^2, N m s/rad, m, rad
AREA, FIBRE_ANGLE, LENGTH, CONTRACTION = 2.0e-4, 0.45, 0.2, 0.15  # m^2, rad, m, -
LAG, VOLTS_PER_PASCAL = 0.044, 1.2e-5
ANGLE_NOISE, PRESSURE_NOISE = 2.0e-5, 60.0  # rad, Pa
COLUMNS = ("time", "angle", "extensor_pressure", "flexor_pressure", "extensor_voltage", "flexor_voltage")


def _force(pressure: float, contraction: float) -> float:
    shape = 3 * (1 - contraction) ** 2 / math.tan(FIBRE_ANGLE) ** 2 - 1 / math.sin(FIBRE_ANGLE) ** 2
    return AREA * pressure * shape


def rows(seed: int) -> np.ndarray:
    """Return samples of `COLUMNS`, SI, as sensors give them."""
    rng = np.random.default_rng(seed)
    frequencies = [rng.uniform(*ends) for ends in ((0.3, 0.5), (0.7, 1.1), (1.5, 2.2))]
    phases = rng.uniform(0, 2 * math.pi, 3)
    angle, velocity, extensor, flexor = CENTRE, 0.0, MEAN, MEAN
    result, step = np.empty((round(SECONDS / PERIOD), len(COLUMNS))), PERIOD / SUBSTEPS
    for number in range(len(result)):
        time = number * PERIOD
        parts = zip((1.0, 0.5, 0.25), frequencies, phases, strict=True)
        wave = sum(size * math.sin(2 * math.pi * f * time + phase) for size, f, phase in parts) / 1.75
        missing = MEAN - SWING * wave - extensor, MEAN + SWING * wave - flexor
        voltages = [5 + VOLTS_PER_PASCAL * one for one in missing]
        result[number] = time, angle, extensor + AMBIENT, flexor + AMBIENT, *voltages
        for _ in range(SUBSTEPS):
            turned = RADIUS * (angle - CENTRE) / LENGTH
            pull = _force(flexor, CONTRACTION + turned) - _force(extensor, CONTRACTION - turned)
            extensor += step * missing[0] / LAG
            flexor += step * missing[1] / LAG
            velocity += step * (RADIUS * pull - DAMPING * velocity) / INERTIA
            angle += step * velocity
    result[:, 1] += ANGLE_NOISE * rng.standard_normal(len(result))
    result[:, 2:4] += PRESSURE_NOISE * rng.standard_normal((len(result), 2))
    return result


def write(path, seed: int) -> str:
    """Write a recording as a table; return its path."""
    with open(path, "w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(COLUMNS)
        writer.writerows([f"{value:.9g}" for value in row] for row in rows(seed))
    return str(path)
