# SPDX-License-Identifier: Apache-2.0
"""Print tracking and chatter over gains, filter and control period, seed 1.

Run `python benchmarks/gains.py`; it prints Markdown.
"""

import numpy as np
from scipy.signal import butter, filtfilt

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model import parameters

SECONDS = 9.0
# control period, observer pole, c1 = c2, pressure gain, reference filter
ROWS = {
    "default": [
        (0.002, 60, 25, 60, 60),
        (0.002, 80, 35, 80, 60),
        (0.002, 100, 45, 80, 60),
        (0.002, 100, 45, 80, 150),
        (0.002, 140, 45, 80, 60),
        (0.002, 140, 60, 120, 150),
        (0.004, 100, 45, 80, 60),
        (0.005, 80, 35, 80, 60),
        (0.005, 100, 45, 80, 60),
        (0.005, 110, 42, 50, 100),
    ],
    "person": [(0.005, 60, 32, 50, 100), (0.005, 70, 30, 50, 100), (0.005, 110, 42, 50, 100)],
}
KEYS = (
    "scenario.control_period",
    "control.observer.pole",
    "control.position.c1",
    "control.position.c2",
    "control.pressure.gain",
    "control.pressure.reference_filter",
)


def measure(scenario, period, pole, gain, pressure_gain, bandwidth):
    """Return maximum error deg, RMS deg, pressure ripple bar, voltage variation V/s of both valves."""
    values = map(float, (period, pole, gain, gain, pressure_gain, bandwidth))
    overrides = {**parameters.scenario_overrides(scenario), **dict(zip(KEYS, values, strict=True))}
    run = ClosedLoop(parameters.load(overrides), seed=1).run(round(SECONDS / period))
    error = np.degrees(run["reference_angle"] - run["angle"])
    variation = [np.abs(np.diff(run[f"{m}_voltage"])).sum() / SECONDS for m in ("extensor", "flexor")]
    return np.abs(error).max(), np.sqrt(np.mean(error**2)), ripple(run, period), *variation


def ripple(run, period):
    """Return the largest measured pressure swing above 8 Hz, bar."""
    high = butter(2, 8 * 2 * period, "high")
    return max(np.abs(filtfilt(*high, run[f"{m}_pressure"])).max() for m in ("extensor", "flexor")) / 1e5


def main():
    """Print the table."""
    print("| scenario | period | pole | c1 = c2 | pressure gain | reference filter |", end="")
    print(" max | RMS | ripple | voltage variation |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for scenario, rows in ROWS.items():
        for period, *gains in rows:
            largest, rms, swing, extensor, flexor = measure(scenario, period, *gains)
            columns = [
                f"{period * 1e3:g} ms",
                *map(str, gains),
                f"{largest:.2f} deg",
                f"{rms:.2f} deg",
                f"{swing:.2f} bar",
            ]
            print(f"| {scenario} | {' | '.join(columns)} | {extensor:.0f}, {flexor:.0f} V/s |", flush=True)


if __name__ == "__main__":
    main()
