# SPDX-License-Identifier: Apache-2.0
"""The gains of the laws that stand in for backstepping, searched alike; the best ones so far are printed.

python benchmarks/tune_peers.py pid|adrc [EVALUATIONS]

A set of gains is judged by its worst run among gaits with and without a person on the shipped hardware and on
two drawn samples that the comparison does not ask: largest error, deg, plus RMS, plus 0.02 for each V/s by
which a valve's voltage varies beyond 100 V/s. The search is random about the best, in the gains' logarithms.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping

import numpy as np
from control_campaign.hardware import drawn

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model.parameters import load, scenario_overrides

SAMPLES, SECONDS, VARIATION = (0, 11, 12), 5.5, 100.0
WEARERS = {"default": {}, "person": {"plant.deviation.supply_pressure": 1.0}}
GAINS = {
    "pid": ("control.pid.proportional", "control.pid.integral", "control.pid.derivative"),
    "adrc": ("control.adrc.bandwidth", "control.adrc.observer_bandwidth"),
}


def cost(law: str, gains: Mapping[str, float], enough: float = np.inf) -> float:
    """Return what the search makes small; it stops looking when the gains are worse than `enough`."""
    worst = 0.0
    for wearer, changes in reversed(WEARERS.items()):
        for sample in SAMPLES:
            worst = max(worst, _cost(law, gains, {**drawn(sample), **scenario_overrides(wearer), **changes}))
            if worst > enough:
                return worst
    return worst


def _cost(law: str, gains: Mapping[str, float], hardware: Mapping[str, object]) -> float:
    parameters = load({**hardware, **gains, "control.position.controller": law})
    run = ClosedLoop(parameters, 1).run(round(SECONDS / parameters.scenario.control_period))
    error = np.degrees(run["reference_angle"] - run["angle"])
    variation = max(np.abs(np.diff(run[f"{m}_voltage"])).sum() / SECONDS for m in ("extensor", "flexor"))
    return float(np.abs(error).max() + np.sqrt(np.mean(error**2)) + 0.02 * max(variation - VARIATION, 0.0))


def main(law: str, evaluations: int = 40) -> None:
    """Search, and print each better set of gains."""
    keys, rng = GAINS[law], np.random.default_rng(0)
    best = np.log([load().at(key) for key in keys])
    least = np.inf
    for number in range(evaluations):
        width = 0.0 if number == 0 else 0.4 if number < evaluations / 2 else 0.15
        tried = best + rng.normal(0, width, len(keys))
        gains = {key: float(f"{value:.3g}") for key, value in zip(keys, np.exp(tried), strict=True)}
        value = cost(law, gains, least)
        if value < least:
            best, least = tried, value
            print(f"{number}: {value:.3f} with {gains}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:3]))
