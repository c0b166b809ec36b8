# SPDX-License-Identifier: Apache-2.0
"""Node: an example of a hardware driver, with the emulated hardware in place of devices.

It is no node of the graph, as a driver outside this package is none. Its parameters are those of `config/`:
the run must have the same `scenario.control_period`.
"""

import sys
from collections.abc import Sequence

from pam_orthosis.control.guard import driven
from pam_orthosis.model.components.spool import VENT, voltage_of
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.plant import Plant
from pam_orthosis.nodes import driver
from pam_orthosis.nodes.layout import EVERYTHING


class EmulatedHardware:
    """Stands for the devices: sensors that can be read, valves that take commands, time that passes."""

    def __init__(self, parameters: Parameters):
        self._half_ns = round(parameters.scenario.control_period * 1e9) // 2
        self._valve, self.plant = parameters.valve, Plant(parameters)

    def read(self, at_ns: int) -> Sequence[float]:
        """Return the coordinate, rad or m, and the absolute pressure of each actuator, Pa, at an instant."""
        while self.plant.time_ns + self._half_ns <= at_ns:
            self.plant.live_on()
        sample: Sequence[float] = self.plant.measure()
        return sample

    def write(self, line: int, spool: float, at_ns: int) -> None:
        """Set the spool of an actuator's valve (its number), -1 to 1, at an instant since the start."""
        self.plant.take(line, driven(voltage_of(spool, self._valve), self._valve), at_ns)

    def vent(self, at_ns: int) -> None:
        """Let the air out of all actuators."""
        for line in range(len(self.plant.machine.names)):
            self.write(line, VENT, at_ns)


class DummyDriver(driver.Driver):
    """Calls the emulated hardware where another driver calls its devices."""

    def __init__(self) -> None:
        super().__init__("dummy_driver", branches=EVERYTHING)
        self.hardware = EmulatedHardware(self.parameters)

    def connect(self) -> None:
        """Be connected: it is there always."""

    def read(self) -> Sequence[float]:
        """Return a sample."""
        return self.hardware.read(self.elapsed_ns)

    def write(self, line: int, spool: float) -> None:
        """Set a valve."""
        self.hardware.write(line, spool, self.elapsed_ns)

    def vent(self) -> None:
        """Let the air out of all actuators."""
        self.hardware.vent(self.elapsed_ns)


def main() -> int:
    """Run the driver until SIGINT or SIGTERM."""
    return driver.run(DummyDriver)


if __name__ == "__main__":
    sys.exit(main())
