# SPDX-License-Identifier: Apache-2.0
"""Back to the reference after a release: wait until the knee rests, raise the pressures, lead it there.

A released knee hangs somewhere. It is tried again when it rests and both muscles answer a small pressure,
which they do not while something else keeps them vented (an emergency stop, a lost supply).
"""

from __future__ import annotations

from pam_orthosis.control import guard
from pam_orthosis.control.trajectory import Reference

STEEPEST = 1.875  # slope of the quintic step at its middle


class Release:
    """Both muscles are vented until the knee rests; then the lowest reference pressure is asked for.

    `asked` is the pressure to ask for, absolute Pa. `held_empty` tells that the muscles did not answer
    when they were last asked: something else vents them.
    """

    def __init__(self, belief):
        g, self._ambient = belief.control.guard, belief.valve.ambient_pressure
        self._lowest = belief.control.position.minimum_pressure
        self._empty, self._slow = empty_below(belief), g.return_speed
        self._belief, self.held_empty = belief, False
        self._rest()

    def step(self, pressures: tuple[float, float], velocity: float, periods: int) -> bool:
        """Take a sample; return whether the knee rests and both muscles answer.

        A muscle whose sensor is blind would be filled for ever: it is asked for a moment only, and again.
        """
        if self.asked == self._ambient:
            if self._rests.step(max(pressures) < self._empty and abs(velocity) < self._slow, periods):
                self.asked = self._lowest
            return False
        answered = min(pressures) > self._empty
        self.held_empty = self._silent.step(not answered, periods)
        if self.held_empty:
            self._rest()
        return answered

    def _rest(self) -> None:
        g = self._belief.control.guard
        self.asked = self._ambient
        self._rests = guard.overdue(g.rest_time, self._belief)
        self._silent = guard.overdue(g.pressure_time, self._belief)


def empty_below(belief) -> float:
    """Return the absolute pressure, Pa, below which a muscle is empty: no controller lets it fall so low."""
    return 0.5 * (belief.valve.ambient_pressure + belief.control.position.minimum_pressure)


def vented(pressures: tuple[float, float], belief) -> bool:
    """Whether both muscles are empty."""
    return max(pressures) < empty_below(belief)


class Return:
    """The way back: pressures rise where the knee is, then a smooth path leads from there to the reference.

    The path is `a + w (r - a)` from the angle `a` at which it begins to the moving reference `r`, with a
    quintic step `w` from 0 to 1. Its speed differs from `w` times that of the reference by
    `control.guard.return_speed` at most.
    """

    def __init__(self, pressures: tuple[float, float], belief):
        g, self._period = belief.control.guard, belief.scenario.control_period
        low, high = belief.valve.ambient_pressure, belief.control.position.maximum_pressure
        self._begun = tuple(min(max(p, low), high) for p in pressures)
        self._rise_time, self._speed = g.rise_time, g.return_speed
        self._least = g.return_speed * g.rise_time / STEEPEST  # shorter ways take no less time
        self._raised = self._share = 0.0
        self._start: float | None = None

    @property
    def over(self) -> bool:
        """Whether the reference is reached."""
        return self._share >= 1.0

    def reference(self, angle: float, wanted: Reference, periods: int) -> Reference:
        """Return what to follow in this sample: the knee's own place at first, then the path."""
        time = periods * self._period
        if self._start is None:
            self._raised = min(self._raised + time / self._rise_time, 1.0)
            if self._raised == 1.0:
                self._start = angle
            return Reference(angle, 0.0, 0.0, wanted.mean_pressure)
        return self._on_path(wanted, time)

    def pressures(self, asked: tuple[float, float]) -> list[float]:
        """Return what to ask for: it rises from the pressures at the beginning to what the law asks for."""
        share = _quintic(self._raised)[0]
        return [p if share == 1.0 else b + share * (p - b) for b, p in zip(self._begun, asked, strict=True)]

    def _on_path(self, wanted: Reference, time: float) -> Reference:
        way, rate = wanted.angle - self._start, wanted.velocity
        length = max(abs(way), self._least)
        growth = 0.0 if length == self._least else (rate if way > 0 else -rate)
        pace = self._speed / (STEEPEST * length)
        slowing = -pace * growth / length
        self._share = min(self._share + time * pace, 1.0)
        w, slope, bend = _quintic(self._share)
        return Reference(
            self._start + w * way,
            slope * pace * way + w * rate,
            (bend * pace**2 + slope * slowing) * way + 2 * slope * pace * rate + w * wanted.acceleration,
            wanted.mean_pressure,
        )


def _quintic(s: float) -> tuple[float, float, float]:
    """Return a step from 0 to 1 over 0 <= s <= 1 and its first two derivatives."""
    return s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2, 60 * s * (1 - s) * (1 - 2 * s)
