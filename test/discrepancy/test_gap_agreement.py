# SPDX-License-Identifier: Apache-2.0
"""Recordings that contradict each other, and stamps that only seem off."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import motor_bench
import pytest

from pam_orthosis.discrepancy import workflow
from pam_orthosis.discrepancy.answer.agreement import remarks_on_contradiction
from pam_orthosis.discrepancy.answer.clocks_doubted import without_doubtful_stamps
from pam_orthosis.discrepancy.preparation.beginning import begin
from pam_orthosis.discrepancy.recordings.data import from_csv
from pam_orthosis.discrepancy.recordings.stamps import Skew
from pam_orthosis.discrepancy.systems.user_file import load_system
from pam_orthosis.model.parameters import load

SYSTEM = Path(__file__).parents[2] / "examples" / "motor_carriage.py"
FRICTION = 3.0  # N
SETTINGS = load().gap


@dataclass(frozen=True)
class Left:
    """What matters of an outcome that names nothing."""

    selection: object
    held_out: object
    remarks: Sequence[str] = ("noisy", "stamped")
    verdict: str = "unexplained"
    skewed: bool = False
    effects: tuple = ()
    unknown: None = None


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    """Return a function: frictions of recordings to fit, and of one that judges -> what a search begins with.

    `late`, s: by which currents act after their stamps.
    """
    folder, system = tmp_path_factory.mktemp("carriage"), load_system(SYSTEM)

    def beginning(frictions, judged, late=0.0):
        every = []
        for seed, friction in enumerate((*frictions, judged)):
            path = motor_bench.write(folder / f"{seed}.csv", seed, friction, late=late)
            every.append(replace(from_csv(Path(path), system), name=f"number {seed}"))
        return begin(system, every[:-1], every[-1:], SETTINGS)

    return beginning


@pytest.mark.parametrize(
    ("frictions", "judged", "said"),
    [
        ((0.0, FRICTION), 0.0, r"number 1 stands apart: recalibrated without it"),
        ((0.0, FRICTION), FRICTION, r"number 0 stands apart: recalibrated to it alone"),
        ((FRICTION, FRICTION), FRICTION, ""),
        ((0.0, 0.0), 0.0, ""),
    ],
)
def test_a_recording_that_stands_apart_is_named(begun, frictions, judged, said):
    told = [one for one in remarks_on_contradiction(begun(frictions, judged)) if "stands apart" in one]
    assert [one.startswith(said) for one in told] == [True] * bool(said)


def test_recalibration_that_makes_what_judges_worse_is_said(begun):
    start = begun((0.0, 0.0), 0.0)
    assert not remarks_on_contradiction(start)
    free = start.null.free[0]
    far = {**start.null.values, free.name: start.null.values[free.name] + 10 * free.scale}
    (told,) = remarks_on_contradiction(replace(start, null=replace(start.null, values=far)))[-1:]
    assert told.startswith("recalibration makes held-out recordings worse")


@pytest.mark.parametrize(("late", "seems", "kept"), [(0.016, -0.016, True), (0.0, 0.016, False)])
def test_stamps_are_off_only_if_recordings_that_are_moved_fit_better(begun, late, seems, kept):
    start = begun((0.0, 0.0), 0.0, late=late)
    skews = [(one, [Skew("position", ("current",), seems, 0.2)]) for one, _ in start.skews]
    start = replace(start, stamps=("stamped",), skews=skews)
    found = SimpleNamespace(problem=start.problem, null=start.null)
    outcome = Left(found, start.held_out)
    told = without_doubtful_stamps(start, outcome, SETTINGS.replay.cross_cutoff)
    assert list(told.remarks) == ["noisy", "stamped"][: 1 + kept]


@pytest.mark.parametrize(
    ("verdict", "mistaken", "told"),
    [
        ("unexplained", False, ("a", "b", "c")),
        ("described", False, ("a", "b")),  # what is left is told
        ("none", False, ("noisy", "stamped")),
        ("partial", True, ("noisy", "stamped")),
    ],
)
def test_what_is_left_is_asked_of_the_recordings(monkeypatch, verdict, mistaken, told):
    monkeypatch.setattr(workflow, "_searched", lambda *_: Left(None, None, verdict=verdict))
    monkeypatch.setattr(workflow, "without_doubtful_stamps", lambda _, one, __: replace(one, remarks=("a",)))
    monkeypatch.setattr(workflow, "remarks_on_contradiction", lambda _: ["b"])
    monkeypatch.setattr(workflow, "unstated_noise", lambda *_: ["c"])
    outcome = workflow.search(SimpleNamespace(mistaken=mistaken), SETTINGS)
    assert outcome.remarks == told
