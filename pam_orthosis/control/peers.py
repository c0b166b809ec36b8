# SPDX-License-Identifier: Apache-2.0
"""Other laws in the place of backstepping, by the name in `control.position.controller`.

All laws have the same reference, observer, prediction over the valves' lag, choice of pressures and pressure
controllers; what differs is the law alone. A peer asks for an acceleration, which the nominal inertia makes
an effort: one set of gains suits every leg. It knows nothing else of the model.
"""

from collections.abc import Callable, Mapping, Sequence

import casadi as ca

from pam_orthosis.control.axis import Axis
from pam_orthosis.control.cooperation import CooperativeController
from pam_orthosis.control.effects import AddedEffort
from pam_orthosis.control.laws import Adrc, Law, Pid, ProxySlidingMode, Sample
from pam_orthosis.control.position import (
    Limited,
    PositionCommand,
    PositionController,
    given_effort,
    position_nominal,
)
from pam_orthosis.control.reference import Pressures, Reference, Valve
from pam_orthosis.model.compiled import compiled
from pam_orthosis.model.parameters import Parameters

PEERS: Mapping[str, Callable[[Parameters], Law]] = {
    "pid": Pid,
    "proxy_sliding_mode": ProxySlidingMode,
    "adrc": Adrc,
}


def make_controller(parameters: Parameters, live: bool = False) -> PositionController:
    """Return the controller that the parameters name; `live`: its mode may change while it runs."""
    law = PEERS.get(parameters.control.position.controller)
    if law is not None:
        return PeerController(parameters, law(position_nominal(parameters)))
    cooperates = live or parameters.control.cooperation.mode != "position"
    return CooperativeController(parameters) if cooperates else PositionController(parameters)


def load_function(nominal: Parameters) -> ca.Function:
    """Return (position, velocity, live values) -> inertia, weight, and the least and largest effort."""
    nominal, live = nominal.symbolic(nominal.declared.live)
    axis, limits = Axis(nominal), nominal.control.position
    q, velocity = ca.SX.sym("q"), ca.SX.sym("velocity")
    terms, ends = axis.terms(q, velocity), (limits.minimum_pressure, limits.maximum_pressure)
    one, other = axis.effort(q, velocity, ends), axis.effort(q, velocity, ends[::-1])
    found = terms.inertia, terms.coriolis + terms.gravity, ca.fmin(one, other), ca.fmax(one, other)
    return ca.Function("load", [q, velocity, live], [ca.vertcat(*found)])


class PeerController(PositionController):
    """The position controller with another law."""

    EFFORT = staticmethod(given_effort)

    def __init__(self, parameters: Parameters, law: Law):
        super().__init__(parameters)
        nominal = position_nominal(parameters)
        self._asked, self._load, self._live = law, compiled(load_function(nominal)), nominal.declared.live
        self._values = [nominal.at(key) for key in self._live]
        self._begun, self._beyond = False, 0.0

    def retune(self, parameters: Parameters) -> None:
        """Take another load; the laws' gains are fixed for a run."""
        super().retune(parameters)
        self._values = [parameters.at(key) for key in self._live]

    def restart(self) -> None:
        """Begin anew at the next sample."""
        super().restart()
        self._begun = False

    def step(
        self, position: float, pressures: Pressures, reference: Reference, periods: int = 1
    ) -> PositionCommand:
        """Return what `PositionController.step` does; after closed valves the law begins anew."""
        self._begun = self._begun and reference.mean_pressure is not Valve.CLOSED
        return super().step(position, pressures, reference, periods)

    def _law(
        self, estimate: Sequence[float], reference: Reference, mean: float, effect: AddedEffort, periods: int
    ) -> Limited:
        position, velocity, outside = estimate
        inertia, weight, least, most = self._load(position, velocity, self._values)[0].tolist()
        if not self._begun:
            self._asked.begin(position, velocity, weight / inertia)
            self._begun = True
        room = least / inertia, most / inertia
        wanted = self._asked.step(Sample(position, velocity, reference, room, periods))
        self._beyond = wanted - (weight + outside) / inertia - reference.acceleration
        return super()._law((position, velocity, wanted * inertia), reference, mean, effect, periods)

    def _correction(self, point: Sequence[float], reference: Reference) -> float:
        return self._beyond
