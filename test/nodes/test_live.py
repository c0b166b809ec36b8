# SPDX-License-Identifier: Apache-2.0
"""Parameters of running nodes: described, changed where that is safe, refused with a reason elsewhere."""

import pytest
from own_domain import own_domain

from pam_orthosis.control import live
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load
from pam_orthosis.nodes import layout

rclpy = pytest.importorskip("rclpy")


@pytest.fixture
def make_node(tmp_path, monkeypatch):
    """Return a function: node class, its arguments, parameters -> the node, alone in a context."""
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    nodes = []

    def make(node_class, *arguments, **parameters):
        settings = [word for key, value in parameters.items() for word in ("-p", f"{key}:={value}")]
        rclpy.init(args=["--ros-args", *settings], domain_id=own_domain())
        nodes.append(node_class(*arguments))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()
    rclpy.shutdown()


def _set(node, key, value):
    return node.set_parameters([rclpy.parameter.Parameter(key, value=value)])[0]


def _position_controller(make_node, **parameters):
    from pam_orthosis.nodes.position_controller import PositionControllerNode

    return make_node(PositionControllerNode, **parameters)


def test_every_parameter_has_a_description_a_unit_and_a_range(make_node):
    node = _position_controller(make_node)
    rows = [row for row in load().rows() if node.has_parameter(row.key)]
    assert len(rows) > 30
    for row in rows:
        descriptor = node.describe_parameter(row.key)
        assert descriptor.description == f"{row.meaning} [{row.unit}]"
        assert descriptor.read_only == (row.key not in live.of_cooperation(KNEE))
        ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
        if row.minimum is not None and row.maximum is not None and not isinstance(row.value, list):
            assert [(r.from_value, r.to_value) for r in ranges] == [(row.minimum, row.maximum)]


def test_a_gain_of_a_running_node_changes(make_node):
    node = _position_controller(make_node)
    assert _set(node, "control.position.c1", 30.0).successful
    assert node.parameters.control.position.c1 == 30.0
    assert node.get_parameter("control.position.c1").value == 30.0


@pytest.mark.parametrize(
    ("key", "value", "reason"),
    [
        ("control.position.c1", 1000.0, "out of range"),
        ("control.position.c1", "fast", "type"),
        ("control.guard.hold_time", 0.03, "read-only"),
        ("scenario.control_period", 0.01, "read-only"),
        ("leg.person.mass", 80.0, "no person"),
    ],
)
def test_what_is_unsafe_is_refused_with_a_reason_and_changes_nothing(make_node, key, value, reason):
    node = _position_controller(make_node)
    before = node.get_parameter(key).value
    result = _set(node, key, value)
    assert not result.successful
    assert reason in result.reason
    assert node.get_parameter(key).value == before
    assert node.parameters.flat() == load().nominal().flat()


def test_the_mass_of_a_person_changes(make_node):
    node = _position_controller(make_node, **{"leg.person.present": "true"})
    assert _set(node, "leg.person.mass", 80.0).successful


def test_the_person_in_the_emulated_orthosis_changes(make_node):
    from pam_orthosis.nodes.plant_simulator import PlantSimulator

    node = make_node(PlantSimulator, **{"leg.person.present": "true"})
    before = node._plants.of[""].state.copy()
    assert _set(node, "leg.person.mass", 110.0).successful
    assert (node._plants.of[""].state == before).all()
    node.advance(5.0, 5.0)
    heavier = node._plants.of[""].state.copy()
    assert _set(node, "leg.person.mass", 50.0).successful
    node._plants.of[""].state[:] = before
    node.advance(5.0, 5.0)
    assert abs(node._plants.of[""].state[1] - heavier[1]) > 1e-3  # the knee turns otherwise


def test_a_leg_keeps_its_own_values_when_another_key_changes(make_node):
    from pam_orthosis.nodes.plant_simulator import PlantSimulator

    legs = '\'{"left": {}, "right": {"leg.person.mass": 90.0}}\''
    node = make_node(PlantSimulator, **{"leg.person.present": "true", "legs": legs})
    told = {leg: [] for leg in node._plants.of}
    for leg, plant in node._plants.of.items():
        plant.retune = told[leg].append
    pace, mass = layout.PACE, "leg.person.mass"
    for key, value in ((pace, 1.7), (mass, 60.0), (pace, 1.9)):
        assert _set(node, key, value).successful
    found = {leg: [(p.at(pace), p.at(mass)) for p in each] for leg, each in told.items()}
    shared = load().at(mass)
    assert found == {
        "left": [(1.7, shared), (1.7, 60.0), (1.9, 60.0)],
        "right": [(1.7, 90.0), (1.7, 60.0), (1.9, 60.0)],
    }


def test_nobody_else_steps_into_the_emulated_orthosis(make_node):
    from pam_orthosis.nodes.plant_simulator import PlantSimulator

    result = _set(make_node(PlantSimulator), "leg.person.mass", 110.0)
    assert not result.successful
    assert "no person" in result.reason


def test_a_gain_is_set_on_the_node_that_uses_it_alone(make_node):
    from pam_orthosis.nodes.trajectory_publisher import TrajectoryPublisher

    node = make_node(TrajectoryPublisher)
    assert not node.has_parameter("control.position.c1")
    assert _set(node, "scenario.cycle_time", 3.0).successful


def test_an_experiment_keeps_its_course(make_node):
    from pam_orthosis.nodes.trajectory_publisher import TrajectoryPublisher

    node = make_node(TrajectoryPublisher, **{"scenario.trajectory": "triangle"})
    result = _set(node, "scenario.cycle_time", 3.0)
    assert not result.successful
    assert "experiment" in result.reason
    with pytest.raises(OrthosisError, match="experiment"):
        node.retune(node.parameters)


def test_the_mode_of_cooperation_may_change_while_it_runs(make_node):
    node = _position_controller(make_node)
    assert _set(node, "control.cooperation.mode", "transparent").successful
    assert node.parameters.control.cooperation.mode == "transparent"
    refused = _set(node, "control.position.controller", "pid")
    assert not refused.successful
    assert "read-only" in refused.reason
    refused = _set(node, "control.cooperation.mode", "gentle")
    assert not refused.successful
    assert "not one of position, impedance, assist, transparent" in refused.reason


def test_a_law_by_name_keeps_to_its_mode(make_node):
    node = _position_controller(make_node, **{"control.position.controller": "adrc"})
    refused = _set(node, "control.cooperation.mode", "assist")
    assert not refused.successful
    assert "adrc is for control.cooperation.mode = position, not assist" in refused.reason
    assert node.parameters.control.cooperation.mode == "position"
