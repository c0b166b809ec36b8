# SPDX-License-Identifier: Apache-2.0
"""Nodes of a leg in one process under one executor: the same nodes, topics and results."""

from __future__ import annotations

import sys

from rclpy.utilities import remove_ros_args

from pam_orthosis.bag import topics
from pam_orthosis.errors import OrthosisError
from pam_orthosis.nodes import process
from pam_orthosis.nodes.bag_recorder import BagRecorder
from pam_orthosis.nodes.inverse_valve_model import InverseValveModelNode
from pam_orthosis.nodes.plant_simulator import PlantSimulator
from pam_orthosis.nodes.position_controller import PositionControllerNode
from pam_orthosis.nodes.pressure_controller import PressureControllerNode
from pam_orthosis.nodes.supervisor import ERROR_PREFIX
from pam_orthosis.nodes.trajectory_publisher import TrajectoryPublisher

NODES = {
    topics.RECORDER: BagRecorder,
    topics.TRAJECTORY: TrajectoryPublisher,
    topics.POSITION: PositionControllerNode,
    topics.EXTENSOR: lambda: PressureControllerNode(topics.EXTENSOR),
    topics.FLEXOR: lambda: PressureControllerNode(topics.FLEXOR),
    topics.VALVE: InverseValveModelNode,
    topics.PLANT: PlantSimulator,
}


def main() -> int:
    """Run the nodes that the command line names, or all."""
    names = remove_ros_args(sys.argv)[1:] or list(NODES)
    unknown = [name for name in names if name not in NODES]
    if unknown:
        print(f"{ERROR_PREFIX}no node {unknown[0]}: give some of {', '.join(NODES)}", file=sys.stderr)
        return OrthosisError.exit_status
    return process.run(lambda: [NODES[name]() for name in names])


if __name__ == "__main__":
    sys.exit(main())
