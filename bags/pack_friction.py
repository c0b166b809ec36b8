# SPDX-License-Identifier: Apache-2.0
"""Make `bags/friction.npz`: the recordings of a knee with hidden joint friction, as small whole numbers.

python bags/pack_friction.py
"""

import json
from pathlib import Path

import numpy as np

from pam_orthosis.bag.examples import MEASURED, STEP_KEY
from pam_orthosis.model.parameters import load
from pam_orthosis.testing.case import NOMINAL, make_case

FILE = Path(__file__).with_name("friction.npz")
VOLT = 1e-4  # resolution of the recorded voltages


def main() -> None:
    """Record the case and pack it."""
    case = make_case(1, effects=["joint_friction"])
    sensor = load().plant.sensor
    steps = {"angle": sensor.angle_resolution, "pressure": sensor.pressure_resolution, "voltage": VOLT}
    runs = {f"training_{name}": run for name, run in case.training.items()}
    runs |= {f"held_out_{name}": run for name, run in case.held_out.items()}
    packed = {
        f"{run}/{signal}": np.diff(np.round(values[signal] / steps[kind]).astype(np.int32), prepend=0)
        for run, values in runs.items()
        for signal, kind in MEASURED.items()
    }
    words = {"nominal": NOMINAL, "answer": case.answer, STEP_KEY: steps}
    np.savez_compressed(FILE, about=json.dumps(words), **packed)


if __name__ == "__main__":
    main()
