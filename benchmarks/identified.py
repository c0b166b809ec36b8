# SPDX-License-Identifier: Apache-2.0
"""Knee tracking with the coefficients of config/ and with identified ones, at the same gains.

`python benchmarks/identified.py FILE`, FILE written by `pam-orthosis identify ... --out FILE`.
The plant stays the same: its true damping is kept while the nominal one changes.
"""

import sys
from pathlib import Path

import numpy as np
from gains import ripple

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model import parameters

SECONDS, SEEDS = 9.0, (1, 2, 3)
DAMPING, DEVIATION = "muscle.dmsp_20.force.damping", "plant.deviation.muscle_damping"


def identified(file):
    """Return the overrides of an identification of the knee's muscles."""
    rows = dict(_rows(parameters.read_yaml(Path(file)), "muscle."))
    known = parameters.load().flat()
    true = known[DAMPING] * known[DEVIATION]
    return rows | {DEVIATION: true / rows.get(DAMPING, known[DAMPING])}


def _rows(tree, prefix):
    for name, node in tree.items():
        if "value" in node:
            yield prefix + name, node["value"]
        else:
            yield from _rows(node, f"{prefix}{name}.")


def measure(scenario, overrides):
    """Return means over the seeds: maximum deg, RMS deg, ripple bar, voltage variation V/s."""
    p = parameters.load({**parameters.scenario_overrides(scenario), **overrides})
    period, rows = p.scenario.control_period, []
    for seed in SEEDS:
        run = ClosedLoop(p, seed).run(round(SECONDS / period))
        error = np.degrees(run["reference_angle"] - run["angle"])
        variation = np.abs(np.diff(run["extensor_voltage"])).sum() / SECONDS
        rows.append((np.abs(error).max(), np.sqrt(np.mean(error**2)), ripple(run, period), variation))
    return np.mean(rows, axis=0)


def main():
    """Print the table."""
    found = identified(sys.argv[1])
    print("| scenario | coefficients | max | RMS | ripple | voltage variation |\n|---|---|---|---|---|---|")
    for scenario in ("default", "person", "disturbance", "sine"):
        for name, overrides in (("config/", {}), ("identified", found)):
            largest, rms, swing, variation = measure(scenario, overrides)
            columns = (f"{largest:.2f} deg", f"{rms:.3f} deg", f"{swing:.2f} bar", f"{variation:.0f} V/s")
            print(f"| {scenario} | {name} | {' | '.join(columns)} |", flush=True)


if __name__ == "__main__":
    main()
