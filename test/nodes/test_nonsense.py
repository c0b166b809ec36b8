# SPDX-License-Identifier: Apache-2.0
"""A position controller asks for nonsense: the safety monitor alone keeps all limits, by the truth."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from live_runs import LIMIT_S
from nonsense import Nonsense

from pam_orthosis.bag.read import read_bag
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model.parameters import load
from pam_orthosis.nodes.launch import Mode, commands, environment, free_domain

PROGRAM = Path(__file__).with_name("nonsense.py")
SECONDS, START = 1.5, {"scenario.start_angle": 0.6, "scenario.trajectory": "hold"}
TRUTH = ("truth_angle", "truth_velocity", *(f"truth_{m}_{what}" for m in ("extensor", "flexor")
         for what in ("pressure", "force")))  # fmt: skip
# as benchmarks/safety.py has them; the monitor looks ahead, the valves need time
MARGINS = {"range": 0.1, "speed": 0.0, "effort": 5.0, "pressure": 2e4}
KINDS = ("random", "full", "stuck", "nan")


def beyond(angle, velocity, pressures, forces, parameters):
    """Return by how much the truth is beyond each limit, at most."""
    limits, lever = parameters.control.limits, parameters.leg.cogwheel_diameter / 2
    torque = lever * (forces[1] - forces[0])
    return {
        "range": max(limits.low - angle.min(), angle.max() - limits.high),
        "speed": np.abs(velocity).max() - limits.speed,
        "effort": np.abs(torque).max() - limits.effort,
        "pressure": np.max(pressures) - limits.pressure,
    }


@pytest.mark.parametrize("kind", KINDS)
def test_the_monitor_alone_keeps_all_limits(tmp_path, kind):
    pytest.importorskip("rclpy")
    parameters = load({**START, "scenario.duration": SECONDS, "control.limits.enabled": True})
    bag = tmp_path / "bag"
    (command,) = commands(tmp_path, parameters, bag, "default", Mode(composed=True)).values()
    with free_domain() as domain:
        words = [sys.executable, str(PROGRAM), kind, *command[command.index("composed") :]]
        done = subprocess.run(
            words,
            env=environment(tmp_path, domain),
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )
    assert done.returncode == 0, done.stderr
    read = read_bag(bag, TRUTH)
    angle, velocity, *others = (read[name].value for name in TRUTH)
    assert len(angle) >= SECONDS / 0.005
    found = beyond(angle, velocity, others[0::2], others[1::2], parameters)
    assert all(found[name] <= margin for name, margin in MARGINS.items()), found


def test_without_a_monitor_the_same_nonsense_breaks_a_limit():
    parameters = load(START)
    loop = ClosedLoop(parameters, 1)
    loop._position = Nonsense("full")
    run = loop.run(round(SECONDS / 0.005))
    assert run["true_angle"].max() > parameters.control.limits.high + MARGINS["range"]
