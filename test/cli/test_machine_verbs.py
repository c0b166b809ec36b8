# SPDX-License-Identifier: Apache-2.0
"""Verbs with a machine of a user's file: they work in its units, or refuse in one line."""

import json
from argparse import Namespace
from pathlib import Path

import pytest

from pam_orthosis.bag.simulated import record_run
from pam_orthosis.batch import margin as units
from pam_orthosis.batch.unit import Answer
from pam_orthosis.cli.main import main
from pam_orthosis.cli.parameters import with_model
from pam_orthosis.control import margin
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model.machines import read_machine
from pam_orthosis.model.parameters import load

ROOT = Path(__file__).resolve().parents[2]
CYLINDER = ROOT / "examples" / "cylinder" / "cylinder.yaml"
MACHINE = ["--machine", str(CYLINDER)]
NARROW = {"valve.conductance": 1.5e-9, "scenario.cycle_time": 0.9}
WALK = str(ROOT / "bags" / "walk")


@pytest.fixture(scope="module")
def machine():
    return read_machine(CYLINDER)


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """Return the file of a plan for valves that pass a quarter of the air, at twice the cadence."""
    file = tmp_path_factory.mktemp("plan") / "planned.yaml"
    options = [f"--param={key}={value}" for key, value in NARROW.items()]
    assert main(["plan", *MACHINE, *options, "--out", str(file)]) == 0
    return file


def test_a_plan_is_told_in_the_machines_units(tmp_path, capsys):
    assert main(["plan", *MACHINE, "--out", str(tmp_path / "planned.yaml")]) == 0
    told = capsys.readouterr().out
    assert "planned motion       within 0.00 mm of the wanted one (RMS 0.00)" in told
    assert [line.split()[0] for line in told.splitlines()[1:]] == ["push", "pull", "mean"]


def test_the_loop_follows_a_plan_and_the_hardware_stays(planned, machine):
    narrow = load({**NARROW, "scenario.duration": 4.0}, machine)
    parameters = with_model(narrow, Namespace(model=planned, param=[]))
    of_plant = [
        {key: value for key, value in one.flat().items() if key.startswith("plant.")}
        for one in (parameters, narrow)
    ]
    assert of_plant[0] == of_plant[1]
    with_plan, without = (ClosedLoop(one, 1).run(800) for one in (parameters, narrow))
    away = [abs(run["reference_position"] - run["position"]).max() for run in (with_plan, without)]
    assert away[0] < 0.05, "the plan gives way by 25 mm"
    assert away[1] > 0.1, "without it the carriage is lost"


def test_a_plan_after_a_run_takes_that_of_its_machine_alone(machine, tmp_path, capsys):
    bag = tmp_path / "run"
    record_run(load({"scenario.duration": 0.1}, machine), "default", bag)
    for command, words in (
        ([*MACHINE, "--after", WALK], "is of another machine (knee, planned is cylinder)"),
        (["--after", str(bag)], "is of another machine (cylinder, planned is knee)"),
        (
            [*MACHINE, "--scenario", "person"],
            "--scenario person is for the knee; give the machine's motion by values in",
        ),
    ):
        assert main(["plan", *command, "--out", str(tmp_path / "planned.yaml")]) == 2
        error = capsys.readouterr().err
        assert words in error
        assert error.count("\n") == 1


def test_margins_are_those_of_the_machine_in_its_units(monkeypatch, capsys):
    """An error of 1 mm that grows by a tenth of a millimetre a millisecond of delay."""

    def error(parameters):
        assert parameters.declared.name == "cylinder"
        return 1e-3 + 1e-4 * margin.perturbations(parameters)["delay"].nominal

    def here(unit):
        overrides, name, direction, nominal, called, text = unit.arguments
        machine = units.machine_from(text, called, called)
        told = units.one(load(json.loads(overrides), machine), name, direction, float(nominal))
        return Answer(0, json.loads(json.dumps(told)), "", 0.0)

    monkeypatch.setattr(margin, "maximum_error", error)
    monkeypatch.setattr(units, "work", here)
    assert main(["margin", *MACHINE, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["max_abs_error_mm"] == pytest.approx(1.0)
    assert told["lost_mm"] == pytest.approx(50.0)
    assert {row["perturbation"] for row in told["margins"]} == {"delay", "supply"}
    assert "friction" in told["not_there"]
    assert main(["margin", *MACHINE]) == 0
    table = capsys.readouterr().out
    assert "cylinder is lost" in table
    assert "Maximum error on the hardware as it is: 1.00 mm." in table


def test_what_no_controller_can_move_is_refused_before_a_folder_is_begun(machine_files, tmp_path, capsys):
    """Its file gives no motion, and the knee's gait leads beyond its stops."""
    out = tmp_path / "better"
    assert main(["improve", "--machine", str(machine_files["elbow"]), "--out", str(out)]) == 2
    assert "scenario.gait goes to 0.897 rad" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize("device", ["leg", "device"])
@pytest.mark.parametrize("command", [["improve", "--out", "x"], ["margin"], ["plan", "--out", "x"]])
def test_what_takes_one_machine_refuses_a_device_in_a_line(device, command, capsys):
    assert main([*command, "--machine", device]) == 2
    told = capsys.readouterr().err.splitlines()
    assert f"{device} is a device of several machines, for `run`; give one of its machines" in told[-1]
    assert sum("error" in line for line in told) == 1
