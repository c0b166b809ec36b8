# SPDX-License-Identifier: Apache-2.0
"""Health reports: an error while a node vents until somebody acts, a warning while a counter grows."""

import pytest

pytest.importorskip("rclpy")
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from own_domain import own_domain

from pam_orthosis.nodes.inverse_valve_model import InverseValveModelNode

OK, WARN, ERROR, STALE = (getattr(DiagnosticStatus, level) for level in ("OK", "WARN", "ERROR", "STALE"))


class Reports(list):
    def publish(self, report):
        self.extend(report.status)

    def last(self):
        return self[-1].level, self[-1].message


@pytest.fixture
def make(tmp_path, monkeypatch):
    """Return what makes a node, with arguments of the command line, and the list of its reports."""
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))

    nodes = []

    def made(*arguments):
        rclpy.init(args=["--ros-args", *arguments], domain_id=own_domain())
        nodes.append(InverseValveModelNode())
        reports = Reports()
        nodes[0]._diagnostics = {"": reports}
        return nodes[0], reports

    yield made
    nodes[0].destroy_node()
    rclpy.shutdown()


def test_a_counter_warns_only_while_it_grows(make, monkeypatch):
    node, reports = make()
    for count, expected in ((0, OK), (1, WARN), (1, OK), (3, WARN), (3, OK)):
        monkeypatch.setattr(node, "health", lambda count=count: {"dropped_inputs": count, "vent": ""})
        node._report_health(0)
        assert reports.last() == (expected, "ok" if expected == OK else "dropped_inputs")
        assert {one.key: one.value for one in reports[-1].values}["dropped_inputs"] == str(count)


def test_an_emergency_stop_is_an_error_until_it_is_reset(make):
    node, reports = make()
    node._report_health(0)
    assert reports.last() == (OK, "ok")
    node._stop.stop()
    for _ in range(2):
        node._report_health(0)
        assert reports.last() == (ERROR, "emergency stop")


def test_a_signal_that_is_lost_is_an_error(make):
    node, reports = make()
    for _ in range(100):
        node._models["flexor"].step(0.0, float("nan"))
    node._report_health(0)
    assert reports.last() == (ERROR, "pressure not finite")


def test_the_namespace_is_in_the_name(make):
    node, reports = make("-r", "__ns:=/left")
    node._report_health(0)
    assert reports[-1].name == "left/inverse_valve_model: loop"
    assert node.topics["/diagnostics"].shared
    assert node.leg == "left"


def test_a_node_without_steps_is_stale_after_two_seconds(make):
    node, reports = make("-p", "realtime:=true")
    for seconds, expected in ((1.0, []), (2.5, [STALE])):
        node.active, node._stepped_at = True, node._stepped_at - seconds
        node._report_standstill()
        assert [one.level for one in reports] == expected
    assert reports[-1].message.startswith("no step for ")
