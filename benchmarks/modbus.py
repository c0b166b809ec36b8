# SPDX-License-Identifier: Apache-2.0
"""The Modbus example in real time: it walks, loses its terminal for 2 s, vents, and walks on upon a command.

    python benchmarks/modbus.py --out benchmarks/results/modbus.json [--repeats 5]

A run takes half a minute. Nothing else should run meanwhile: latency is that of the machine.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from std_srvs.srv import Trigger

from pam_orthosis.bag.read import aligned, read_bag
from pam_orthosis.bag.tracking import timing
from pam_orthosis.bag.verdict import judge
from pam_orthosis.model.parameters import config_folder
from pam_orthosis.nodes.launch import free_domain

ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = ROOT / "examples" / "modbus"
DURATION_S, STARTED_S, WALK_S, LOOK_S, SETTLED_S = 22.0, 4.0, 7.0, 0.5, 3.0
LIMIT_S = 120.0
RUN = ["-m", "pam_orthosis.cli.main", "run", "--realtime", "--no-plant", "--composed"]


class Operator:
    """Somebody who looks at the driver's reports and resets it."""

    def __init__(self, node: Node):
        self._node, self.state = node, ""
        node.create_subscription(DiagnosticArray, "/diagnostics", self._hear, 10)
        self._reset = node.create_client(Trigger, "/modbus_driver/reset")

    def _hear(self, told: DiagnosticArray) -> None:
        for status in told.status:
            if status.name == "modbus_driver":
                self.state = status.message

    def wait(self, condition: Callable[[], bool]) -> None:
        """Wait until something is so."""
        until = time.monotonic() + LIMIT_S
        while not condition():
            if time.monotonic() > until:
                raise TimeoutError(f"waited in vain; the driver says {self.state!r}")
            rclpy.spin_once(self._node, timeout_sec=0.02)

    def pass_time(self, seconds: float) -> None:
        """Wait so long."""
        until = time.monotonic() + seconds
        self.wait(lambda: time.monotonic() > until)

    def reset(self) -> None:
        """Let the valves follow their commands again."""
        answer = self._reset.call_async(Trigger.Request())
        self.wait(answer.done)
        if not answer.result().success:
            raise RuntimeError(answer.result().message)


@contextmanager
def started(*command: str | Path) -> Iterator[subprocess.Popen]:
    """Run Python with these words."""
    process = subprocess.Popen([sys.executable, *command], stdout=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.terminate()
        process.wait(LIMIT_S)


def walk(folder: Path) -> dict[str, Any]:
    """Let the leg walk, cut its network, reset the driver; return what the bag says."""
    bag = folder / "walk"
    rclpy.init()
    try:
        operator = Operator(rclpy.create_node("operator"))
        with (
            started(EXAMPLE / "terminal.py") as terminal,
            started(EXAMPLE / "driver.py"),
            started(*RUN, "--duration", f"{DURATION_S:g}", "--out", bag) as run,
        ):
            operator.wait(lambda: operator.state == "ready" and any(bag.glob("*.mcap")))
            operator.pass_time(WALK_S)
            os.kill(terminal.pid, signal.SIGUSR1)
            operator.wait(lambda: operator.state.startswith("fault: connected again"))
            operator.pass_time(LOOK_S)
            operator.reset()
            operator.wait(lambda: run.poll() is not None)
    finally:
        rclpy.shutdown()
    return judged(bag)


def judged(bag: Path) -> dict[str, Any]:
    """Return latency, missed deadlines, releases, and the largest errors before and after them, degrees."""
    releases = judge(bag, partial=True).releases
    series = read_bag(bag, ["angle", "reference_angle"])
    stamps, (angle, reference) = aligned(series["angle"], series["reference_angle"])
    since_s, error = (stamps - stamps[0]) * 1e-9, np.rad2deg(np.abs(reference - angle))
    back_s, answers = releases[-1].back_s, timing(bag)
    lost_s = next(one.since_s for one in releases if one.since_s > STARTED_S)
    settled = since_s > (np.inf if back_s is None else back_s + SETTLED_S)
    return {
        "latency_median_ms": answers.latency_median_ms,
        "latency_p99_ms": answers.latency_p99_ms,
        "periods": answers.periods,
        "missed_deadlines": answers.missed_deadlines,
        "skipped_samples": answers.skipped_samples,
        "releases": [str(one) for one in releases],
        "error_before_deg": float(error[(since_s > STARTED_S) & (since_s < lost_s)].max()),
        "error_after_deg": float(error[settled].max()) if settled.any() else None,
        "load_average": os.getloadavg()[0],
    }


def main() -> None:
    """Run the example, and keep a row of each run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--repeats", type=int, default=5)
    given = parser.parse_args()
    os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(config_folder() / "loopback.xml")
    rows = []
    for _ in range(given.repeats):
        with free_domain() as domain, tempfile.TemporaryDirectory() as folder:
            os.environ |= {"ROS_DOMAIN_ID": str(domain), "ROS_LOG_DIR": folder}
            rows.append(walk(Path(folder)))
            print(json.dumps(rows[-1]), flush=True)
            given.out.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
