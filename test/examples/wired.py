# SPDX-License-Identifier: Apache-2.0
"""The device of the cylinder's example in place of the emulated hardware: in a closed loop, and in a graph.

python wired.py composed ...    is `pam_orthosis.nodes.entry` with the device as the plant
"""

import importlib.util
import sys
from pathlib import Path

import numpy as np

from pam_orthosis.model.plant import Plant

DEVICE = Path(__file__).resolve().parents[2] / "examples" / "cylinder" / "hidden.py"


class Wired(Plant):
    """The device with the methods of the emulated hardware, which only says how its truth is called."""

    def __init__(self, parameters, seed=0):
        super().__init__(parameters, seed)
        spec = importlib.util.spec_from_file_location("hidden", DEVICE)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        assert round(module.PERIOD * 1e9) == self.period_ns
        self.device, self._shown = module.Cylinder(seed), super().truth()

    def measure(self):
        return self._measurement(*self.device.read())

    def truth(self):
        return self._shown._replace(position=self.device.x, velocity=self.device.v)

    def advance(self, *voltages):
        self.device.volts = np.array(voltages)
        self.device.live()


if __name__ == "__main__":
    from pam_orthosis.model import coupled
    from pam_orthosis.nodes import entry

    coupled.Plant = Wired
    sys.exit(entry.start(sys.argv.pop(1)))
