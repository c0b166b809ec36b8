# SPDX-License-Identifier: Apache-2.0
"""The real graph of a leg: each joint has its own nodes in a namespace, one plant couples both."""

import json
from pathlib import Path

import numpy as np
import pytest
from coupled_loop import CoupledLoop
from live_runs import QUICK

from pam_orthosis.bag.legs import namespaces
from pam_orthosis.bag.read import read_bag
from pam_orthosis.bag.topics import BESIDE, Topics, resolve
from pam_orthosis.cli.main import main
from pam_orthosis.control.legs import device_parameters
from pam_orthosis.discrepancy.apparatus import recorded_nominal
from pam_orthosis.model.device import device_named

LEG = device_named(Path("leg"))


@pytest.fixture(scope="module")
def leg(run_graph):
    """One second of gait, all nodes in one process."""
    return run_graph("--machine", "leg", "--composed", "--duration", "1", "--bound-deg", "1", "--json")


def test_each_joint_is_judged_by_its_own_bound(leg, capsys):
    done, bag = leg
    assert done.returncode == 0, done.stderr
    verdict = json.loads(done.stdout)
    assert verdict["passed"]
    assert {joint: one["samples"] for joint, one in verdict["legs"].items()} == {"knee": 200, "ankle": 200}
    assert namespaces(bag) == ["/ankle", "/knee"]
    error = verdict["legs"]["ankle"]["max_abs_error_deg"]
    assert error > 0.05, "it moves"
    assert main(["check", str(bag), "--bound-deg", f"5,ankle={error / 2}"]) == 1
    said = capsys.readouterr().out
    assert "FAILED" in said.split("knee\n")[0]
    assert "PASSED" in said.split("knee\n")[1]
    assert main(["check", str(bag), "--bound-deg", "5,hip=1"]) == 2
    assert "no hip to bound; there are: ankle, knee" in capsys.readouterr().err


def test_the_graph_computes_what_the_loop_without_it_does(leg):
    values = {key: float(value) for key, value in (text.split("=") for text in QUICK[1::2])}
    expected = CoupledLoop(device_parameters(LEG, values)).run(200)
    for joint, machine in LEG.joints.items():
        names = ["angle", *(f"{name}_voltage" for name in machine.names)]
        recorded = read_bag(leg[1], names, namespace=f"/{joint}")
        assert np.ptp(recorded["angle"].value) > np.radians(1)
        for name in names:
            np.testing.assert_array_equal(recorded[name].value, expected[joint][name])


def test_the_bag_holds_every_topic_of_both_joints_and_their_machines(leg):
    for joint, machine in LEG.joints.items():
        bag = read_bag(leg[1], Topics(machine).signals, namespace=f"/{joint}")
        assert bag.machine == machine
        assert bag.parameters["scenario.start_hold"] == 0.1
        assert Topics(machine).signals.keys() == bag.series.keys()
        assert resolve(BESIDE, joint) in {resolve(one.name, joint) for one in Topics(machine).recorded}


def test_the_controllers_of_a_joint_answer_the_bag_again_to_the_bit(leg, capsys):
    assert main(["replay", str(leg[1]), "--namespace", "ankle", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["identical"]
    topics = {one["topic"] for one in told["legs"]["ankle"]}
    assert {"estimate", "dorsiflexor/mass_flow", "plantarflexor/valve_command"} <= topics
    assert "joint_states" not in topics  # both joints move together


def test_the_page_has_a_verdict_and_a_drawing_for_each_joint(leg, tmp_path, capsys):
    bag = leg[1]
    assert main(["report", str(bag), "--bound-deg", "5,ankle=0.01", "--out", str(tmp_path)]) == 0
    page = (tmp_path / f"{bag.name}.html").read_text(encoding="utf-8")
    assert "The bag holds 2 machines; beyond their bounds are ankle." in page
    for joint, answer in (("ankle", "FAILED"), ("knee", "PASSED")):
        assert f"<td>{joint}</td><td>{answer}</td>" in page
        assert f"<h2>{joint}: the machine" in page
    assert not list(tmp_path.glob("*.png"))
    assert main(["report", str(bag), "--only", "picture", "--out", str(tmp_path)]) == 2
    assert "holds several machines; give one by --namespace: ankle, knee" in capsys.readouterr().err
    one = ["--namespace", "/ankle", "--only", "picture", "--out", str(tmp_path)]
    assert main(["report", str(bag), *one]) == 0


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ((), "holds several machines; give one by --namespace: ankle, knee"),
        (("--namespace", "hip"), "holds no hip; give one by --namespace: ankle, knee"),
        (("--namespace", "/ankle"), "lasts 1.0 s: the search needs 5 s or more"),
    ],
)
def test_gap_says_in_a_line_why_it_cannot_search_a_joint(leg, capsys, given, words):
    assert main(["gap", str(leg[1]), *given]) == 2
    told = capsys.readouterr().err.splitlines()
    assert words in told[-1]
    assert sum("error" in line for line in told) == 1
    ankle = LEG.joints["ankle"]
    nominal = recorded_nominal(leg[1], "ankle")
    assert nominal["leg.ankle.dorsiflexor.lever"] == ankle.values["leg.ankle.dorsiflexor.lever"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--legs", "2"), "are for single machines, not for leg"),
        (("--watch",), "are for single machines, not for leg"),
        (("--realtime",), "give --composed too"),
        (("--param", "leg.wing=1"), "no joint of the leg has a parameter leg.wing"),
        (("--bound-mm", "1"), "give --bound-deg"),
        (("--param", "scenario.trajectory=sine"), "coupled joints move by gait or hold"),
    ],
)
def test_what_a_leg_cannot_do_is_refused_before_it_starts(tmp_path, capsys, options, words):
    assert main(["run", "--machine", "leg", "--out", str(tmp_path / "bag"), *options]) == 2
    told = capsys.readouterr().err
    assert words in told
    assert len(told.splitlines()) == 1
    assert not (tmp_path / "bag").exists()
