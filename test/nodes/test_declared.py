# SPDX-License-Identifier: Apache-2.0
"""What a node declares: its own rows, as many as it reads, and those of the apparatus that it is given."""

import inspect
from contextlib import contextmanager

import pytest
from own_domain import own_domain

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load
from pam_orthosis.model.rows import Section

rclpy = pytest.importorskip("rclpy")

OF_THE_APPARATUS = ("muscle.", "valve.", "leg.", "machine.")
SWITCHED_ON = ("effects.", "plant.effects.", "plant.person.")
CHECKED = tuple(f"{KNEE.sensor}_{end}" for end in ("noise", "resolution"))  # to be there, for every node
MADE = (
    "position_controller",
    "extensor_pressure_controller",
    "inverse_valve_model",
    "plant_simulator",
    "bag_recorder",
)


@contextmanager
def reads():
    """Collect the dotted keys of all parameters that are read inside."""
    keys, plain = set(), Section.__getattribute__

    def noting(section, name):
        found = plain(section, name)
        if not name.startswith("_") and not isinstance(found, Section) and not inspect.ismethod(found):
            keys.add(f"{plain(section, '_path')}.{name}")
        return found

    Section.__getattribute__ = noting
    try:
        yield keys
    finally:
        Section.__getattribute__ = plain


@pytest.fixture
def make(tmp_path, monkeypatch):
    """Return a function: name of a node, parameters -> the node."""
    from pam_orthosis.nodes import composed

    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    nodes = []

    def make(name, **given):
        given |= {"muscle": "extensor"} if name == "extensor_pressure_controller" else {}
        given |= {"directory": tmp_path / "bag"} if name == "bag_recorder" else {}
        words = [word for key, value in given.items() for word in ("-p", f"{key}:={value}")]
        rclpy.init(args=["--ros-args", *words], domain_id=own_domain())
        nodes.extend(composed.make([name]))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()
    rclpy.try_shutdown()


def test_the_safety_monitor_declares_all_that_it_reads(make):
    with reads() as keys:
        node = make("safety_monitor", **{"control.limits.enabled": "true"})
    read = {row.key for row in load().rows() if row.key.startswith(("control.limits.", "scenario."))} & keys
    assert "control.limits.pressure" in read
    assert {key for key in read if not node.has_parameter(key)} == set()


@pytest.mark.parametrize(
    ("name", "trajectory"),
    [
        *[("trajectory_publisher", motion) for motion in load().row("scenario.trajectory").options],
        *[(name, "gait") for name in MADE],
    ],
)
def test_a_node_declares_all_that_it_reads_beside_the_apparatus(make, name, trajectory):
    with reads() as keys:
        node = make(name, **({"scenario.trajectory": trajectory} if trajectory != "gait" else {}))
    read = {row.key for row in load().rows()} & keys
    own = {key for key in read if not key.startswith(OF_THE_APPARATUS + SWITCHED_ON) and key not in CHECKED}
    assert own
    assert {key for key in own if not node.has_parameter(key)} == set()


def test_a_node_declares_a_row_of_the_apparatus_that_it_is_given(make):
    node = make("position_controller", **{"leg.shank.mass": 4.5})
    assert node.get_parameter("leg.shank.mass").value == node.parameters.leg.shank.mass == 4.5
    assert not node.has_parameter("leg.shank.length")
    assert node.parameters.leg.shank.length == load().leg.shank.length


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("leg.shank.mas", 4.5, "no parameter leg.shank.mas"),
        ("plant.external_torque", 1.0, "no parameter plant.external_torque"),
        ("leg.shank.mass", 4500.0, "leg.shank.mass"),
        ("leg.configuration", 0, "must be 1"),
    ],
)
def test_what_is_given_is_checked_though_it_would_not_be_declared(make, key, value, words):
    with pytest.raises(OrthosisError, match=words):
        make("position_controller", **{key: value})


def test_a_node_that_is_refused_leaves_the_graph(make):
    with pytest.raises(OrthosisError, match=r"leg\.shank\.mass") as refused:
        make("position_controller", **{"leg.shank.mass": 4500.0})
    other = rclpy.create_node("other")
    there = other.get_node_names()
    other.destroy_node()
    assert "position_controller" not in there, refused
