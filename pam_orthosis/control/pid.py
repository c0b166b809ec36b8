# SPDX-License-Identifier: Apache-2.0
"""PID, the classical law, whose integral stands still while its output is cut.

Astrom and Hagglund, "PID Controllers: Theory, Design, and Tuning", 2nd edition, Instrument Society of America
1995, chapter 3: integrator windup, conditional integration.
"""

from pam_orthosis.control.reference import Reference
from pam_orthosis.model.parameters import Parameters


class Integral:
    """An integral that stands still while its output is cut and would be cut further."""

    def __init__(self, value: float = 0.0):
        self.value = value

    def add(self, amount: float, cut: float) -> None:
        """Add, unless that goes on in the direction of what was cut off (wanted - possible)."""
        if amount * cut <= 0:
            self.value += amount


class Pid:
    """A law of `control.position.controller`, see `peers.Law`."""

    def __init__(self, nominal: Parameters):
        self._gains, self._period = nominal.control.pid, nominal.scenario.control_period
        self._integral = Integral()

    def begin(self, position: float, velocity: float, held: float) -> None:
        """Begin with an integral that holds the joint where it is."""
        self._integral = Integral(held)

    def step(
        self,
        position: float,
        velocity: float,
        reference: Reference,
        room: tuple[float, float],
        periods: int,
    ) -> float:
        """Return the asked acceleration, within the room."""
        g, error = self._gains, reference.position - position
        wanted = reference.acceleration + self._integral.value
        wanted += g.proportional * error + g.derivative * (reference.velocity - velocity)
        given = min(max(wanted, room[0]), room[1])
        self._integral.add(g.integral * error * periods * self._period, wanted - given)
        return float(given)
