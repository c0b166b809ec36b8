# SPDX-License-Identifier: Apache-2.0
"""The page of real data: its commands, from raw files to the answers that it states."""

import json
import shlex
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from pam_orthosis.cli.main import main
from pam_orthosis.discrepancy.recordings.data import recording
from pam_orthosis.discrepancy.recordings.stamps import remarks_on_stamps, skews
from pam_orthosis.discrepancy.systems.user_file import load_system

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs"))

import commands as shown  # noqa: E402

LINES = [one.line for one in shown.commands(ROOT / "docs" / "howto" / "real-data.md")]
PENDULUM = ROOT / "examples" / "real" / "pendulum"


@pytest.fixture
def found(tmp_path, monkeypatch, capsys):
    """Return a function: the commands of one system's paragraph -> exit status and gap.json."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")

    def run(system):
        end = next(i for i, line in enumerate(LINES) if f"examples/{system}.py" in line)
        for line in LINES[:end]:
            if line.startswith("awk"):
                subprocess.run(["sh", "-c", line], check=True)
        status = main([*shlex.split(LINES[end])[1:], "--json"])
        return status, json.loads(capsys.readouterr().out)

    return run


def test_the_chamber_leaks_through_wide_pores(found):
    status, answer = found("chamber")
    (leak,) = answer["effects"]
    assert leak["name"] == "porous_leak"
    viscous, inertial = (one["value"] for one in leak["parameters"].values())
    assert viscous == pytest.approx(75.0, abs=3.0)
    assert inertial == pytest.approx(150.0, abs=10.0)
    assert 0.90 < answer["closure"]["overall"] < 0.95
    assert (status, answer["verdict"] in ("unexplained", "partial")) == (1, True), "something is left"


def test_the_pendulum_stays_unexplained(found):
    status, answer = found("pendulum")
    assert (status, answer["verdict"] in ("none", "explained")) == (1, False)
    assert not any("stamped" in remark for remark in answer["remarks"]), "the system states the delay"
    assert 0.15 < answer["closure"]["overall"] < 0.5
    (friction,) = answer["surrogates"]
    assert friction["name"] == "dry_friction"
    assert friction["parameters"]["level"]["value"] == pytest.approx(0.146, abs=0.01)


@pytest.mark.parametrize(("name", "early"), [("ddp", 0.0160), ("dircol", 0.0170)])
def test_the_stamps_of_the_torque_are_found_to_be_early(name, early):
    stated = load_system(ROOT / "examples" / "pendulum.py")
    system = replace(stated, late=0.0)
    one = recording(PENDULUM / f"{name}.csv", system)
    (skew,) = skews(system, one)
    assert (skew.channel, skew.signals) == ("angle", ("torque",))
    assert skew.seconds == pytest.approx(-early, abs=0.0003)
    assert "torque stamped 1" in remarks_on_stamps(system, [one])[0]
    assert not skews(stated, one)
