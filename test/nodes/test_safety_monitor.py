# SPDX-License-Identifier: Apache-2.0
"""The safety monitor in the graph: restrains valves, vents without any other node, is in the bag."""

import json
import subprocess
import sys

import numpy as np
import pytest
from live_runs import QUICK, wait_for
from mcap.reader import make_reader
from own_domain import own_domain

from pam_orthosis.bag.cdr import Reader
from pam_orthosis.bag.read import raw_messages, read_bag
from pam_orthosis.bag.topics import ALLOWED, SAFETY, Topics
from pam_orthosis.cli.main import main
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.machines import KNEE

rclpy = pytest.importorskip("rclpy")
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from rclpy.experimental import EventsExecutor  # noqa: E402
from rclpy.serialization import deserialize_message  # noqa: E402

from pam_orthosis.nodes.inverse_valve_model import InverseValveModelNode  # noqa: E402
from pam_orthosis.nodes.plant_simulator import PlantSimulator  # noqa: E402
from pam_orthosis.nodes.safety_monitor import SafetyMonitorNode  # noqa: E402

PERIOD_NS = 5_000_000
REST, VENT = 3.4e5, -1.0
ENABLED = ["-p", "control.limits.enabled:=true"]


@pytest.fixture
def start(tmp_path, monkeypatch):
    """Return what makes nodes; in `start.until(condition)` they hear each other."""
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    running = {}

    def started(kind, *words):
        if not running:
            rclpy.init(args=["--ros-args", *words], domain_id=own_domain())
        node, executor = kind(), EventsExecutor()
        executor.add_node(node)
        running[node] = executor
        return node

    def until(condition):
        def met():
            for executor in running.values():
                executor.spin_once(timeout_sec=0.02)
            return condition()

        wait_for(met)

    started.until = until
    yield started
    for node, executor in running.items():
        executor.shutdown()
        node.destroy_node()
    rclpy.try_shutdown()


def fed(monitor, count=20, angle=0.6, pressure=REST):
    """Feed samples at rest, one a period."""
    first = monitor.time_ns + PERIOD_NS * monitor.stepped
    for index in range(count):
        monitor._step(first + index * PERIOD_NS, (angle,), (pressure,), (pressure,))


def test_it_vents_the_device_without_any_other_node_until_resumed(start):
    plant, monitor = start(PlantSimulator, *ENABLED), start(SafetyMonitorNode)
    fed(monitor)
    assert monitor.latched() == ""
    fed(monitor, 1, pressure=7.2e5)
    assert monitor.latched().startswith("pressure 7.2e+05 beyond 6.85e+05 at 0.100 s")
    start.until(plant._stop.step)

    plant._stop.reset()  # by somebody who does not know why
    assert not plant._stop.step()
    start.until(lambda: not monitor._stop.step())
    fed(monitor)
    start.until(plant._stop.step)
    assert monitor._monitor.allowed == 0.0

    assert "the pressure rises within" in monitor._resume()
    start.until(lambda: not plant._stop.step())
    fed(monitor)
    assert monitor.health()["trips"] == 1
    assert not monitor._stop.active
    with pytest.raises(OrthosisError, match="nothing has tripped"):
        monitor._resume()


def test_commands_that_fill_against_the_limits_stop_the_device(start):
    monitor = start(SafetyMonitorNode, *ENABLED)
    monitor.retune(monitor.parameters.changed({"control.limits.spasm": 0.1}))
    fed(monitor)
    for index in range(20):  # a small twitch is a spasm by this limit: the joint is softened, not vented
        fed(monitor, 1, 0.6 + 0.002 * (index % 2))
    assert monitor.latched().startswith("spasm")
    assert not monitor._stop.active
    for _ in range(20):
        fed(monitor, 1)
        for line in range(2):
            monitor._heard(line, monitor.time_ns, (VENT,))
    assert not monitor._stop.active
    for _ in range(12):
        fed(monitor, 1)
        monitor._heard(1, monitor.time_ns, (1.0,))
    assert "command" in monitor.latched()
    assert monitor._stop.active


def test_no_valve_fills_above_the_allowed_pressure_and_it_vents_far_above(start):
    valve, sent = start(InverseValveModelNode, *ENABLED), []
    valve._commands["extensor"] = lambda _stamp_ns, spool: sent.append(spool)
    for index, allowed in enumerate((6.85e5, REST - 1e4, REST - 1e5)):
        valve._step("extensor", index * PERIOD_NS, (1e-3,), (REST,), (allowed,))
    assert sent[0] > 0.0
    assert sent[1:] == [0.0, VENT]


def test_samples_that_stay_away_vent_in_real_time(start):
    monitor = start(SafetyMonitorNode, *ENABLED, "-p", "realtime:=true")
    now_ns = monitor.now_ns()
    for index in range(-20, 1):
        monitor._step(now_ns + index * PERIOD_NS, (0.6,), (REST,), (REST,))
    assert not monitor._stop.active
    start.until(lambda: monitor._stop.active)
    assert monitor.latched().startswith("stale data")


def test_limits_of_the_patient_may_be_set_while_it_runs(start):
    monitor = start(SafetyMonitorNode, *ENABLED)
    fed(monitor)
    wanted = rclpy.parameter.Parameter("control.limits.high", value=0.5)
    assert monitor.set_parameters([wanted])[0].successful
    fed(monitor, 1)
    assert monitor.latched().startswith("range of motion 0.6 beyond 0.5")
    fixed = rclpy.parameter.Parameter("control.limits.stale_time", value=0.5)
    assert not monitor.set_parameters([fixed])[0].successful


def test_alone_it_says_what_all_nodes_have_to_be_given(start):
    with pytest.raises(OrthosisError, match=r"set control\.limits\.enabled to true, for all nodes"):
        start(SafetyMonitorNode)


def test_it_hears_sensors_and_commands_alone():
    topics, with_it = Topics(KNEE), Topics(KNEE).of_run(beside=(ALLOWED,))
    heard = {name for name, topic in with_it.items() if SAFETY in topic.consumers}
    assert heard == {*topics.sensors, *topics.commands, "emergency_stop", "configuration", "end"}
    without = topics.of_run()
    assert not any(SAFETY in (*topic.producers, *topic.consumers) for topic in without.values())
    assert set(with_it) - set(without) == {ALLOWED}


@pytest.fixture(scope="module")
def tripped(tmp_path_factory):
    """Return a bag of a walk that is faster than its limit allows."""
    bag = tmp_path_factory.mktemp("run") / "walk"
    options = ["--safety", "--composed", "--duration", "1.5", "--out", str(bag), *QUICK]
    run = [sys.executable, "-m", "pam_orthosis.cli.main", "run", "--param", "control.limits.speed=2"]
    subprocess.run([*run, *options], capture_output=True, check=False, timeout=600)
    return bag


def test_a_trip_vents_the_muscles_and_is_in_the_bag(tripped):
    raw = raw_messages(tripped, [ALLOWED])
    read = Reader(Topics(KNEE).by_name[ALLOWED].type, ["fluid_pressure"])
    allowed = np.array([read(data)[1][0] for data in raw[ALLOWED].values()])
    assert len(allowed) == 300
    first = int(np.argmin(allowed))
    assert np.all(allowed[:first] == 6.85e5)
    assert np.all(allowed[first:] == 0.0)
    assert 20 < first < 250
    names = [f"{muscle}_{what}" for what in ("voltage", "pressure") for muscle in KNEE.names]
    bag = read_bag(tripped, names)
    for name in names[:2]:
        assert np.all(bag[name].value[first:] == 0.0)
    for name in names[2:]:
        assert bag[name].value[-1] < 1.2e5 < bag[name].value[first]
    reports = [deserialize_message(data, DiagnosticArray).status[0] for data in raw_reports(tripped)]
    (last,) = [one for one in reports if one.name == f"{SAFETY}: loop"][-1:]
    assert last.level == DiagnosticStatus.ERROR
    assert last.message.startswith("speed")


def raw_reports(bag):
    with open(next(bag.glob("*.mcap")), "rb") as stream:
        return [data.data for *_, data in make_reader(stream).iter_messages(topics=["/diagnostics"])]


def test_a_bag_with_a_safety_monitor_is_fed_to_the_nodes_again(tripped, capsys):
    assert main(["replay", str(tripped), "--node", "inverse_valve_model", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)
