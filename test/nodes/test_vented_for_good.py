# SPDX-License-Identifier: Apache-2.0
"""What a guard does in a running graph: the verdict tells it, and after a reset the knee walks again."""

import textwrap

import pytest

from pam_orthosis.bag.verdict import judge

pytest.importorskip("rclpy")
QUICK = ("--param", "scenario.start_hold=0.0")
BROKEN = """
    # Python imports this by itself: the plant of this run has a fault between two instants of its time
    from pam_orthosis.model import plant

    measure, live_on = plant.Plant.measure, plant.Plant.live_on

    def measured(self):
        sample = measure(self)
        if {since} <= self.time_ns * 1e-9 < {until}:
            {fault}
        return sample

    plant.Plant.measure = measured
"""


@pytest.fixture
def broken(tmp_path, monkeypatch):
    """Return what lets the plants of all runs have a fault."""

    def happens(since, until, fault):
        text = textwrap.dedent(BROKEN).format(since=since, until=until, fault=fault)
        (tmp_path / "sitecustomize.py").write_text(text)
        monkeypatch.setenv("PYTHONPATH", str(tmp_path))

    return happens


def test_after_a_stop_and_reset_the_knee_walks_again_though_its_sensor_was_lost(caller, live_run, broken):
    broken(1.0, 1.2, "sample = sample._replace(angle=4.0)")
    run = live_run("--open", "--composed", *QUICK)
    run.wait_until_it_records()
    caller.let_pass(2.5)  # reports come once a second
    refused = caller.trigger("inverse_valve_model/reset")
    assert not refused.success
    assert "what vents for good is tried again after one" in refused.message
    assert caller.trigger("inverse_valve_model/emergency_stop").success
    assert caller.trigger("inverse_valve_model/reset").success
    caller.let_pass(9.0)
    run.process.terminate()
    run.ended()
    first, *_ = judge(run.bag, partial=True).releases
    assert first.reason == "angle out of range"
    assert 1.0 < first.since_s < 1.1
    assert first.until_s < first.back_s < first.until_s + 6.0


def test_a_knee_that_was_held_is_let_go_led_back_and_the_verdict_says_so(run_graph, broken):
    broken(1.5, 1.9, "self.state[:2] = 1.2, 0.0")
    done, bag = run_graph("--composed", "--duration", "7")
    assert done.returncode == 1, done.stderr
    (released,) = judge(bag).releases
    assert released.reason == "knee does not follow"
    assert 1.5 < released.since_s < 2.0
    assert released.until_s < released.back_s < 7.0
    assert f"released                   {released}" in done.stdout
