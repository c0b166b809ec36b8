# SPDX-License-Identifier: Apache-2.0
"""A plan travels beside the reference: the graph follows it, errors count from what is wanted."""

import numpy as np
import pytest
from live_runs import QUICK
from rosbags.highlevel import AnyReader

from pam_orthosis.bag.read import read_bag
from pam_orthosis.cli.main import main
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.discrepancy.answer import patch
from pam_orthosis.model.parameters import load

STEPS = 400
PLAN = {
    "scenario.plan.enabled": True,
    "scenario.plan.angle.cosine": [0.01, -0.01] + [0.0] * 23,
    "scenario.plan.angle.sine": [0.0, 0.0, 0.008] + [0.0] * 22,
    "scenario.plan.pressure.cosine": [4.0e5, 2.0e4] + [0.0] * 23,
}


@pytest.fixture(scope="module")
def planned_run(run_graph, tmp_path_factory):
    model = tmp_path_factory.mktemp("model") / "plan.yaml"
    patch.write(model, PLAN)
    done, bag = run_graph("--composed", "--duration", "2", "--model", str(model))
    assert done.returncode == 0, done.stderr
    return bag


def test_the_graph_follows_a_plan_as_one_process_does_to_the_bit(planned_run):
    settings = {text.partition("=")[0]: float(text.partition("=")[2]) for text in QUICK if "=" in text}
    expected = ClosedLoop(load(PLAN | settings), 1).run(STEPS)
    names = ["angle", "reference_angle", "flexor_pressure"]
    found = read_bag(planned_run, names)
    for name in names:
        np.testing.assert_array_equal(found[name].value[:STEPS], expected[name], err_msg=name)


def test_the_bag_holds_what_is_wanted_and_what_is_planned(planned_run):
    found = read_bag(planned_run, ["reference_angle", "followed_angle"])
    change = found["followed_angle"].value - found["reference_angle"].value
    assert np.abs(change).max() == pytest.approx(0.0264, abs=2e-3)  # by the coefficients
    with AnyReader([planned_run]) as reader:
        counts = {one.topic: one.msgcount for one in reader.connections}
        motions = [one for one in reader.connections if one.topic in ("/reference", "/planned_reference")]
        points = [reader.deserialize(data, one.msgtype).points for one, _, data in reader.messages(motions)]
    assert counts["/reference_pressure"] == counts["/planned_reference"] == counts["/reference"]
    assert {(len(each), each[0].effort.size) for each in points} == {(1, 0)}


def test_a_planned_run_is_replayed_to_the_bit(planned_run, capsys):
    assert main(["replay", str(planned_run)]) == 0, capsys.readouterr().err
