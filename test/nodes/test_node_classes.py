# SPDX-License-Identifier: Apache-2.0
"""Classes of nodes: none overwrites a private name, or a method, of what it is built on."""

import ast
import inspect
import textwrap

import pytest

pytest.importorskip("rclpy")

from pam_orthosis.nodes import (
    bag_player,
    bag_recorder,
    driver,
    dummy_driver,
    graph,
    inverse_valve_model,
    leg_state_publisher,
    live_view,
    pace,
    plant_simulator,
    position_controller,
    pressure_controller,
    safety_monitor,
    topic_node,
    trajectory_publisher,
)

NODES = (
    topic_node.TopicNode,
    graph.GraphNode,
    pace.PacedNode,
    bag_player.BagPlayer,
    bag_recorder.BagRecorder,
    driver.Driver,
    dummy_driver.DummyDriver,
    inverse_valve_model.InverseValveModelNode,
    leg_state_publisher.LegStatePublisher,
    live_view.LiveView,
    plant_simulator.PlantSimulator,
    position_controller.PositionControllerNode,
    pressure_controller.PressureControllerNode,
    safety_monitor.SafetyMonitorNode,
    trajectory_publisher.TrajectoryPublisher,
)


def _kept(cls):
    """Return the attributes that the methods of a class set, and all names that its body defines."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(cls)))
    assigned = {
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)
        if isinstance(node.value, ast.Name) and node.value.id == "self"
    }
    of_python = "_abc_impl"  # in each abstract class
    return assigned, {name for name in vars(cls) if not name.startswith("__") and name != of_python}


def overwritten(cls):
    """Return the names of its ancestors that a class overwrites: private ones, and methods by attributes."""
    assigned, defined = _kept(cls)
    found = set()
    for ancestor in cls.__mro__[1:-1]:
        theirs, methods = _kept(ancestor)
        private = {name for name in theirs | methods if name.startswith("_")}
        callables = {name for name in methods if callable(getattr(ancestor, name))}
        found |= (assigned | defined) & private | assigned & callables
    return found


@pytest.mark.parametrize("cls", NODES, ids=lambda cls: cls.__name__)
def test_no_node_overwrites_what_it_is_built_on(cls):
    assert overwritten(cls) == set()


@pytest.mark.parametrize("cls", [driver.Driver, pace.PacedNode], ids=lambda cls: cls.__name__)
def test_who_forgets_a_method_that_must_be_overridden_is_told(cls):
    incomplete = type("Incomplete", (cls,), {"vent": lambda _: None, "take": lambda *_: None})
    with pytest.raises(TypeError, match="abstract"):
        incomplete()


def test_what_is_overwritten_is_seen():
    class Base:
        def __init__(self):
            self._own = 1

        def _join(self):
            """Was overwritten by an attribute once."""

        def health(self):
            """May be overridden."""

    class Faulty(Base):
        def __init__(self):
            super().__init__()
            self._join, self._own, self.health = 1, 2, 3

        def _mine(self):
            """Nobody else has it."""

    assert overwritten(Faulty) == {"_join", "_own", "health"}
