# SPDX-License-Identifier: Apache-2.0
"""The real graph of a machine of a user's own file: it runs from anywhere, and its bag needs no file."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader

from pam_orthosis.bag.read import read_bag
from pam_orthosis.bag.topics import Topics, resolve
from pam_orthosis.cli.main import main
from pam_orthosis.model.machines import read_machine
from pam_orthosis.model.parameters import load
from pam_orthosis.nodes.launch import free_domain
from pam_orthosis.reading import config_folder

pytest.importorskip("rclpy")

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "cylinder" / "cylinder.yaml"
BOUND_MM = 1.0  # of 160 mm from end to end
OPTIONS = ("--duration", "2", "--bound-mm", f"{BOUND_MM}", "--json")


@pytest.fixture(scope="module")
def composed(run_graph, tmp_path_factory):
    """A run whose machine file is gone afterwards."""
    file = tmp_path_factory.mktemp("mine") / "cylinder.yaml"
    shutil.copy(EXAMPLE, file)
    done, bag = run_graph("--machine", str(file), "--composed", *OPTIONS)
    file.unlink()
    return done, bag


def _content(bag):
    with open(next(bag.glob("*.mcap")), "rb") as stream:
        return [
            (channel.topic, message.log_time, message.data)
            for _, channel, message in make_reader(stream).iter_messages()
        ]


def test_it_is_controlled_and_recorded(composed):
    done, bag = composed
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    read = read_bag(bag, ["position", "reference_position", "push_voltage", "truth_position", "disturbance"])
    assert told["max_abs_error_mm"] <= BOUND_MM
    assert told["samples"] == round(2.0 / read.parameters["scenario.control_period"])
    moved = read["position"].value
    assert moved.max() - moved.min() > 10 * BOUND_MM * 1e-3  # it had somewhere to go
    assert abs(read["truth_position"].value - moved).max() < 1e-4
    assert read.machine == read_machine(EXAMPLE)


def test_the_bag_holds_every_topic_of_the_machines_table(composed):
    topics = {topic for topic, _, _ in _content(composed[1])}
    assert topics >= {resolve(one.name) for one in Topics(read_machine(EXAMPLE)).recorded}


def test_its_bag_is_judged_without_the_file(composed, capsys):
    assert main(["check", str(composed[1]), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["max_abs_error_mm"] <= BOUND_MM


def test_processes_and_one_process_agree_to_the_bit(composed, run_graph):
    done, bag = run_graph("--machine", str(EXAMPLE), *OPTIONS)
    assert done.returncode == 0, done.stderr
    assert _content(bag) == _content(composed[1])


def test_the_knees_own_file_runs_as_the_knee_does_to_the_bit(in_processes, run_graph, tmp_path):
    """Its effects and dead time are values of config/, which another machine's hardware has not."""
    shipped = (config_folder() / "machines" / "knee.yaml").read_text(encoding="utf-8")
    effects = {key: value for key, value in load().flat().items() if key.startswith("plant.effects.")}
    own = {**effects, "valve.delay": load().valve.delay}
    (tmp_path / "knee.yaml").write_text(shipped + yaml.safe_dump({"values": own}), encoding="utf-8")
    done, bag = run_graph("--machine", str(tmp_path / "knee.yaml"), "--composed", "--duration", "1")
    assert done.returncode == 0, done.stderr
    assert read_bag(bag, ["angle"]).run["machine_name"] == "knee"
    assert _content(bag) == _content(in_processes[1])


def test_its_nodes_answer_the_bag_again_to_the_bit(composed, capsys):
    assert main(["replay", str(composed[1]), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["identical"]
    topics = {one["topic"] for one in told["legs"][""]}
    assert {"push/mass_flow", "pull/valve_command", "joint_states", "estimate"} <= topics


def test_by_the_wall_clock_a_driver_stands_in_for_the_hardware(run_graph, monkeypatch):
    with free_domain() as domain:
        monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(config_folder() / "loopback.xml"))
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        command = [sys.executable, "-m", "pam_orthosis.nodes.dummy_driver", "--ros-args"]
        driver = subprocess.Popen([*command, "-p", f"machine_file:={EXAMPLE}"])
        try:
            # long enough for messages to get through by the wall clock where processes wait for a processor
            options = ("--realtime", "--no-plant", *OPTIONS, "--duration", "6")
            done, bag = run_graph("--machine", str(EXAMPLE), *options)
        finally:
            driver.terminate()
    assert driver.wait(30) == 0
    assert done.returncode in (0, 1), done.stderr  # a busy machine may follow badly
    assert json.loads(done.stdout)["samples"] > 0
    topics = {topic for topic, _, _ in _content(bag)}
    assert {"/joint_states", "/push/pressure", "/pull/valve_command", "/answered"} <= topics
    assert "/truth" not in topics


ONE = (
    ("  pull: {", "  # pull: {"),
    ("         transmission: {arm: -1.0", "         # transmission: {arm: -1.0"),
)


@pytest.mark.parametrize(
    ("changes", "options", "words"),
    [
        ((("translation", "transport"),), (), "kind of the mechanism is one of"),
        (ONE, (), "the controllers move two actuators against each other, not 1"),
        ((("scenario.trajectory: sine", "scenario.trajectory: gait"),), (), "scenario.gait goes to 0.32 m"),
        ((), ("--param", "scenario.trajectory=decay"), "decay is not for the"),
        ((), ("--param", "leg.shank.mass=3"), "unknown parameter leg.shank.mass"),
        ((), ("--scenario", "person"), "--scenario person is for the knee"),
        ((), ("--legs", "2"), "--legs 2 is for the knee"),
        ((), ("--bound-deg", "2"), "errors of the mine are in mm; give --bound-mm"),
    ],
    ids=lambda one: " ".join(one)[:30] if one and isinstance(one[0], str) else None,
)
def test_what_cannot_run_is_refused_in_one_line_before_it_starts(tmp_path, capsys, changes, options, words):
    text = EXAMPLE.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file = tmp_path / "mine.yaml"
    file.write_text(text, encoding="utf-8")
    command = ["run", "--machine", str(file), "--out", str(tmp_path / "bag"), *options]
    assert main(command) == 2
    told = capsys.readouterr().err
    assert words in told
    assert len(told.splitlines()) == 1
    assert not (tmp_path / "bag").exists()


def test_a_nominal_model_that_would_change_the_hardware_too_is_refused(tmp_path, capsys):
    model = tmp_path / "model.yaml"
    model.write_text("machine.mechanism.inertia: 9.0\n", encoding="utf-8")
    assert main(["run", "--machine", str(EXAMPLE), "--model", str(model)]) == 2
    assert "the hardware has it from the machine's file too" in capsys.readouterr().err


def test_a_file_that_is_not_there_is_refused(tmp_path, capsys):
    assert main(["run", "--machine", str(tmp_path / "none.yaml")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
