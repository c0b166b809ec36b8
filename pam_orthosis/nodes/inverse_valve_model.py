# SPDX-License-Identifier: Apache-2.0
"""Node: inverse valve model of all actuators, from mass flow and pressure to a position of the spool."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from pam_orthosis.bag.topics import ALLOWED, VALVE
from pam_orthosis.control.guarded import GuardedValve
from pam_orthosis.control.inverse_valve import InverseValveModel
from pam_orthosis.control.limits import ceiling
from pam_orthosis.model.components.spool import VENT, spool_position
from pam_orthosis.nodes import graph, messages, process
from pam_orthosis.nodes.emergency import EmergencyStop
from pam_orthosis.nodes.join import Join
from pam_orthosis.nodes.topic_node import Numbers


class InverseValveModelNode(graph.GraphNode):
    """Publishes each step's command for each valve as soon as its own inputs are there.

    The service `~/emergency_stop` makes it vent all actuators, whatever is asked of it, until `~/reset`, and
    for so long at least that the position controller notices: it leads the machine back afterwards.
    """

    def __init__(self, place: Sequence[str] = ()) -> None:
        super().__init__(VALVE, place=place)

    def configure(self) -> None:
        """Make models, guards and commands."""
        super().configure()
        self._left = False
        least_ns = round(self.parameters.control.guard.rest_time * 1e9)
        self._stop = EmergencyStop(self, least_ns, self._reset)
        names = self.machine.names
        self._all = Join(names, self._answered)
        self._answer = self.publish_to("answered") if self.realtime else None
        self._models = {
            name: GuardedValve(self.parameters, InverseValveModel(self.parameters, name)) for name in names
        }
        self._commands = {name: self._command_of(name) for name in names}
        self._answered_ns: dict[str, int] = {}
        watched = {ALLOWED: messages.PRESSURE} if ALLOWED in self.topics else {}
        self._joins = [
            self.join_inputs(
                {f"{name}/mass_flow": messages.FLOW, f"{name}/pressure": messages.PRESSURE, **watched},
                partial(self._step, name),
            )
            for name in names
        ]

    def health(self) -> dict[str, Any]:
        """Count lost inputs; report an emergency stop and what the guards did."""
        dropped = sum(join.dropped for join in self._joins)
        models = self._models.items()
        guards = {f"{m}_{name}": value for m, one in models for name, value in one.health().items()}
        return {"dropped_inputs": dropped, "emergency_stop": self._stop.active, **guards}

    def latched(self) -> str:
        """Return why a valve vents until somebody acts, if one does."""
        reasons = [one.latched for one in self._models.values() if one.latched]
        return "emergency stop" if self._stop.active else next(iter(reasons), "")

    def abandon(self) -> bool:
        """Tell all valves to vent: nobody controls them any more. In lockstep by hand all wait instead."""
        if not (self.realtime or self.supervised):
            return False
        self._left = True
        self._vent()
        return True

    def deactivate(self) -> None:
        """Leave the valves vented; in lockstep no time passes meanwhile."""
        super().deactivate()
        if self.realtime:
            self._vent()

    def _reset(self) -> None:
        for model in self._models.values():
            model.reset()

    def _vent(self) -> None:
        for name, stamp_ns in self._answered_ns.items():
            self._publish(name, stamp_ns + self.period_ns, VENT)

    def _answered(self, stamp_ns: int, *_: float) -> None:
        if self._answer:
            self._answer.publish(messages.time_reference(stamp_ns, self.now_ns()))
        self.step_done(stamp_ns)

    def _command_of(self, name: str) -> Callable[..., None]:
        example = messages.joint_state(0, [f"{name}_valve"], position=[0.0])
        return self.publish_numbers(f"{name}/valve_command", example)

    def _step(self, name: str, stamp_ns: int, flow: Numbers, pressure: Numbers, *watched: Numbers) -> None:
        (mass_flow,), (measured,) = flow, pressure
        asked = self._models[name].step(mass_flow, measured, self.periods_since(stamp_ns))
        for (allowed,) in watched:  # by the safety monitor, if there is one
            valve, band = self.parameters.valve, self.parameters.control.limits.band
            asked = min(asked, ceiling(measured, allowed, valve, band))
        spool = VENT if self._stop.step() or self._left else spool_position(asked, self.parameters.valve)
        self._publish(name, stamp_ns, spool)
        self._all.add(name, stamp_ns, spool)

    def _publish(self, name: str, stamp_ns: int, spool: float) -> None:
        self._answered_ns[name] = stamp_ns
        self._commands[name](stamp_ns, spool)


def main() -> int:
    """Run the node."""
    return process.run(lambda: [InverseValveModelNode()])
