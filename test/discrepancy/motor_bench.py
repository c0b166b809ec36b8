# SPDX-License-Identifier: Apache-2.0
"""Recordings of a motor-driven carriage with dry friction, by code of their own.

The carriage sticks and slips after Karnopp (1985): below a small speed it rests until the force exceeds the
friction. A controller lets it follow a sum of sines; the encoder is read in mm.
"""

import csv
import math

import numpy as np

PERIOD, SUBSTEPS, SECONDS = 0.002, 20, 12.0
MASS, MOTOR, DAMPING = 2.05, 12.2, 5.5  # kg, N/A, N s/m: inside the tolerances of the nominal model
STIFFNESS, BRAKE = 60.0, 6.0  # A/m, A s/m, of the controller
REST = 1e-4  # m/s
ENCODER, CURRENT = 2e-6, 1e-3  # m, A: noise (sd)
COLUMNS = ("time", "encoder_mm", "current")


def rows(seed: int, friction: float, mass: float = MASS, late: float = 0.0) -> np.ndarray:
    """Return samples of `COLUMNS`; `friction` in N; `late`, s: the current acts so much after its stamp."""
    rng = np.random.default_rng(seed)
    frequencies = [rng.uniform(*ends) for ends in ((0.2, 0.4), (0.6, 1.0), (1.3, 1.9))]
    phases = rng.uniform(0, 2 * math.pi, 3)
    position, velocity, seen, step = 0.0, 0.0, 0.0, PERIOD / SUBSTEPS
    result, waiting = np.empty((round(SECONDS / PERIOD), len(COLUMNS))), [0.0] * round(late / PERIOD)
    for number in range(len(result)):
        time = number * PERIOD
        waves = zip((0.1, 0.04, 0.02), frequencies, phases, strict=True)
        wanted = sum(size * math.sin(2 * math.pi * f * time + phase) for size, f, phase in waves)
        before, seen = seen, position + ENCODER * rng.standard_normal()
        current = STIFFNESS * (wanted - seen) - BRAKE * (seen - before) / PERIOD if number else 0.0
        current = round(min(max(current, -8.0), 8.0) / CURRENT) * CURRENT
        result[number] = time, 1e3 * seen, current
        waiting.append(current)
        acting = waiting.pop(0)
        for _ in range(SUBSTEPS):
            force = MOTOR * acting - DAMPING * velocity
            if abs(velocity) < REST and abs(force) <= friction:
                velocity = 0.0
                continue
            resisted = force - math.copysign(friction, velocity if abs(velocity) >= REST else force)
            velocity += step * resisted / mass
            position += step * velocity
    return result


def write(path, seed: int, friction: float, **changed: float) -> str:
    """Write a recording as a table; return its path. `changed`: as `rows`."""
    with open(path, "w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(COLUMNS)
        writer.writerows([f"{value:.9g}" for value in row] for row in rows(seed, friction, **changed))
    return str(path)
