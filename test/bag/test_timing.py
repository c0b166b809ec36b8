# SPDX-License-Identifier: Apache-2.0
"""Latency and missed deadlines from stamps."""

from pathlib import Path

import numpy as np
import pytest

from bags import joint_state, write
from pam_orthosis.bag.record import BagWriter
from pam_orthosis.bag.topics import PLANT, TRAJECTORY, Topics, resolve
from pam_orthosis.bag.tracking import judge_timing, timing
from pam_orthosis.cli import check
from pam_orthosis.model.machines import KNEE

TABLE = Topics(KNEE)

ROOT = Path(__file__).resolve().parents[2]
MS = 1_000_000


def test_late_and_absent_answers_are_missed_deadlines():
    samples = 5 * MS * np.arange(10)
    answered = {stamp: stamp + 2 * MS for stamp in samples.tolist()}
    answered[20 * MS] = 26 * MS
    del answered[25 * MS]
    result = judge_timing(samples, answered, 5 * MS)
    assert (result.periods, result.deadline_ms, result.missed_deadlines) == (10, 5.0, 2)
    assert (result.latency_median_ms, result.latency_max_ms) == (2.0, 6.0)
    assert result.skipped_samples == 0


def test_a_skipped_sample_is_a_missed_deadline():
    samples = 5 * MS * np.array([0, 1, 2, 6, 7])
    result = judge_timing(samples, {stamp: stamp + MS for stamp in samples.tolist()}, 5 * MS)
    assert (result.periods, result.skipped_samples, result.missed_deadlines) == (8, 3, 3)


def test_a_run_in_lockstep_has_no_timing():
    assert timing(ROOT / "bags" / "walk") is None


def test_a_run_in_real_time_without_an_answer_misses_every_deadline(tmp_path):
    """The answers to its samples were never recorded, but the topic tells what kind of run it is."""
    with BagWriter(tmp_path / "walk", {}) as writer:
        for name in ("joint_states", "answered"):
            writer.add_topic(resolve(name), TABLE.by_name[name].type)
        for stamp in range(0, 50 * MS, 5 * MS):
            write(writer, "joint_states", stamp, joint_state(stamp, "knee", [0.0]))
    result = timing(tmp_path / "walk")
    assert (result.periods, result.missed_deadlines, result.latency_max_ms) == (10, 10, None)
    assert check._timing(result)[0].endswith("no answer recorded")


@pytest.mark.parametrize("with_plant", [True, False])
def test_in_real_time_samples_drive_the_trajectory_and_answers_are_told(with_plant):
    topics = TABLE.of_run(realtime=True, with_plant=with_plant)
    assert "/clock" not in topics
    assert TRAJECTORY in topics["joint_states"].consumers
    assert ("truth" in topics) == with_plant
    assert topics["joint_states"].producers == (PLANT,)
    assert (PLANT in topics["/diagnostics"].producers) == with_plant
    assert "answered" in topics
    assert "answered" not in TABLE.of_run()
