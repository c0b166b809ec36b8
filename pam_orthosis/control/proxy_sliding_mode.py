# SPDX-License-Identifier: Apache-2.0
"""Proxy-based sliding mode: as a PID for small errors, slow and without overshoot after large ones.

A massless proxy is led to the reference by a sliding mode of bounded force, and draws the joint by a PID.
While the bound is not reached the proxy slides on `error + time * rate = 0`; else it falls behind with the
joint, so that nothing winds up. Kikuuwe and Fujimoto, "Proxy-based sliding mode control for accurate and safe
position control", ICRA 2006; IEEE Transactions on Robotics 26(4), 2010, page 670: "a safer extension of
PID position control". Both conditions are met at the end of each period (implicit Euler), which needs no
switching.
"""

from pam_orthosis.control.reference import Reference
from pam_orthosis.model.parameters import Parameters


class ProxySlidingMode:
    """A law of `control.position.controller`, see `peers.Law`; the PID's gains are those of `control.pid`."""

    def __init__(self, nominal: Parameters):
        self._pid, self._settings = nominal.control.pid, nominal.control.proxy_sliding_mode
        self._period = nominal.scenario.control_period
        self._gap = self._integral = 0.0  # proxy less joint; the PID's integral part

    def begin(self, position: float, velocity: float, held: float) -> None:
        """Begin with the proxy at the joint and an integral that holds it there."""
        self._gap, self._integral = 0.0, held

    def step(
        self,
        position: float,
        velocity: float,
        reference: Reference,
        room: tuple[float, float],
        periods: int,
    ) -> float:
        """Return the asked acceleration, within the room."""
        g, s, time = self._pid, self._settings, periods * self._period
        ahead = reference.position - position + s.time * (reference.velocity - velocity)
        sliding = (time * ahead + s.time * self._gap) / (time + s.time)
        stiffness = g.proportional + g.integral * time + g.derivative / time
        rest = self._integral - g.derivative / time * self._gap
        least, most = (max(-s.limit, end - reference.acceleration) for end in room)
        pull = min(max(stiffness * sliding + rest, least), most, s.limit)
        self._gap = (pull - rest) / stiffness
        self._integral += g.integral * time * self._gap
        return float(reference.acceleration + pull)
