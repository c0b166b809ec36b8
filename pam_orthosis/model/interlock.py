# SPDX-License-Identifier: Apache-2.0
"""The interlock of a device's valves: a sole is released while a joint of its leg is vented."""

from collections import defaultdict
from collections.abc import Mapping, Sequence

from pam_orthosis.model.components.spool import VENT, voltage_of
from pam_orthosis.model.mechanisms import Sole
from pam_orthosis.model.parameters import Parameters


class Interlock:
    """Vents the cushions of a sole, whatever is asked of them, while a joint of its leg is vented.

    A joint is vented when all its valves were told so for `control.guard.hold_time`. The sole is released
    for `control.guard.rest_time` at least, so that its controllers notice, and lead it back.

    Args:
        parameters: of each machine by its namespace; what stands before its last name is the leg.
    """

    def __init__(self, parameters: Mapping[str, Parameters]):
        self._lines: dict[str, list[int]] = defaultdict(list)  # namespace -> numbers of its valves
        self._vent: list[float] = []
        for name, one in parameters.items():
            for _ in one.declared.names:
                self._lines[name].append(len(self._vent))
                self._vent.append(max(one.valve.minimum_voltage, voltage_of(VENT, one.valve)))
        self._asked = [float("inf")] * len(self._vent)
        soles = {name for name, one in parameters.items() if has_sole(one)}
        joints = [name for name in parameters if name not in soles]
        self._of_leg = {sole: [one for one in joints if _leg(one) == _leg(sole)] for sole in soles}
        self._vented = dict.fromkeys(joints, 0)  # for how many periods all its valves were told to vent
        self._left = dict.fromkeys(soles, 0)  # for how many periods a sole is still released
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
        for joint, before in self._vented.items():
            vents = all(self._asked[line] <= self._vent[line] for line in self._lines[joint])
            self._vented[joint] = before + 1 if vents else 0
        for sole, joints in self._of_leg.items():
            vented = any(self._vented[joint] >= self._after for joint in joints)
            self._left[sole] = self._least if vented else max(0, self._left[sole] - 1)
        self._released = {line for sole, left in self._left.items() if left for line in self._lines[sole]}


def has_sole(parameters: Parameters) -> bool:
    """Return whether a machine presses on a sole."""
    return parameters.declared.kind == Sole.kind


def _leg(name: str) -> str:
    return name.rpartition("/")[0]
