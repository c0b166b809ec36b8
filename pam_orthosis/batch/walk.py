# SPDX-License-Identifier: Apache-2.0
"""Walk once without ROS, with the same cores as the nodes; write a bag and print its verdict as JSON.

python -m pam_orthosis.batch.walk '{"scenario.seed": 2, "leg.person.mass": 80.0}' BOUND_DEG --out DIR
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pam_orthosis.bag.arrays import write_arrays
from pam_orthosis.bag.record import run_metadata
from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.bag.verdict import judge
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Parameters, load

# what the closed loop calls otherwise than the bag does
ESTIMATES = {"estimated_angle": "estimate_angle", "estimated_velocity": "estimate_velocity"}
RECORDED = (
    "angle", "reference_angle", "reference_velocity", "reference_acceleration",
    "extensor_pressure", "flexor_pressure", "extensor_pressure_reference", "flexor_pressure_reference",
    "extensor_mass_flow", "flexor_mass_flow", "extensor_voltage", "flexor_voltage", *ESTIMATES,
)  # fmt: skip


def walk(parameters: Parameters, bag: Path) -> None:
    """Walk for `scenario.duration` and record the bag that the nodes' recorder would, but for the truth."""
    period_ns = round(parameters.scenario.control_period * SECOND_NS)
    steps = round(parameters.scenario.duration * SECOND_NS / period_ns)
    walked = ClosedLoop(parameters, parameters.scenario.seed).run(steps)
    signals = {ESTIMATES.get(name, name): walked[name] for name in RECORDED}
    every = parameters.control.position.every
    write_arrays(bag, np.arange(steps) * period_ns, signals, run_metadata(parameters, "study"), every)


def main(arguments: Sequence[str]) -> int:
    """Walk, judge, print; return 0 if the bound holds, 1 if not, 2 if these parameters cannot walk."""
    overrides, bound_deg, _, folder = arguments
    bag = Path(folder, "bag")
    try:
        walk(load(json.loads(overrides)), bag)
        verdict = judge(bag, float(bound_deg))
    except OrthosisError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    print(json.dumps(verdict.as_dict()))
    return 0 if verdict.passed else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
