# SPDX-License-Identifier: Apache-2.0
"""Who may know what of a run; who may import what is a contract in pyproject.toml."""

import pytest

from pam_orthosis.bag.topics import PLANT, PUBLISHED_DEPTH, RECORDER, SAFETY, Topics
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load
from pam_orthosis.nodes import launch
from pam_orthosis.nodes.layout import layout

TABLE = Topics(KNEE)


def test_only_the_recorder_listens_to_the_truth():
    truth = next(topic for topic in TABLE.all if topic.name == "truth")
    assert truth.subscribers == (RECORDER,)


def test_controllers_get_no_parameter_of_the_plant(tmp_path):
    changed = load({"plant.external_torque": 1.0, "control.position.c1": 20.0})
    launch.commands(tmp_path, changed, tmp_path / "bag", "default", launch.Mode())
    for name in TABLE.nodes:
        text = (tmp_path / f"{name}.yaml").read_text()
        assert "control.position.c1" in text
        assert ("plant." in text) == (name in (PLANT, RECORDER))
        assert ("plant" in layout(TABLE)[name].branches) == (name in (PLANT, RECORDER))


def test_every_topic_is_made_and_used_by_nodes_of_the_table():
    for topic in TABLE.all:
        assert set(topic.producers) | set(topic.subscribers) <= {*TABLE.nodes, SAFETY}
        assert topic.meaning
        assert topic.unit


def test_no_writer_forgets_what_the_recorder_may_still_lack():
    pace = pytest.importorskip("pam_orthosis.nodes.pace")
    assert pace.MAX_UNRECORDED_STEPS < PUBLISHED_DEPTH
