# SPDX-License-Identifier: Apache-2.0
"""`identify --machine`: which muscles there are follows from the machine, and so do its values."""

import csv
import json

import numpy as np
import pytest

from pam_orthosis.cli.main import main
from pam_orthosis.model.components.muscle import towing_force
from pam_orthosis.model.parameters import load

AMBIENT = 9.0e4
GRIPPER = f"""
meaning: a gripper that a long muscle closes
mechanism: {{kind: translation, inertia: 2.0, stiffness: 900.0, minimum: 0.0, maximum: 0.1, start: 0.01}}
actuators:
  closer: {{kind: muscle, parameters: muscle.mas_40, transmission: {{arm: 1.0}}}}
sensor: {{noise: 1.0e-5}}
values: {{valve.ambient_pressure: {AMBIENT}}}
"""


@pytest.fixture
def table(tmp_path):
    """Return a table of a muscle, by its rows in config/, whose pressures count from vacuum."""

    def of(name):
        m, path = getattr(load().muscle, name), tmp_path / "measured.csv"
        with open(path, "w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream)
            writer.writerow(["p_Pa_abs", "dL_m", "F_N"])
            for pressure in np.linspace(1e5, 6e5, 6):
                for contraction in np.linspace(0.0, 0.2 * m.map_length, 12):
                    force = float(towing_force(contraction * m.length / m.map_length, pressure, m))
                    if force > 0:
                        writer.writerow([repr(float(v)) for v in (pressure + AMBIENT, contraction, force)])
        return path

    return of


def test_a_machines_only_muscle_needs_no_name_and_its_values_count(tmp_path, table, capsys):
    machine = tmp_path / "gripper.yaml"
    machine.write_text(GRIPPER, encoding="utf-8")
    m, out = load().muscle.mas_40, tmp_path / "rows.yaml"
    command = ["identify", str(table("mas_40")), "--machine", str(machine), "--held-out-bar", "--json"]
    assert main([*command, "--nominal-length-m", str(m.map_length), "--out", str(out)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["muscle"] == "mas_40"
    assert found["training"]["max"] < 1.0, "the ambient pressure is that of the machine's file"
    assert "mas_40" in out.read_text()


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("slide", [], "slide.yaml: slide has no muscle: there is nothing to identify"),
        ("elbow", ["--muscle", "dmsp_10"], "no muscle dmsp_10 here; there are: dmsp_20"),
    ],
)
def test_what_the_machine_does_not_have_is_refused_in_one_line(
    machine_files, table, capsys, name, options, words
):
    command = ["identify", str(table("dmsp_20")), "--machine", str(machine_files[name]), *options]
    assert main(command) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert words in error


def test_a_name_that_the_test_rig_does_not_know_is_refused_with_those_it_knows(table, capsys):
    assert main(["identify", str(table("dmsp_20")), "--muscle", "biceps"]) == 2
    assert "no muscle biceps here; there are: dmsp_20, dmsp_10" in capsys.readouterr().err
