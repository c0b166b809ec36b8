# SPDX-License-Identifier: Apache-2.0
"""The example of a machine of one's own: it runs, is controlled and recorded, and its friction is found."""

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from wired import DEVICE, Wired

from pam_orthosis.bag.verdict import Bound, judge
from pam_orthosis.cli.main import main
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.discrepancy.answer import patch
from pam_orthosis.model.machines import read_machine
from pam_orthosis.model.parameters import load
from pam_orthosis.nodes import launch
from pam_orthosis.nodes.supervisor import supervise

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE, PAGE = ROOT / "examples" / "cylinder", ROOT / "docs" / "howto" / "machine.md"
MACHINE = EXAMPLE / "cylinder.yaml"
MOST_LINES = 150
LIMIT_S = 300.0  # after which a test counts as hung: none is about speed
(FRICTION,) = map(float, re.findall(r"^FRICTION, .* = ([\d.]+),", DEVICE.read_text(), flags=re.M))


def _searched(folder, *recordings):
    """Return gap.json of a search that names the friction, which is checked."""
    assert main(["gap", *map(str, recordings), "--out", str(folder)]) == 0
    told = json.loads((folder / "gap.json").read_text())
    (effect,) = told["effects"]
    assert (told["verdict"], effect["name"]) == ("explained", "carriage_friction")
    level = effect["parameters"]["coulomb"]
    low, high = level["interval"]
    assert level["unit"] == "N"
    assert low <= FRICTION <= high
    assert level["value"] == pytest.approx(FRICTION, rel=0.05)
    return level


@pytest.fixture(scope="module")
def from_tables(tmp_path_factory):
    """Return what is found in tables that the device writes, and the folder of the answer."""
    folder = tmp_path_factory.mktemp("tables")
    tables = [folder / f"{seed}.csv" for seed in (1, 2, 3)]
    for seed, path in enumerate(tables, 1):
        subprocess.run([sys.executable, str(DEVICE), str(path), str(seed)], check=True)
    found = folder / "found"
    return _searched(found, *tables[:2], "--held-out", tables[2], "--machine", MACHINE), found


def test_it_is_short_and_its_device_knows_nothing_of_the_model():
    files = [path for path in EXAMPLE.rglob("*") if path.suffix in (".yaml", ".py")]
    assert {MACHINE, DEVICE} <= set(files)
    assert sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files) <= MOST_LINES
    assert not re.findall(r"^\s*(?:from|import)\s+pam_orthosis", DEVICE.read_text(), flags=re.M)


def test_gap_names_the_friction_of_the_device_in_its_tables(from_tables):
    level, _ = from_tables
    low, high = level["interval"]
    assert f"{level['value']:.1f} N ({low:.1f} .. {high:.1f})" in PAGE.read_text(encoding="utf-8")


def _largest_error(overrides):
    parameters = load(overrides, read_machine(MACHINE))
    run = ClosedLoop(parameters, plant=Wired(parameters)).run(1000)
    assert np.ptp(run["true_position"]) > 0.15
    return 1e3 * np.abs(run["reference_position"] - run["true_position"]).max()


def test_what_its_file_states_wrongly_is_named_beside_the_friction(from_tables, tmp_path):
    """No friction explains a piston of another size."""
    stated, wrong, key, true = "area: 8.0e-4", "area: 5.6e-4", "machine.push.area", 8.0e-4
    text, machine, out = MACHINE.read_text(), tmp_path / "wrong.yaml", tmp_path / "found"
    assert text.count(stated) == 1
    machine.write_text(text.replace(stated, wrong))
    tables = [str(from_tables[1].parent / f"{seed}.csv") for seed in (1, 2, 3)]
    machine_and_out = ["--machine", str(machine), "--out", str(out)]
    assert main(["gap", *tables[:2], "--held-out", tables[2], *machine_and_out]) == 0
    found = {one["wrong_parameter"]: one for one in json.loads((out / "gap.json").read_text())["effects"]}
    assert set(found) == {None, key}
    assert found[None]["name"] == "carriage_friction"
    assert found[None]["parameters"]["coulomb"]["value"] == pytest.approx(FRICTION, rel=0.05)
    value = found[key]["parameters"]["value"]
    assert value["value"] == pytest.approx(true, rel=0.02)
    assert value["interval"][0] < true < value["interval"][1]


def test_its_controllers_follow_better_with_what_gap_found(from_tables):
    model = from_tables[1] / "model.yaml"
    plain, taught = _largest_error({}), _largest_error(patch.read(model, read_machine(MACHINE)))
    assert plain < 5.0
    assert taught < 0.5 * plain
    shown = f"from {plain:.1f} mm to {taught:.1f} mm"
    assert shown in PAGE.read_text(encoding="utf-8"), shown


def test_its_emulation_runs_in_the_graph(tmp_path, capsys):
    pytest.importorskip("rclpy")
    bag = tmp_path / "slide"
    given = ["--machine", str(MACHINE), "--composed", "--duration", "6", "--bound-mm", "1", "--out", str(bag)]
    command = [sys.executable, "-m", "pam_orthosis.cli.main", "run", *given, "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["passed"], told["samples"], set(told["voltage_variation_per_s"])) == (
        True, 600, {"push", "pull"},
    )  # fmt: skip


def test_the_device_in_the_graph_is_recorded_and_its_bag_names_the_friction(tmp_path):
    pytest.importorskip("rclpy")
    work, bag = tmp_path / "work", tmp_path / "slide"
    work.mkdir()
    parameters = load({"scenario.duration": 20.0}, read_machine(MACHINE))
    commands = launch.commands(work, parameters, bag, "default", launch.Mode(composed=True))
    (name,) = commands
    wired = [sys.executable, str(Path(__file__).with_name("wired.py")), *commands[name][3:]]
    with launch.free_domain() as domain:
        supervise({name: wired}, launch.environment(work, domain), work, lambda _: None)
    verdict = judge(bag, Bound(5.0, "mm"))
    assert verdict.passed
    assert verdict.max_abs_error > 2.0, "the friction shows"
    _searched(tmp_path / "found", bag)


@pytest.fixture
def graph(tmp_path, monkeypatch):
    """Return a node in a domain in which the driver runs."""
    rclpy = pytest.importorskip("rclpy")
    with launch.free_domain() as domain:
        context = rclpy.Context()
        for name, value in launch.environment(tmp_path, domain).items():
            monkeypatch.setenv(name, value)
        rclpy.init(context=context, domain_id=domain)
        node = rclpy.create_node("controllers", context=context)
        heeding = ["env", "--default-signal=INT"]  # a shell in the background has children ignore it
        command = [*heeding, sys.executable, str(DEVICE)]
        driver = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        yield node
        driver.send_signal(signal.SIGINT)
        _, said = driver.communicate(timeout=LIMIT_S)
        node.destroy_node()
        rclpy.shutdown(context=context)
        assert "Traceback" not in said


def test_its_driver_samples_takes_voltages_and_vents_without_them(graph):
    """As docs/howto/driver.md asks: one stamp for all sensors, whole periods apart, vented when alone."""
    import rclpy
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import FluidPressure, JointState

    came = {"joint_states": {}, "push/pressure": {}, "pull/pressure": {}}

    def listen(topic, kind):
        def receive(message):
            stamp = message.header.stamp
            came[topic][stamp.sec * 10**9 + stamp.nanosec] = message

        graph.create_subscription(kind, topic, receive, qos_profile_sensor_data)

    def until(condition, *volts):
        deadline = time.monotonic() + LIMIT_S
        while not condition():
            assert time.monotonic() < deadline, "waited in vain"
            for publisher, volt in zip(valves, volts, strict=False):
                publisher.publish(JointState(position=[(volt - 5) / 5]))
            rclpy.spin_once(graph, executor=executor, timeout_sec=0.005)

    def last(topic):
        return came[topic][max(came[topic])] if came[topic] else None

    executor = rclpy.executors.SingleThreadedExecutor(context=graph.context)
    listen("joint_states", JointState)
    listen("push/pressure", FluidPressure)
    listen("pull/pressure", FluidPressure)
    valves = [graph.create_publisher(JointState, f"{name}/valve_command", 10) for name in ("push", "pull")]
    until(lambda: len(set.intersection(*map(set, came.values()))) > 5)
    first = last("joint_states")
    assert (first.name, first.position[0]) == (["cylinder"], pytest.approx(0.15, abs=1e-3))
    stamps = np.array(sorted(came["joint_states"]))
    assert not (np.diff(stamps) % 10_000_000).any()
    until(lambda: last("joint_states").position[0] > 0.16, 5.5, 4.5)
    until(lambda: all(last(f"{name}/pressure").fluid_pressure < 1.1e5 for name in ("push", "pull")))
