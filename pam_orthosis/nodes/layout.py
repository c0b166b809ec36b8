# SPDX-License-Identifier: Apache-2.0
"""The nodes of one leg: executable, the parameters that each may know, its own settings."""

from __future__ import annotations

from dataclasses import dataclass

from pam_orthosis.bag import topics
from pam_orthosis.model.parameters import BELIEF

# the parameters that a change while the nodes run cannot make inconsistent, by executable
LIVE_KEYS = {
    "trajectory_publisher": ("scenario.cycle_time",),
    "position_controller": (
        "control.position.c1",
        "control.position.c2",
        "control.observer.pole",
        "leg.person.mass",
    ),
    "plant_simulator": ("leg.person.mass",),
    "pressure_controller": ("control.pressure.gain", "control.pressure.reference_filter"),
}
EVERYTHING = (*BELIEF, "plant")


@dataclass(frozen=True)
class NodeSpec:
    """A node: name in the graph, module of its class, branches of the parameter tree, muscle."""

    name: str
    executable: str
    branches: tuple[str, ...] = BELIEF
    muscle: str = ""

    @property
    def live(self) -> tuple[str, ...]:
        """Parameters that may be set while the node runs."""
        return LIVE_KEYS.get(self.executable, ())


LAYOUT = {
    spec.name: spec
    for spec in (
        NodeSpec(topics.RECORDER, "bag_recorder", EVERYTHING),
        NodeSpec(topics.TRAJECTORY, "trajectory_publisher"),
        NodeSpec(topics.POSITION, "position_controller"),
        NodeSpec(topics.EXTENSOR, "pressure_controller", muscle="extensor"),
        NodeSpec(topics.FLEXOR, "pressure_controller", muscle="flexor"),
        NodeSpec(topics.VALVE, "inverse_valve_model"),
        NodeSpec(topics.PLANT, "plant_simulator", EVERYTHING),
    )
}
