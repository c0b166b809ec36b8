# SPDX-License-Identifier: Apache-2.0
"""The interlock of a device's valves: a sole is released while a joint of its leg is vented."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pam_orthosis.model.components.spool import VENT, voltage_of
from pam_orthosis.model.mechanisms import Sole
from pam_orthosis.model.parameters import Parameters


@dataclass
class _Joint:
    """The valves of a joint: their numbers, and for how many periods all have been told to vent."""

    lines: list[int]
    vented: int = 0


@dataclass
class _Sole:
    """The valves of a sole, the joints that release it, and for how many periods it is still released."""

    lines: list[int]
    joints: list[_Joint]
    released: int = 0


class Interlock:
    """Vents the cushions of a sole, whatever is asked of them, while a joint of its leg is vented.

    A joint is vented when all its valves were told so for `control.guard.hold_time`. The sole is released
    for `control.guard.rest_time` at least, so that its controllers notice, and lead it back.

    Args:
        parameters: of each machine by its namespace; what stands before its last name is the leg.
    """

    def __init__(self, parameters: Mapping[str, Parameters]):
        lines: dict[str, list[int]] = defaultdict(list)
        self._vent: list[float] = []
        for name, one in parameters.items():
            for _ in one.declared.names:
                lines[name].append(len(self._vent))
                self._vent.append(max(one.valve.minimum_voltage, voltage_of(VENT, one.valve)))
        self._asked = [float("inf")] * len(self._vent)
        soles = {name for name, one in parameters.items() if has_sole(one)}
        joints = {name: _Joint(lines[name]) for name in parameters if name not in soles}
        self._joints = list(joints.values())
        self._soles = [
            _Sole(lines[sole], [one for name, one in joints.items() if _leg(name) == _leg(sole)])
            for sole in parameters
            if sole in soles
        ]
        first = next(iter(parameters.values()))
        guard, period = first.control.guard, first.scenario.control_period
        self._after, self._least = (max(1, round(t / period)) for t in (guard.hold_time, guard.rest_time))
        self._released: set[int] = set()

    def answered(self, voltages: Sequence[float]) -> list[float]:
        """Take what is asked of all valves in a control period; return what they are given, V."""
        given = [self.allowed(line, voltage) for line, voltage in enumerate(voltages)]
        self.passed()
        return given

    def allowed(self, line: int, voltage: float) -> float:
        """Take what is asked of a valve, by its number; return what it is given, V."""
        self._asked[line] = voltage
        return self._vent[line] if line in self._released else voltage

    def passed(self) -> None:
        """Look at what was asked in the control period that is over."""
        for joint in self._joints:
            vents = all(self._asked[line] <= self._vent[line] for line in joint.lines)
            joint.vented = joint.vented + 1 if vents else 0
        self._released.clear()
        for sole in self._soles:
            vented = any(joint.vented >= self._after for joint in sole.joints)
            sole.released = self._least if vented else max(0, sole.released - 1)
            self._released.update(sole.lines if sole.released else ())


def has_sole(parameters: Parameters) -> bool:
    """Return whether a machine presses on a sole."""
    return parameters.declared.kind == Sole.kind


def _leg(name: str) -> str:
    return name.rpartition("/")[0]
