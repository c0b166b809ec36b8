# SPDX-License-Identifier: Apache-2.0
"""Classical baseline: cascaded PID, angle over pressures over voltages, on the same plant and limits.

python -m control_campaign.pid SCENARIO [EVALUATIONS]     (in benchmarks/) tunes it and prints the gains
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import asdict, astuple, dataclass

import numpy as np

from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.model.plant import Plant

VARIATION = 100.0  # V/s, what the tuning takes for the most that a valve should suffer
TUNED_ON = 7.0  # s of a run
SIGNALS = ("time", "reference_angle", "angle", "extensor_pressure", "flexor_pressure",
           "extensor_voltage", "flexor_voltage", "true_angle")  # fmt: skip


@dataclass(frozen=True)
class Gains:
    """Outer loop: Pa/rad, 1/s of it, Pa s/rad, filter of the derivative s; inner loop: V/Pa, V/(Pa s)."""

    proportional: float
    integral: float
    derivative: float
    filter: float
    pressure: float
    pressure_integral: float


START = Gains(4e5, 3e6, 2e4, 0.008, 5e-5, 2e-4)
# found by the search below on the shipped hardware and two drawn specimens that the benchmark does not ask
TUNED = {
    "default": Gains(5.426e5, 1.904e7, 2.814e4, 2.99e-3, 6.151e-5, 2.569e-4),
    "person": Gains(2.814e6, 6.171e6, 2.144e4, 4.38e-3, 9.04e-5, 3.782e-3),
}


class Integral:
    """An integral that stands still while its output is cut and would be cut further."""

    def __init__(self, value: float = 0.0):
        self.value = value

    def add(self, amount: float, cut: float) -> None:
        """Add, unless that goes on in the direction of what was cut off (wanted - possible)."""
        if amount * cut <= 0:
            self.value += amount


class CascadedPid:
    """PID of the angle gives the difference of the pressures, a PI of each pressure gives its voltage.

    It takes the dead band out as the inverse valve model does, and keeps to the same limits.
    """

    def __init__(self, parameters, gains: Gains):
        self._p, self._g = parameters, gains
        self._period = parameters.scenario.control_period
        self._outer: Integral | None = None
        self._inner = {name: Integral() for name in ("extensor", "flexor")}
        self._last, self._speed = 0.0, 0.0

    def step(self, measured, reference) -> tuple[float, float]:
        """Return both voltages for a sample of the sensors and of the trajectory."""
        if self._outer is None:
            self._outer = Integral(0.5 * (measured.flexor_pressure - measured.extensor_pressure))
            self._last = measured.angle
        g, error = self._g, reference.position - measured.angle
        keep = math.exp(-self._period / g.filter)
        self._speed = keep * self._speed + (1 - keep) * (measured.angle - self._last) / self._period
        self._last = measured.angle
        wanted = (
            g.proportional * error + self._outer.value + g.derivative * (reference.velocity - self._speed)
        )
        limits = self._p.control.position
        mean = limits.mean_pressure
        reach = min(mean - limits.minimum_pressure, limits.maximum_pressure - mean)
        half = min(max(wanted, -reach), reach)
        self._outer.add(g.integral * error * self._period, wanted - half)
        return (
            self._voltage("extensor", mean - half - measured.extensor_pressure),
            self._voltage("flexor", mean + half - measured.flexor_pressure),
        )

    def _voltage(self, muscle: str, error: float) -> float:
        valve, inner = self._p.valve, self._inner[muscle]
        push = self._g.pressure * error + inner.value
        span = valve.maximum_voltage - valve.closed_voltage
        smoothing = self._p.control.inverse_valve.dead_band_smoothing
        wanted = valve.closed_voltage + push + valve.dead_band * math.tanh(push / span / smoothing)
        voltage = min(max(wanted, valve.minimum_voltage), valve.maximum_voltage)
        inner.add(self._g.pressure_integral * error * self._period, wanted - voltage)
        return voltage


def run(parameters, plant: Plant, gains: Gains, steps: int) -> dict[str, np.ndarray]:
    """Let the baseline follow; returns an array of samples for each of `SIGNALS`, SI units."""
    controller, trajectory = CascadedPid(parameters, gains), make_trajectory(parameters)
    table = np.empty((steps, len(SIGNALS)))
    for index in range(steps):
        measured, reference = plant.measure(), trajectory.sample(index * plant.period_ns)
        voltages = controller.step(measured, reference)
        table[index] = (index * plant.period_ns * 1e-9, reference.position, *measured, *voltages,
                        plant.truth().angle)  # fmt: skip
        plant.advance(*voltages)
    return dict(zip(SIGNALS, table.T, strict=True))


def cost(parameters, gains: Gains, seed: int = 1) -> float:
    """Return what tuning makes small: largest error, deg, plus RMS, plus nervousness beyond `VARIATION`."""
    found = run(
        parameters, Plant(parameters, seed), gains, round(TUNED_ON / parameters.scenario.control_period)
    )
    error = np.degrees(found["reference_angle"] - found["angle"])
    variation = max(np.abs(np.diff(found[f"{m}_voltage"])).sum() / TUNED_ON for m in ("extensor", "flexor"))
    return float(np.abs(error).max() + np.sqrt(np.mean(error**2)) + 0.02 * max(variation - VARIATION, 0.0))


def tuned(hardware: Sequence, start: Gains, evaluations: int, tell=print) -> Gains:
    """Return the gains with the least cost on the worst of some specimens (parameters of each).

    The search is one in the gains' logarithms: random about the start, then Nelder and Mead's.
    """
    from scipy.optimize import minimize

    def of(x) -> float:
        value = max(cost(parameters, Gains(*np.exp(x))) for parameters in hardware)
        best.append((value, tuple(x)))
        return value

    best: list[tuple[float, tuple]] = []
    rng, first = np.random.default_rng(0), np.log(astuple(start))
    of(first)
    for number in range(evaluations // 3):
        centre = np.array(min(best)[1])
        of(centre + rng.normal(0, 0.8 if number < evaluations // 6 else 0.3, len(first)))
    tell(f"after {len(best)} random gains: {min(best)[0]:.3f}")
    simplex = np.array(min(best)[1]) + np.vstack([np.zeros(6), 0.25 * np.eye(6)])
    options = {"initial_simplex": simplex, "maxfev": evaluations - len(best), "xatol": 0.02, "fatol": 0.002}
    minimize(of, simplex[0], method="Nelder-Mead", options=options)
    tell(f"after {len(best)}: {min(best)[0]:.3f}")
    return Gains(*(float(f"{v:.4g}") for v in np.exp(min(best)[1])))


if __name__ == "__main__":
    from control_campaign.hardware import drawn
    from pam_orthosis.model.parameters import load, scenario_overrides

    name, evaluations, *numbers = [*sys.argv[1:], *("150", "0")[len(sys.argv) - 2 :]]
    specimens = [load(drawn(int(number)) | scenario_overrides(name)) for number in numbers]
    print(name, asdict(tuned(specimens, START, int(evaluations))))
