# SPDX-License-Identifier: Apache-2.0
"""A bag holds the file of its machine: whoever reads it has names, units and parameters from there."""

import json

import numpy as np
import pytest

from pam_orthosis.bag.arrays import write_arrays
from pam_orthosis.bag.read import read_bag, recorded_machine, recorded_parameters, run_record
from pam_orthosis.bag.record import BagWriter, run_metadata
from pam_orthosis.bag.verdict import Bound, judge
from pam_orthosis.cli.main import main
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.machines import KNEE, read_machine
from pam_orthosis.model.parameters import load

COUNT, PERIOD_NS = 400, 5_000_000
STAMPS = np.arange(COUNT) * PERIOD_NS
OFF = 2.5e-3  # m, that the load is beside its reference


@pytest.fixture
def slide(machine_files):
    return read_machine(machine_files["slide"])


@pytest.fixture
def bag(tmp_path, slide):
    """A load that follows a sine at a distance, for 2 s."""
    parameters = load({"machine.mechanism.inertia": 7.0, "scenario.duration": 2.0}, slide)
    wanted = 0.15 + 0.05 * np.sin(2 * np.pi * STAMPS * 1e-9)
    signals = {"position": wanted - OFF, "reference_position": wanted}
    signals["reference_velocity"] = 0.1 * np.pi * np.cos(2 * np.pi * STAMPS * 1e-9)
    signals["reference_acceleration"] = np.zeros(COUNT)
    signals |= {"push_voltage": np.full(COUNT, 5.0), "push_pressure": np.full(COUNT, 3e5)}
    write_arrays(tmp_path / "bag", STAMPS, signals, run_metadata(parameters, "default"))
    return tmp_path / "bag"


def test_the_machine_comes_back_from_the_bag_alone(bag, slide):
    assert recorded_machine(bag) == slide
    read = read_bag(bag, ["position", "push_pressure"])
    assert read.machine == slide
    assert read["push_pressure"].value[-1] == 3e5
    assert read.parameters["machine.mechanism.inertia"] == 7.0


def test_a_bag_that_names_no_machine_is_the_knees(tmp_path):
    write_arrays(tmp_path / "old", STAMPS, {"angle": np.zeros(COUNT)}, {})
    assert recorded_machine(tmp_path / "old") is KNEE
    assert "machine" not in run_metadata(load(), "default")
    assert read_bag(tmp_path / "old", ["angle"]).machine is KNEE


def test_a_signal_of_another_machine_is_refused_by_name(bag):
    with pytest.raises(OrthosisError, match="is of a slide, which has no angle"):
        read_bag(bag, ["angle"])


def test_positions_are_judged_in_millimetres(bag, capsys):
    verdict = judge(bag, Bound(2.6, "mm"))
    assert verdict.max_abs_error == pytest.approx(2.5)
    assert verdict.passed
    assert not judge(bag, Bound(2.4)).passed
    assert main(["check", str(bag), "--json", "--bound-mm", "2.4"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert told["max_abs_error_mm"] == pytest.approx(2.5)
    assert told["bound_mm"] == 2.4
    assert told["voltage_variation_per_s"] == {"push": 0.0}
    assert not [key for key in told if key.endswith("_deg")]
    assert main(["check", str(bag)]) == 0
    assert "maximum 2.500 mm, bound 3 mm" in capsys.readouterr().out


def test_bags_of_several_machines_are_judged_in_one_go(bag, tmp_path):
    names = ("angle", "reference_angle", "reference_velocity")
    write_arrays(tmp_path / "knee", STAMPS, dict.fromkeys(names, np.zeros(COUNT)), {})
    bags = [str(bag), str(tmp_path / "knee")]
    assert main(["batch", "check", *bags, "--out", str(tmp_path / "out"), "--workers", "1"]) == 0


@pytest.mark.parametrize(("machine", "unit"), [("slide", "deg"), ("knee", "mm")])
def test_a_bound_in_the_other_unit_is_refused(bag, tmp_path, capsys, machine, unit):
    if machine == "knee":
        names = ("angle", "reference_angle", "reference_velocity")
        write_arrays(tmp_path / "knee", STAMPS, dict.fromkeys(names, np.zeros(COUNT)), {})
        bag = tmp_path / "knee"
    assert main(["check", str(bag), f"--bound-{unit}", "3"]) == 2
    assert f"errors of the {machine} are in" in capsys.readouterr().err


def test_parameters_are_checked_against_the_rows_of_the_machine(bag, tmp_path):
    run = run_record(bag)
    assert recorded_parameters(bag, run)["machine.mechanism.inertia"] == 7.0
    wrong = json.dumps({"machine.mechanism.inertia": -1.0})
    with pytest.raises(OrthosisError, match=r"machine\.mechanism\.inertia = -1"):
        recorded_parameters(bag, run | {"parameters": wrong})


@pytest.mark.parametrize("text", ["a: [", "meaning: 3", "x", "&a [*a]", "mechanism: {kind: knee}\nwhat: 1"])
def test_a_machine_that_is_none_is_refused_in_one_line(tmp_path, capsys, text):
    with BagWriter(tmp_path / "bag", {"machine": text, "machine_name": "m"}):
        pass
    assert main(["check", str(tmp_path / "bag")]) == 2
    told = capsys.readouterr().err
    assert "the machine in its run metadata" in told
    assert len(told.splitlines()) == 1


def test_a_table_of_the_bag_has_the_machines_signals(bag, tmp_path):
    assert main(["report", str(bag), "--only", "table", "--out", str(tmp_path / "out")]) == 0
    head = (tmp_path / "out" / "bag.csv").read_text().splitlines()[0].split(",")
    assert head[:3] == ["time", "position", "reference_position"]
    assert head[-2:] == ["push_pressure", "push_voltage"]
