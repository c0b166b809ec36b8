# SPDX-License-Identifier: Apache-2.0
"""A driver for the terminal of `terminal.py`, by Modbus TCP.

    python examples/modbus/driver.py [--ros-args -p host:=127.0.0.1 -p port:=5020]

It needs the extras `ros` and `modbus` of the package.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Sequence
from typing import Any

import registers
from pymodbus import ModbusException
from pymodbus.client import ModbusTcpClient

from pam_orthosis.nodes import driver
from pam_orthosis.nodes.parameters import Setting

SETTINGS = {
    "host": Setting("127.0.0.1", "address of the terminal"),
    "port": Setting(5020, "TCP port of the terminal"),
}


logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)  # the driver reports what is lost, once


class ModbusDriver(driver.Driver):
    """Reads sensors and writes valves of a terminal, one request each."""

    def __init__(self) -> None:
        super().__init__("modbus_driver", SETTINGS)
        host, port = self.settings["host"], self.settings["port"]
        self._client = ModbusTcpClient(host, port=port, timeout=self.settings["deadline"] / 2, retries=0)

    def connect(self) -> None:
        """Reach the terminal."""
        if not self._client.connect():
            raise ConnectionError("the terminal does not answer")

    def disconnect(self) -> None:
        """Close the connection."""
        self._client.close()

    def read(self) -> Sequence[float]:
        """Return angle and pressures."""
        return registers.sample_of(
            self._asked(self._client.read_holding_registers, 0, count=registers.SENSORS)
        )

    def write(self, line: int, spool: float) -> None:
        """Set a valve."""
        self._asked(self._client.write_register, registers.SENSORS + line, registers.of_spool(spool))

    def vent(self) -> None:
        """Let the air out of both muscles."""
        vents = [registers.of_spool(driver.VENT)] * registers.VALVES
        self._asked(self._client.write_registers, registers.SENSORS, vents)

    def _asked(self, request: Callable[..., Any], *arguments: Any, **options: Any) -> list[int]:
        try:
            answer = request(*arguments, **options)
        except ModbusException as error:
            raise ConnectionError(str(error)) from error
        if answer.isError():
            raise ConnectionError(str(answer))
        return list(answer.registers)


if __name__ == "__main__":
    sys.exit(driver.run(ModbusDriver))
