# SPDX-License-Identifier: Apache-2.0
"""Back to the reference after a release: wait until the joint rests, raise the pressures, lead it there.

A released joint is somewhere. It is tried again when it rests and both actuators answer a small pressure,
which they do not while something else keeps them vented (an emergency stop, a lost supply).
"""

from pam_orthosis.control import guard
from pam_orthosis.control.reference import PressureReference, Pressures, Reference, Valve
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.shapes import quintic

STEEPEST = 1.875  # slope of the quintic step at its middle


class Release:
    """Both actuators are vented until the joint rests; then the lowest reference pressure is asked for.

    `asked` is the pressure to ask for, absolute Pa. `held_empty` says that they did not answer
    when they were last asked: something else vents them.
    """

    def __init__(self, nominal: Parameters):
        self._nominal, self.held_empty = nominal, False
        self._ambient: float = nominal.valve.ambient_pressure
        self._lowest: float = nominal.control.position.minimum_pressure
        self._empty, self._slow = empty_below(nominal), nominal.control.guard.return_speed
        self.asked, self._rests, self._silent = self._rest()

    def step(self, pressures: Pressures, velocity: float, periods: int) -> bool:
        """Take a sample; return whether the joint rests and both actuators answer.

        One whose sensor is blind would be filled for ever: it is asked for a moment only, and again.
        """
        if self.asked == self._ambient:
            if self._rests.step(max(pressures) < self._empty and abs(velocity) < self._slow, periods):
                self.asked = self._lowest
            return False
        answered = min(pressures) > self._empty
        self.held_empty = self._silent.step(not answered, periods)
        if self.held_empty:
            self.asked, self._rests, self._silent = self._rest()
        return answered

    def _rest(self) -> tuple[float, guard.Overdue, guard.Overdue]:
        """Return the pressure to ask for, what notices that the joint rests, and that nothing answers."""
        g, nominal = self._nominal.control.guard, self._nominal
        return self._ambient, guard.overdue(g.rest_time, nominal), guard.overdue(g.pressure_time, nominal)


def empty_below(nominal: Parameters) -> float:
    """Return the absolute pressure, Pa, below which an actuator is empty: no controller goes there."""
    ambient: float = nominal.valve.ambient_pressure
    lowest: float = nominal.control.position.minimum_pressure
    return 0.5 * (ambient + lowest)


def vented(pressures: Pressures, nominal: Parameters) -> bool:
    """Whether both actuators are empty."""
    return max(pressures) < empty_below(nominal)


class Return:
    """The way back: pressures rise where the joint is, then a smooth path leads from there to the reference.

    The path is `a + w (r - a)` from the place `a` at which it begins to the moving reference `r`, with a
    quintic step `w` from 0 to 1. Its speed differs from `w` times that of the reference by
    `control.guard.return_speed` at most.
    """

    def __init__(self, pressures: Pressures, nominal: Parameters):
        g, self._period = nominal.control.guard, nominal.scenario.control_period
        low, high = nominal.valve.ambient_pressure, nominal.control.position.maximum_pressure
        self._begun = tuple(min(max(p, low), high) for p in pressures)
        self._rise_time, self._speed = g.rise_time, g.return_speed
        self._least = g.return_speed * g.rise_time / STEEPEST  # shorter ways take no less time
        self._raised = self._share = 0.0
        self._start: float | None = None

    @property
    def over(self) -> bool:
        """Whether the reference is reached."""
        return self._share >= 1.0

    def reference(self, position: float, wanted: Reference, periods: int) -> Reference:
        """Return what to follow in this sample: the joint's own place at first, then the path."""
        time = periods * self._period
        if self._start is None:
            self._raised = min(self._raised + time / self._rise_time, 1.0)
            if self._raised == 1.0:
                self._start = position
            return Reference(position, 0.0, 0.0, wanted.mean_pressure, beside=wanted.beside)
        return self._on_path(self._start, wanted, time)

    def pressures(
        self, asked: tuple[PressureReference, PressureReference]
    ) -> tuple[PressureReference, PressureReference]:
        """Return what to ask for: it rises from the pressures at the beginning to what the law asks for."""
        share = quintic(self._raised)[0]
        first, second = (
            p if p is Valve.CLOSED or share == 1.0 else b + share * (p - b)
            for b, p in zip(self._begun, asked, strict=True)
        )
        return first, second

    def _on_path(self, start: float, wanted: Reference, time: float) -> Reference:
        way, rate = wanted.position - start, wanted.velocity
        length = max(abs(way), self._least)
        growth = 0.0 if length == self._least else (rate if way > 0 else -rate)
        pace = self._speed / (STEEPEST * length)
        slowing = -pace * growth / length
        self._share = min(self._share + time * pace, 1.0)
        w, slope, bend = quintic(self._share)
        return Reference(
            start + w * way,
            slope * pace * way + w * rate,
            (bend * pace**2 + slope * slowing) * way + 2 * slope * pace * rate + w * wanted.acceleration,
            wanted.mean_pressure,
            beside=wanted.beside,
        )
