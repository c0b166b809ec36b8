# SPDX-License-Identifier: Apache-2.0
"""Laws beside backstepping: what makes an acceleration of reference and joint."""

import math
from typing import NamedTuple, Protocol

from pam_orthosis.control.reference import Reference
from pam_orthosis.model.parameters import Parameters


class Sample(NamedTuple):
    """What a law is asked at.

    Attributes:
        position, velocity: of the joint, rad or m.
        room: least and largest acceleration that the actuators can give.
        periods: since the last sample.
    """

    position: float
    velocity: float
    reference: Reference
    room: tuple[float, float]
    periods: int = 1


class Law(Protocol):
    """A law with its memory."""

    def begin(self, position: float, velocity: float, held: float) -> None:
        """Begin anew at a joint that the acceleration `held` keeps in its place, by the nominal weight."""

    def step(self, now: Sample) -> float:
        """Return the asked acceleration, within the room."""


class Pid:
    """PID, the classical law, whose integral stands still while its output is cut and would be cut further.

    Astrom and Hagglund, "PID Controllers: Theory, Design, and Tuning", 2nd edition, Instrument Society of
    America 1995, chapter 3: integrator windup, conditional integration.
    """

    def __init__(self, nominal: Parameters):
        self._gains, self._period = nominal.control.pid, nominal.scenario.control_period
        self._integral = 0.0

    def begin(self, position: float, velocity: float, held: float) -> None:
        """Begin with an integral that holds the joint where it is."""
        self._integral = held

    def step(self, now: Sample) -> float:
        """Return the asked acceleration, within the room."""
        g, error = self._gains, now.reference.position - now.position
        wanted = now.reference.acceleration + self._integral
        wanted += g.proportional * error + g.derivative * (now.reference.velocity - now.velocity)
        given = min(max(wanted, now.room[0]), now.room[1])
        growth = g.integral * error * now.periods * self._period
        if growth * (wanted - given) <= 0:
            self._integral += growth
        return float(given)


class ProxySlidingMode:
    """Proxy-based sliding mode: as a PID for small errors, slow and without overshoot after large ones.

    A massless proxy is led to the reference by a sliding mode of bounded force, and draws the joint by the
    PID of `control.pid`. While the bound is not reached the proxy slides on `error + time * rate = 0`; else
    it falls behind with the joint, so that nothing winds up. Kikuuwe and Fujimoto, "Proxy-based sliding
    mode control for accurate and safe position control", ICRA 2006; IEEE Transactions on Robotics 26(4),
    2010, page 670: "a safer extension of PID position control". Both conditions are met at the end of each
    period (implicit Euler), which needs no switching.
    """

    def __init__(self, nominal: Parameters):
        self._pid, self._settings = nominal.control.pid, nominal.control.proxy_sliding_mode
        self._period = nominal.scenario.control_period
        self._gap = self._integral = 0.0  # proxy less joint; the PID's integral part

    def begin(self, position: float, velocity: float, held: float) -> None:
        """Begin with the proxy at the joint and an integral that holds it there."""
        self._gap, self._integral = 0.0, held

    def step(self, now: Sample) -> float:
        """Return the asked acceleration, within the room."""
        g, s, time = self._pid, self._settings, now.periods * self._period
        wanted = now.reference
        ahead = wanted.position - now.position + s.time * (wanted.velocity - now.velocity)
        sliding = (time * ahead + s.time * self._gap) / (time + s.time)
        stiffness = g.proportional + g.integral * time + g.derivative / time
        rest = self._integral - g.derivative / time * self._gap
        least, most = (max(-s.limit, end - wanted.acceleration) for end in now.room)
        pull = min(max(stiffness * sliding + rest, least), most, s.limit)
        self._gap = (pull - rest) / stiffness
        self._integral += g.integral * time * self._gap
        return float(wanted.acceleration + pull)


class Adrc:
    """Active disturbance rejection: what differs from a double integrator is estimated as one and cancelled.

    Han, "From PID to active disturbance rejection control", IEEE Transactions on Industrial Electronics
    56(3), 2009, 900-906; linear, with one bandwidth each for law and extended state observer (Gao, "Scaling
    and bandwidth-parameterization based controller tuning", American Control Conference 2003); the observer
    corrects by the present sample, its three poles in discrete time (Miklosovic, Radke and Gao, "Discrete
    implementation and generalization of the extended state observer", the same conference, 2006).
    """

    def __init__(self, nominal: Parameters):
        settings, self._period = nominal.control.adrc, nominal.scenario.control_period
        self._bandwidth = settings.bandwidth
        pole = math.exp(-settings.observer_bandwidth * self._period)
        self._gains = (
            1 - pole**3,
            1.5 * (1 - pole) ** 2 * (1 + pole) / self._period,
            (1 - pole) ** 3 / self._period**2,
        )
        self._state = (0.0, 0.0, 0.0)  # position, velocity, acceleration that nobody asked for
        self._given = 0.0

    def begin(self, position: float, velocity: float, held: float) -> None:
        """Begin with the disturbance that a held joint has."""
        self._state, self._given = (position, velocity, -held), held

    def step(self, now: Sample) -> float:
        """Return the asked acceleration, within the room; the velocity is estimated."""
        place, rate, outside = self._observed(now.position, now.periods)
        w = self._bandwidth
        wanted = now.reference.acceleration - outside
        wanted += w**2 * (now.reference.position - place) + 2 * w * (now.reference.velocity - rate)
        self._given = float(min(max(wanted, now.room[0]), now.room[1]))
        return self._given

    def _observed(self, position: float, periods: int) -> tuple[float, float, float]:
        place, rate, outside = self._state
        time, acceleration = periods * self._period, outside + self._given
        place += time * (rate + 0.5 * time * acceleration)
        rate += time * acceleration
        missed = position - place
        first, second, third = (gain * missed for gain in self._gains)
        self._state = place + first, rate + second, outside + third
        return self._state
