# SPDX-License-Identifier: Apache-2.0
"""A share of the body's weight that the cushions cannot press is refused, with the largest that they can."""

import re
from pathlib import Path

import pytest

import pam_orthosis as po
from pam_orthosis.cli.main import main
from pam_orthosis.control.load import check_load
from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.machines import machine_named
from pam_orthosis.model.parameters import load

ROOT = Path(__file__).resolve().parents[2]
SHOE = machine_named(Path("shoe"))
ARM, AREA = 0.1, 6.0e-4  # of config/machines/shoe.yaml


def refused(**changes):
    with pytest.raises(OrthosisError) as error:
        check_load(load({key.replace("__", "."): value for key, value in changes.items()}, SHOE))
    return str(error.value)


def peak(parameters):
    """Return the largest force that a stride asks of a cushion, N."""
    trajectory, settings = make_trajectory(parameters), parameters.scenario
    start, stiffness = settings.start_hold + settings.start_ramp, parameters.machine.mechanism.stiffness
    asked = [trajectory.sample(round((start + settings.cycle_time * n / 100) * 1e9)) for n in range(100)]
    gauge = [one.mean_pressure - parameters.valve.ambient_pressure for one in asked]
    return max(
        AREA * p + sign * 0.5 * stiffness * one.position / ARM
        for p, one in zip(gauge, asked, strict=True)
        for sign in (-1, 1)
    )


def test_the_largest_share_is_the_one_that_asks_for_the_highest_pressure():
    told = refused(machine__mechanism__share=0.5)
    largest = float(re.search(r"a share of ([\d.]+) at most", told)[1])
    assert 0.3 < largest < 0.5
    fits = load({"machine.mechanism.share": largest}, SHOE)
    check_load(fits)
    limit = AREA * (fits.control.position.maximum_pressure - fits.valve.ambient_pressure)
    assert f"allows {limit:.0f} N" in told
    assert peak(fits) == pytest.approx(limit, rel=0.01)
    refused(machine__mechanism__share=largest + 0.001)


def test_the_share_is_of_the_bodys_weight():
    light, heavy = (
        float(
            re.search(
                r"a share of ([\d.]+)",
                refused(machine__mechanism__share=1.5, machine__mechanism__body_mass=m),
            )[1]
        )
        for m in (40.0, 80.0)
    )
    assert light == pytest.approx(2 * heavy, abs=0.003)


def test_a_lower_limit_allows_less():
    assert "at most" in refused(control__position__maximum_pressure=4.0e5)


@pytest.mark.parametrize("name", ["knee", "ankle", "examples/cylinder/cylinder.yaml"])
def test_other_machines_have_no_load(monkeypatch, name):
    monkeypatch.chdir(ROOT)
    check_load(load({"control.position.maximum_pressure": 4.0e5}, machine_named(Path(name))))


@pytest.mark.parametrize(
    "given", [("shoe", "machine.mechanism.share"), ("device", "shoe/machine.mechanism.share")]
)
def test_it_is_refused_in_one_line_before_the_run(tmp_path, capsys, given):
    pytest.importorskip("rclpy")
    name, key = given
    assert main(["run", "--machine", name, "--param", f"{key}=0.5", "--out", str(tmp_path / "bag")]) == 2
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 1
    assert "give a share of 0.3" in told[0]
    assert not (tmp_path / "bag").exists()


def test_the_library_refuses_it_too():
    with pytest.raises(OrthosisError, match="give a share of"):
        po.simulate(load({"machine.mechanism.share": 0.5, "scenario.duration": 0.1}, SHOE))
