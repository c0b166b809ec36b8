# SPDX-License-Identifier: Apache-2.0
"""The nodes of a machine: executable, the parameters that each may know, its own settings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pam_orthosis.bag.topics import PLANT, POSITION, RECORDER, SAFETY, TRAJECTORY, VALVE, Topics
from pam_orthosis.control import live
from pam_orthosis.model.parameters import NOMINAL

if TYPE_CHECKING:
    from pam_orthosis.model.machine import Machine

SHOWN = ("leg", "machine", "muscle", "valve")  # what the look of a machine depends on
VIEWER = "live_view"
PACE, RESTING = (f"plant.person.volition.{name}" for name in ("cycle_time", "resting"))
EVERYTHING = (*NOMINAL, "plant")
# which steps there are, and which topics
_GRAPH = (
    *("scenario.control_period", "control.position.every", "scenario.trajectory", "scenario.plan.enabled"),
    "control.limits.enabled",
)
_MEAN = "control.position.mean_pressure"
_LIMITS = ("control.position.minimum_pressure", "control.position.maximum_pressure")
_GUARDS = tuple(
    f"control.guard.{name}"
    for name in ("hold_time", "frozen_time", "lowest_", "pressure_margin", "pressure_rate", "pressure_motion")
)
_FOLLOWED = ("control.guard.pressure_error", "control.guard.pressure_time")
_MOTION = ("trajectory", "cycle_time", "start_", "sine.", "step.", "gait.", "plan.", "diagnostic.")
_EMULATED = (
    "simulation.",
    "muscle_law",
    "external_",
    "deviation.",
    "mounting.",
    "sensor.",
    "delay.",
    "voltage_",
)
_PULL, _HELP = ("mode", "stiffness", "damping", "fastest", "edge"), ("tunnel", "learning", "forgetting")
_COOPERATION = (*_PULL, *_HELP, "least_mean", "ease")
# beginnings of the keys that are an executable's own; those of the apparatus are everybody's
OWN = {
    RECORDER: (*_GRAPH, "scenario.duration"),
    TRAJECTORY: (*_GRAPH, _MEAN, "control.cooperation.wait", *(f"scenario.{name}" for name in _MOTION)),
    POSITION: (
        *(*_GRAPH, "scenario.start_angle"),
        *("control.observer.", "control.position.", "control.guard.", "control.limits.look_ahead"),
        *(f"control.cooperation.{name}" for name in _COOPERATION),
    ),
    "pressure_controller": (
        *(*_GRAPH, "scenario.start_angle"),
        *("control.pressure.", *_LIMITS, *_GUARDS, *_FOLLOWED),
    ),
    "driver": ("scenario.control_period",),
    VALVE: (*_GRAPH, "control.inverse_valve.", *_GUARDS, "control.guard.rest_time", "control.limits.band"),
    SAFETY: (*_GRAPH, "control.limits."),
    PLANT: (
        *(*_GRAPH, _MEAN, "scenario.duration", "scenario.seed", "scenario.start_angle"),
        *(f"plant.{name}" for name in _EMULATED),
    ),
}


OF_THE_PATIENT = ("low", "high", "speed", "effort", "force", "pressure", "spasm")


@dataclass(frozen=True)
class NodeSpec:
    """A node of a graph.

    Attributes:
        name: in the graph.
        executable: module of its class.
        branches: of the parameter tree that it may know, and be given.
        muscle: whose controller it is.
        live: keys of the parameters that may be set while it runs.
    """

    name: str
    executable: str
    branches: tuple[str, ...] = NOMINAL
    muscle: str = ""
    live: tuple[str, ...] = ()

    def owns(self, key: str) -> bool:
        """Whether the node declares a row that it was not given."""
        return key in self.live or key.startswith(OWN.get(self.executable, ()))


def live_keys(machine: Machine) -> dict[str, tuple[str, ...]]:
    """Return the parameters that a change while the nodes run cannot make inconsistent, by executable."""
    return {
        "trajectory_publisher": ("scenario.cycle_time",),
        "position_controller": live.of_cooperation(machine),
        "plant_simulator": (*machine.live, PACE, RESTING),
        SAFETY: tuple(f"control.limits.{name}" for name in OF_THE_PATIENT),
        "pressure_controller": live.PRESSURE,
    }


def layout(topics: Topics) -> dict[str, NodeSpec]:
    """Return the nodes of a machine's graph by name, the recorder first."""
    keys = live_keys(topics.machine)
    controllers = [
        NodeSpec(node, "pressure_controller", NOMINAL, name, keys["pressure_controller"])
        for node, name in topics.controllers.items()
    ]
    specs = (
        NodeSpec(RECORDER, RECORDER, EVERYTHING),
        NodeSpec(TRAJECTORY, TRAJECTORY, live=keys[TRAJECTORY]),
        NodeSpec(POSITION, POSITION, live=keys[POSITION]),
        *controllers,
        NodeSpec(VALVE, VALVE),
        NodeSpec(SAFETY, SAFETY, live=keys[SAFETY]),
        NodeSpec(PLANT, PLANT, EVERYTHING, live=keys[PLANT]),
    )
    return {spec.name: spec for spec in specs}
