# SPDX-License-Identifier: Apache-2.0
"""Nodes of a machine, or several, in one process under one executor: the same nodes, topics and results."""

import sys
from collections.abc import Sequence

from rclpy.utilities import remove_ros_args

from pam_orthosis.bag.topics import CONTROLLER, PLANT, POSITION, RECORDER, SAFETY, TRAJECTORY, VALVE
from pam_orthosis.errors import OrthosisError
from pam_orthosis.nodes import process
from pam_orthosis.nodes.bag_recorder import BagRecorder
from pam_orthosis.nodes.graph import GraphNode
from pam_orthosis.nodes.inverse_valve_model import InverseValveModelNode
from pam_orthosis.nodes.plant_simulator import PlantSimulator
from pam_orthosis.nodes.position_controller import PositionControllerNode
from pam_orthosis.nodes.pressure_controller import PressureControllerNode
from pam_orthosis.nodes.safety_monitor import SafetyMonitorNode
from pam_orthosis.nodes.supervisor import ERROR_PREFIX
from pam_orthosis.nodes.trajectory_publisher import TrajectoryPublisher

NODES = {
    RECORDER: BagRecorder,
    TRAJECTORY: TrajectoryPublisher,
    POSITION: PositionControllerNode,
    VALVE: InverseValveModelNode,
    SAFETY: SafetyMonitorNode,
    PLANT: PlantSimulator,
}


def make(names: Sequence[str]) -> list[GraphNode]:
    """Return the nodes of these names, with namespaces, or all of the machine that the recorder is given."""
    if names:
        legs = list(dict.fromkeys(filter(None, (name.rpartition("/")[0] for name in names))))
        return [_made(name, legs) for name in names]
    recorder = BagRecorder()
    if not recorder.configured:
        raise OrthosisError(
            "with autostart:=false name the nodes: only its configuration says which there are"
        )
    return [recorder, *(_made(name, []) for name in recorder.topics["ready"].producers if name != RECORDER)]


def _made(full: str, legs: Sequence[str]) -> GraphNode:
    """Return a node in its namespace; the clock of the first leg is that of the run."""
    leg, _, name = full.rpartition("/")
    own_clock = ["-r", f"/clock:=/{leg}/clock"] if leg in legs[1:] else []
    place = ["-r", f"__ns:=/{leg}", *own_clock] if leg else []
    return NODES[name](place) if name in NODES else PressureControllerNode(name, place)


def main() -> int:
    """Run the nodes that the command line names, or all."""
    names = remove_ros_args(sys.argv)[1:]
    roles = {name: name.rpartition("/")[2] for name in names}
    pressure = CONTROLLER.format("")
    unknown = [name for name, role in roles.items() if role not in NODES and not role.endswith(pressure)]
    if unknown:
        print(f"{ERROR_PREFIX}no node {unknown[0]}: give some of {', '.join(NODES)}", file=sys.stderr)
        return OrthosisError.exit_status
    return process.run(lambda: make(names))
