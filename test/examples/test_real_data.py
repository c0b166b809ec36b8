# SPDX-License-Identifier: Apache-2.0
"""The page of real data: its commands, from raw files to the answers that it states."""

import json
import re
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
CHAMBER_SAYS, PENDULUM_SAYS = (
    " ".join(part.split())
    for part in (ROOT / "docs" / "howto" / "real-data.md").read_text(encoding="utf-8").split("\n## ")[1:3]
)
PENDULUM = ROOT / "examples" / "real" / "pendulum"


def stated(words, pattern):
    """Return the numbers that a paragraph states."""
    return tuple(map(float, re.search(pattern, words).groups()))


def times_noise(answer, which):
    """Return a number of the last row of the printed table."""
    return answer[which]["overall"]["value"]


@pytest.fixture
def found(tmp_path, monkeypatch, capsys):
    """Return a function: the commands of one system's paragraph -> exit status and gap.json."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")

    def run(system, **changes):
        end = next(i for i, line in enumerate(LINES) if f"examples/{system}.py" in line)
        for line in LINES[:end]:
            if line.startswith("awk"):
                subprocess.run(["sh", "-c", line], check=True)
        line = LINES[end]
        for name, value in changes.items():
            text = (ROOT / "examples" / f"{system}.py").read_text(encoding="utf-8")
            changed = re.sub(rf"^{name} = [\d.]+", f"{name} = {value}", text, flags=re.M)
            Path("changed.py").write_text(changed, encoding="utf-8")
            line = line.replace(f"examples/{system}.py", "changed.py")
        status = main([*shlex.split(line)[1:], "--json"])
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
    assert (status, answer["verdict"]) == (1, "partial"), "something is left"
    assert "`partial`" in CHAMBER_SAYS
    (removed,) = stated(CHAMBER_SAYS, r"removes (\d+) %")
    assert removed == pytest.approx(100 * answer["closure"]["overall"], abs=0.6)
    (left,) = answer["left"]
    numbers = left["over_noise"], times_noise(answer, "gap_after"), times_noise(answer, "noise_floor")
    told = stated(CHAMBER_SAYS, r"([\d.]+) times the noise is left \(([\d.]+) over ([\d.]+) in the table")
    assert told == pytest.approx(numbers, rel=0.02)


def test_the_pendulum_stays_unexplained(found):
    status, answer = found("pendulum")
    assert (status, answer["verdict"] in ("none", "explained")) == (1, False)
    assert not any("stamped" in remark for remark in answer["remarks"]), "the system states the delay"
    assert 0.15 < answer["closure"]["overall"] < 0.5
    (friction,) = answer["surrogates"]
    assert friction["name"] == "dry_friction"
    level = friction["parameters"]["level"]
    told = stated(PENDULUM_SAYS, r"dry friction of ([\d.]+) N m \(([\d.]+) to ([\d.]+)\)")
    assert told == pytest.approx((level["value"], *level["interval"]), abs=0.006)
    told = stated(PENDULUM_SAYS, r"removes (\d+) % .*: ([\d.]+) times the noise are left of ([\d.]+)\.")
    gaps = times_noise(answer, "gap_after"), times_noise(answer, "gap_before")
    assert told == pytest.approx((100 * answer["closure"]["overall"], *gaps), rel=0.02)
    (left,) = answer["left"]
    assert stated(PENDULUM_SAYS, r"([\d.]+) times the encoder's noise") == pytest.approx(
        (left["over_noise"],), rel=0.02
    )


def test_the_stated_delay_does_not_lessen_what_the_pendulum_leaves(found):
    _, answer = found("pendulum", LATE=0)
    assert (answer["effects"], answer["surrogates"]) == ([], [])
    told = stated(PENDULUM_SAYS, r"`LATE = 0` and without friction ([\d.]+) is left")
    assert told == pytest.approx((times_noise(answer, "gap_after"),), rel=0.02)
    assert sorted(answer["out_of_tolerance"]) == ["inertia", "weight"]
    assert min(answer["out_of_tolerance"].values()) > 4
    assert ["stamped" in remark for remark in answer["remarks"]][-2:] == [True, True]
    early = [float(re.search(r"stamped ([\d.]+) ms early", one)[1]) for one in answer["remarks"][-2:]]
    assert stated(PENDULUM_SAYS, r"stamped (\d+) and (\d+) ms early") == pytest.approx(early, abs=0.5)


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
