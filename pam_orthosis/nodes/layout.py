# SPDX-License-Identifier: Apache-2.0
"""The nodes of a machine: executable, the parameters that each may know, its own settings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pam_orthosis.bag.topics import PLANT, POSITION, RECORDER, TRAJECTORY, VALVE, Topics
from pam_orthosis.model.parameters import BELIEF

if TYPE_CHECKING:
    from pam_orthosis.model.machine import Machine

EVERYTHING = (*BELIEF, "plant")


@dataclass(frozen=True)
class NodeSpec:
    """A node: name in the graph, module of its class, branches of the parameter tree, muscle, live keys."""

    name: str
    executable: str
    branches: tuple[str, ...] = BELIEF
    muscle: str = ""
    live: tuple[str, ...] = ()


def live_keys(machine: Machine) -> dict[str, tuple[str, ...]]:
    """Return the parameters that a change while the nodes run cannot make inconsistent, by executable."""
    gains = ("control.position.c1", "control.position.c2", "control.observer.pole")
    return {
        "trajectory_publisher": ("scenario.cycle_time",),
        "position_controller": (*gains, *machine.live),
        "plant_simulator": machine.live,
        "pressure_controller": ("control.pressure.gain", "control.pressure.reference_filter"),
    }


def layout(topics: Topics) -> dict[str, NodeSpec]:
    """Return the nodes of a machine's graph by name, the recorder first."""
    live = live_keys(topics.machine)
    controllers = [
        NodeSpec(node, "pressure_controller", BELIEF, name, live["pressure_controller"])
        for node, name in topics.controllers.items()
    ]
    specs = (
        NodeSpec(RECORDER, RECORDER, EVERYTHING),
        NodeSpec(TRAJECTORY, TRAJECTORY, live=live[TRAJECTORY]),
        NodeSpec(POSITION, POSITION, live=live[POSITION]),
        *controllers,
        NodeSpec(VALVE, VALVE),
        NodeSpec(PLANT, PLANT, EVERYTHING, live=live[PLANT]),
    )
    return {spec.name: spec for spec in specs}
