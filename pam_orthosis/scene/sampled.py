# SPDX-License-Identifier: Apache-2.0
"""A machine's messages for viewers, made of its measurements as they come."""

import math
from typing import Any

from pam_orthosis.bag import messages as ros
from pam_orthosis.bag.topics import JOINT, PRESSURE, SECOND_NS
from pam_orthosis.model.machine import Machine
from pam_orthosis.scene.messages import PERIOD_NS, TYPES, Said, Scene

FARTHEST = {"rad": math.pi, "m": 10.0}  # what a coordinate cannot leave


class SampledScene:
    """Says where a machine is at the first whole sample of each `PERIOD_NS`.

    Samples that it cannot have (nothing measured, not finite, beyond half a turn or 10 m) are passed over.
    With `again` it begins anew when a sample is more than a second older than what was said last: another run
    has begun, or a bag is played in a loop.
    """

    def __init__(self, scene: Scene, again: bool = False):
        self._scene = scene
        self.inputs = inputs(scene.machine)
        self._again = again
        self._begun = False
        self._said_period = -1
        self._stamp_ns = -1
        self._there: dict[str, Any] = {}

    def prepare(self) -> None:
        """Use each type of message once: its code is made then, which takes many samples' time."""
        pressure = ros.new(PRESSURE, header=ros.header(0), fluid_pressure=0.0, variance=0.0)
        ros.deserialised(PRESSURE, ros.serialised(PRESSURE, pressure))
        for topic, data in [
            *self._scene.once(0),
            *self._scene.sample(0, 0.0, [0.0] * len(self._scene.machine.names)),
        ]:
            ros.deserialised(TYPES[topic], data)

    def add(self, topic: str, stamp_ns: int, data: bytes) -> list[Said]:
        """Take a serialised message of one of `inputs`; return what is to be said now."""
        period = stamp_ns // PERIOD_NS
        if period <= self._said_period:
            if not self._again or period >= self._said_period - SECOND_NS // PERIOD_NS:
                return []
            self._begun, self._said_period = False, -1
        if stamp_ns != self._stamp_ns:
            self._stamp_ns, self._there = stamp_ns, {}
        self._there[topic] = ros.deserialised(self.inputs[topic], data)
        if len(self._there) < len(self.inputs):
            return []
        self._said_period = period
        return self._sample(stamp_ns, *(self._there[name] for name in self.inputs))

    def _sample(self, stamp_ns: int, joint: Any, *pressures: Any) -> list[Said]:
        machine = self._scene.machine
        coordinate = float(dict(zip(joint.name, joint.position, strict=False)).get(machine.name, math.nan))
        values = [coordinate, *(one.fluid_pressure for one in pressures)]
        if not all(map(math.isfinite, values)) or abs(coordinate) > FARTHEST[machine.coordinate.unit]:
            return []
        first = [] if self._begun else self._scene.once(stamp_ns)
        self._begun = True
        return [*first, *self._scene.sample(stamp_ns, coordinate, values[1:])]


def inputs(machine: Machine) -> dict[str, str]:
    """Return the topics of the measurements that show where a machine is, with their types."""
    return {"joint_states": JOINT, **{f"{name}/pressure": PRESSURE for name in machine.names}}
