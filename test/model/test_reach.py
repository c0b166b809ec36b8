# SPDX-License-Identifier: Apache-2.0
"""A machine whose muscle cannot be as short or as long as its transmission says is refused."""

import pytest

from pam_orthosis.cli.main import main
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.machines import KNEE, RIG, machine_named
from pam_orthosis.model.parameters import load
from pam_orthosis.model.reach import check_lengths

ELBOW = """
meaning: an elbow
mechanism: {{kind: rotation, inertia: 0.12, weight: 3.7, minimum: -0.1, maximum: 1.2, start: 0.5}}
actuators:
  flex: {{kind: muscle, parameters: muscle.dmsp_20, transmission: {{arm: 0.03, contraction: 0.01}}}}
  ext: {{kind: muscle, parameters: muscle.dmsp_20, transmission: {{arm: -0.03, contraction: {0}}}}}
sensor: {{noise: 2.0e-5, resolution: 1.0e-4}}
"""


def elbow(folder, contraction):
    file = folder / "elbow.yaml"
    file.write_text(ELBOW.format(contraction), encoding="utf-8")
    return file


@pytest.mark.parametrize("contraction", [0.4, -0.2])
def test_a_muscle_out_of_reach_is_refused(tmp_path, contraction):
    machine = machine_named(elbow(tmp_path, contraction))
    with pytest.raises(OrthosisError, match=r"actuator ext: .* but the muscle is 0\.5 m long"):
        check_lengths(machine, load(machine=machine))


def test_a_run_and_a_search_of_such_a_machine_begin_nothing(tmp_path, capsys):
    file = str(elbow(tmp_path, 0.4))
    table = tmp_path / "run.csv"
    table.write_text("time,angle,flex_pressure,ext_pressure,flex_voltage,ext_voltage\n0,0,2e5,2e5,5,5\n")
    assert main(["gap", str(table), "--machine", file]) == 2
    assert "0.364 to 0.403 m in its range" in capsys.readouterr().err
    assert main(["run", "--machine", file, "--composed", "--out", str(tmp_path / "out")]) == 2
    assert "0.364 to 0.403 m in its range" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_what_can_be_is_accepted(tmp_path):
    for machine in (KNEE, RIG, machine_named(elbow(tmp_path, 0.04))):
        check_lengths(machine, load(machine=machine))
