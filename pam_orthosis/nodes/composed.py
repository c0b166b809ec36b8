# SPDX-License-Identifier: Apache-2.0
"""Nodes of a machine in one process under one executor: the same nodes, topics and results."""

from __future__ import annotations

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
    """Return the nodes of these names, or all of the machine that the recorder is given."""
    if names:
        return [_made(name) for name in names]
    recorder = BagRecorder()
    if not recorder.configured:
        raise OrthosisError(
            "with autostart:=false name the nodes: only its configuration says which there are"
        )
    return [recorder, *(_made(name) for name in recorder.topics["ready"].producers if name != RECORDER)]


def _made(name: str) -> GraphNode:
    return NODES[name]() if name in NODES else PressureControllerNode(name)


def main() -> int:
    """Run the nodes that the command line names, or all."""
    names = remove_ros_args(sys.argv)[1:]
    unknown = [name for name in names if name not in NODES and not name.endswith(CONTROLLER.format(""))]
    if unknown:
        print(f"{ERROR_PREFIX}no node {unknown[0]}: give some of {', '.join(NODES)}", file=sys.stderr)
        return OrthosisError.exit_status
    return process.run(lambda: make(names))


if __name__ == "__main__":
    sys.exit(main())
