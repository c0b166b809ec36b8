# SPDX-License-Identifier: Apache-2.0
"""A node that dies or hangs ends the run, by name, with a bag that opens."""

import os
import signal

import pytest
from live_runs import alive, wait_for

from pam_orthosis.bag.read import read_bag
from pam_orthosis.bag.recover import recover_in_place


def _assert_stopped(run, children, node, bag_count=10):
    status, said = run.ended()
    assert status == 3
    assert f"node {node} " in said
    assert not [name for name, pid in children.items() if alive(pid)]
    assert len(read_bag(run.bag, ["angle"])["angle"].value) > bag_count


@pytest.mark.parametrize(
    ("node", "number"),
    [
        ("extensor_pressure_controller", signal.SIGKILL),
        ("bag_recorder", signal.SIGKILL),
        ("position_controller", signal.SIGSTOP),
        ("bag_recorder", signal.SIGSTOP),
        ("trajectory_publisher", signal.SIGTERM),
    ],
)
def test_a_lost_node_ends_the_run(live_run, node, number):
    run = live_run()
    run.wait_until_it_records()
    children = run.children()
    os.kill(children[node], number)
    _assert_stopped(run, children, node)


def test_a_lost_process_of_composed_nodes_ends_the_run(live_run):
    run = live_run("--composed")
    run.wait_until_it_records()
    children = run.children()
    os.kill(children["composed"], signal.SIGKILL)
    _assert_stopped(run, children, "composed")


def test_nodes_end_by_themselves_without_their_supervisor(live_run):
    run = live_run()
    run.wait_until_it_records()
    children = run.children()
    os.kill(run.process.pid, signal.SIGKILL)
    wait_for(lambda: not any(alive(pid) for pid in children.values()))
    assert len(read_bag(run.bag, ["angle"])["angle"].value) > 10


def test_interrupted_run_closes_its_bag(live_run):
    run = live_run("--composed")
    run.wait_until_it_records()
    run.process.send_signal(signal.SIGINT)
    status, said = run.ended()
    assert status == 3
    told = f"interrupted; the bag {run.bag} holds the run up to there; logs in {run.bag / 'log'}"
    assert said.splitlines()[-1] == f"pam-orthosis: {told}"
    assert len(read_bag(run.bag, ["angle"])["angle"].value) > 10


def test_killed_with_its_supervisor_the_bag_is_recovered_by_one_command(live_run):
    run = live_run("--composed")
    run.wait_until_it_records()
    children = run.children()
    for pid in (run.process.pid, children["composed"]):
        os.kill(pid, signal.SIGKILL)
    wait_for(lambda: not alive(children["composed"]))
    assert recover_in_place(run.bag) > 100
    assert len(read_bag(run.bag, ["angle"])["angle"].value) > 10
