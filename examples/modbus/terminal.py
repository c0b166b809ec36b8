# SPDX-License-Identifier: Apache-2.0
"""A terminal with sensors and valves that speaks Modbus TCP, and the emulated leg behind it.

    python examples/modbus/terminal.py [--port 5020] [--watchdog 0.1] [--outage 2.0]

Its valves vent by themselves when no command comes for the time of the watchdog. SIGUSR1 cuts the network
for the time of the outage; the leg lives on.
"""

from __future__ import annotations

import argparse
import asyncio
import signal
import time

import registers
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from pam_orthosis.model.parameters import Parameters, load
from pam_orthosis.nodes.dummy_driver import EmulatedHardware


class Terminal:
    """Looks at its sensors when their registers are read; sets a valve when its register is written."""

    def __init__(self, parameters: Parameters, watchdog: float):
        self._hardware = EmulatedHardware(parameters)
        self._period, self._watchdog_ns = parameters.scenario.control_period, round(watchdog * 1e9)
        self._first_ns, self._written_ns = time.monotonic_ns(), 0
        words = SimData(0, count=registers.SENSORS + registers.VALVES, datatype=DataType.REGISTERS)
        self.device = SimDevice(id=1, simdata=[words], action=self._access)

    async def live(self) -> None:
        """Let time pass."""
        while True:
            at_ns = self._now_ns()
            if at_ns - self._written_ns > self._watchdog_ns:
                self._hardware.vent(at_ns)
            self._hardware.read(at_ns)
            await asyncio.sleep(self._period)

    async def _access(
        self, _code: int, _start: int, address: int, _count: int, known: list[int], values: list[int] | None
    ) -> None:
        known[: registers.SENSORS] = registers.of_sample(self._hardware.read(self._now_ns()))
        for register, value in enumerate(values or (), address):
            self._written_ns = self._now_ns()
            self._hardware.write(register - registers.SENSORS, registers.spool_of(value), self._written_ns)

    def _now_ns(self) -> int:
        return time.monotonic_ns() - self._first_ns


async def serve(terminal: Terminal, port: int, outage: float) -> None:
    """Serve a terminal on 127.0.0.1, again after each outage."""
    cut = asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGUSR1, cut.set)
    living = asyncio.create_task(terminal.live())
    while not living.done():
        server = ModbusTcpServer(terminal.device, address=("127.0.0.1", port))
        listening = asyncio.create_task(server.serve_forever())
        await cut.wait()
        await server.shutdown()
        listening.cancel()
        await asyncio.sleep(outage)
        cut.clear()


def main() -> None:
    """Serve until SIGINT or SIGTERM."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--port", type=int, default=5020)
    parser.add_argument("--watchdog", type=float, default=0.1, help="time without commands, s")
    parser.add_argument("--outage", type=float, default=2.0, help="of the network upon SIGUSR1, s")
    given = parser.parse_args()
    asyncio.run(serve(Terminal(load(), given.watchdog), given.port, given.outage))


if __name__ == "__main__":
    main()
