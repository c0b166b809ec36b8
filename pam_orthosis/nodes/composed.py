# SPDX-License-Identifier: Apache-2.0
"""All nodes of a leg in one process under one executor: the same nodes, topics and results."""

from __future__ import annotations

import sys

from pam_orthosis.bag.topics import EXTENSOR, FLEXOR
from pam_orthosis.nodes import graph
from pam_orthosis.nodes.bag_recorder import BagRecorder
from pam_orthosis.nodes.inverse_valve_model import InverseValveModelNode
from pam_orthosis.nodes.plant_simulator import PlantSimulator
from pam_orthosis.nodes.position_controller import PositionControllerNode
from pam_orthosis.nodes.pressure_controller import PressureControllerNode
from pam_orthosis.nodes.trajectory_publisher import TrajectoryPublisher


def make_nodes() -> list[graph.GraphNode]:
    """Return one of each node, without the plant where a driver stands in for it."""
    recorder = BagRecorder()
    plant = [PlantSimulator()] if recorder.settings["with_plant"] else []
    return [
        recorder,
        TrajectoryPublisher(),
        PositionControllerNode(),
        PressureControllerNode(EXTENSOR),
        PressureControllerNode(FLEXOR),
        InverseValveModelNode(),
        *plant,
    ]


def main() -> int:
    """Run all nodes."""
    return graph.run(make_nodes)


if __name__ == "__main__":
    sys.exit(main())
