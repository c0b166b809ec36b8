# SPDX-License-Identifier: Apache-2.0
"""The closed loops of a device's machines, which move together, in one process."""

import numpy as np

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model.coupled import Plants


class _Answered:
    """One machine of several that move together: its voltages wait for those of the others."""

    def __init__(self, plant):
        self.period_ns, self.measure, self.truth = plant.period_ns, plant.measure, plant.truth
        self.voltages = ()

    def advance(self, *voltages):
        """Take the voltages."""
        self.voltages = voltages


class CoupledLoop:
    """The machines of a device, each with its own cascade: parameters by namespace, joints in order."""

    def __init__(self, parameters):
        self.plants = Plants(parameters)
        self._own = {name: _Answered(self.plants.of[name]) for name in parameters}
        self.loops = {name: ClosedLoop(one, plant=self._own[name]) for name, one in parameters.items()}

    def run(self, steps, first=0):
        """Advance from a step on; return for each machine what `ClosedLoop.run` does."""
        tables = {name: np.empty((steps, len(loop.signals))) for name, loop in self.loops.items()}
        for index in range(steps):
            for name, loop in self.loops.items():
                tables[name][index] = loop.step(first + index)
            self.plants.advance(*(volts for own in self._own.values() for volts in own.voltages))
        return {name: dict(zip(self.loops[name].signals, t.T, strict=True)) for name, t in tables.items()}
