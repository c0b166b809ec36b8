# SPDX-License-Identifier: Apache-2.0
"""No verdict is wrong in kind: what is not explained is not called so, and nothing assumed goes unsaid."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import foreign_joint
import numpy as np
import pytest

from pam_orthosis.bag.arrays import write_arrays
from pam_orthosis.bag.record import run_metadata
from pam_orthosis.cli.main import main
from pam_orthosis.discrepancy import beginning, judgement, workflow
from pam_orthosis.discrepancy.apparatus import without_record
from pam_orthosis.discrepancy.measure import Gap, over_noise
from pam_orthosis.discrepancy.verdict import as_dict, assumed_words, describe
from pam_orthosis.model.machines import KNEE, RIG
from pam_orthosis.model.parameters import load

FRICTION = {"plant__effects__joint_friction__enabled": True, "plant__effects__joint_friction__coulomb": 0.6}


@pytest.fixture(scope="module")
def friction(bench):
    training = [bench.recording(1, **FRICTION), bench.recording(2, cycle_time=1.4, **FRICTION)]
    held_out = [bench.recording(3, cycle_time=1.7, **FRICTION)]
    settings = bench.parameters.gap
    start = beginning.begin(bench.system, training, held_out, settings, replay=bench.replay)
    return start, workflow.search(start, settings), settings


def test_another_joint_read_as_the_default_knee_is_not_explained(tmp_path, capsys):
    """Corrections at their bounds close nine tenths of a gap of 170 times the noise; 17 times are left."""
    files = [foreign_joint.write(tmp_path / f"{seed}.csv", seed) for seed in (1, 2, 3)]
    out = tmp_path / "out"
    status = main(["gap", *files[:2], "--held-out", files[2], "--out", str(out)])
    said, told = capsys.readouterr().out.splitlines(), json.loads((out / "gap.json").read_text())
    assert (status, told["verdict"]) == (1, "unexplained")
    assert told["closure"]["overall"] > 0.9
    assert max(place["over_noise"] for place in told["left"]) > 3
    assert said[-1].startswith("UNEXPLAINED: ")
    assert said[0].startswith(f"the apparatus is assumed: {files[0]} and 2 more")
    assert said[0].endswith("read as the default knee")
    assert told["apparatus_assumed"] == files


@pytest.mark.parametrize(
    ("closed", "kept", "empty", "verdict"),
    [
        (0.999, 2.9, (), "explained"),
        (0.999, 3.1, (), "unexplained"),
        (0.999, 1.0, ("stretch_reflex.threshold",), "unexplained"),
        (0.49, 1.0, (), "unexplained"),
        (None, 1.0, (), "explained"),
    ],
)
@pytest.mark.parametrize("clean", [True, False])
def test_explained_needs_little_left_and_effects_that_mean_something(closed, kept, empty, verdict, clean):
    final = SimpleNamespace(effects=("stretch_reflex",))
    told = judgement._verdict(final, clean, {"overall": closed}, kept, empty)
    assert told == (verdict if clean or closed is not None else "unexplained")


def test_what_is_left_has_one_measure(friction):
    """The root mean square over the noise, in the table, the file and the verdict alike."""
    _, outcome, _ = friction
    angle = outcome.after.white["angle"] / outcome.floor.white["angle"]
    left = {one["equation"]: one["over_noise"] for one in as_dict(outcome)["left"]}
    assert left["torque"] == pytest.approx(angle, rel=1e-5)
    assert left == pytest.approx(over_noise(outcome.system, outcome.after, outcome.floor), rel=1e-5)
    loud = Gap(outcome.after.units, {**outcome.after.white, "flexor_pressure": 4.0})
    assert over_noise(outcome.system, loud, outcome.floor)["gas"] > 3.5
    place = replace(outcome.left[0], equation="torque", density=900.0)
    told = describe(replace(outcome, verdict="unexplained", left=[place]))
    assert "times the noise is left, with joint friction added" in told.splitlines()[-1]
    assert "900" not in told


def test_a_model_that_closes_less_than_half_names_nothing(friction, monkeypatch):
    """However far the next effect is behind."""
    start, outcome, settings = friction
    found = outcome.selection
    alone = replace(found, steps=[replace(step, ranked=(("joint_friction", 1e4),)) for step in found.steps])
    for share, names in ((0.2, []), (0.6, ["joint_friction"])):
        closed = {**outcome.closure, "overall": share}
        monkeypatch.setattr(judgement, "_closures", lambda *_, closed=closed: closed)
        told = judgement.outcome_of(start, alone, settings)
        assert [one.name for one in told.effects] == names
        assert [one.name for one in told.surrogates] == ([] if names else ["joint_friction"])
    told = describe(replace(outcome, verdict="unexplained", effects=(), surrogates=outcome.effects))
    assert told.splitlines()[-1].endswith("no model of the catalogue explains half of the gap")


def test_an_effect_at_a_bound_that_empties_it_is_no_explanation(friction):
    start, outcome, settings = friction
    final = outcome.selection.final
    wide = replace(final, values={**final.values, "joint_friction.transition_velocity": 0.76})
    told = judgement.outcome_of(start, replace(outcome.selection, final=wide), settings)
    assert told.empty == ("joint_friction.transition_velocity",)
    assert told.verdict == "unexplained"
    assert as_dict(told)["empty_of_meaning"] == ["joint_friction.transition_velocity"]
    assert "not what the name says: joint_friction.transition_velocity = 0.76" in describe(told)
    assert outcome.empty == ()
    assert outcome.verdict == "explained"


@pytest.mark.parametrize(
    ("effect", "parameter", "empty", "meant"),
    [
        ("stretch_reflex", "threshold", (0.0, 8.0), (0.05, 1.0)),
        ("stretch_reflex", "lag", (0.3,), (0.005, 0.1)),
        ("joint_friction", "transition_velocity", (0.76, 1.0), (0.001, 0.1)),
        ("joint_friction", "bristles", (), (0.0, 0.5, 1.0)),
        ("muscle_hysteresis", "sliding_distance", (0.02,), (5e-5, 1e-3)),
        ("creep", "time_constant", (0.05, 30.0), (0.1, 10.0)),
        ("valve_delay", "delay", (0.05, -0.05), (-8e-3, 1e-3, 8e-3)),
        ("valve_lag", "natural_frequency", (5.0, 1000.0), (12.0, 200.0)),
        ("volume_misfit", "extensor_c0", (-0.3, 0.3), (0.0, 0.15)),
        ("valve_curve_misfit", "flexor_vent_1", (0.5,), (0.25,)),
        ("valve_curve_misfit", "flexor_vent_5", (), (-0.5, 0.5)),
    ],
)
def test_bounds_that_empty_an_effect_are_told_from_those_that_do_not(effect, parameter, empty, meant):
    q = next(q for q in KNEE.catalogue[effect].parameters if q.name == parameter)
    assert all(q.is_empty(value) for value in empty)
    assert not any(q.is_empty(value) for value in meant)


def test_every_effect_means_something_at_its_typical_values():
    for effect in (*KNEE.catalogue.values(), *RIG.catalogue.values()):
        for q in effect.parameters:
            assert not q.is_empty(q.typical), f"{effect.name}.{q.name}"
            if q.meaningful:
                assert q.minimum <= q.meaningful[0] < q.meaningful[1] <= q.maximum
        assert effect.fitted[0].meaningful is None or effect.shape  # a size at a bound is never meant


def test_an_apparatus_that_nothing_tells_is_said_to_be_assumed(tmp_path):
    stamps, signals = np.array([0, 2_000_000]), {"angle": np.zeros(2)}
    write_arrays(tmp_path / "ours", stamps, signals, run_metadata(load().belief(), "test"))
    write_arrays(tmp_path / "foreign", stamps, signals, {})
    table, ours, foreign = tmp_path / "x.csv", tmp_path / "ours", tmp_path / "foreign"
    assert without_record([table, ours, foreign]) == [table, foreign]
    assert assumed_words([], 1, None) == ""
    assert "read as the apparatus of the other recordings" in assumed_words([table], 2, None)
    model = Path("mine.yaml")
    assert "read as the default knee with what mine.yaml changes" in assumed_words([table], 1, model)
