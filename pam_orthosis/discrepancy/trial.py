# SPDX-License-Identifier: Apache-2.0
"""One effect beside the present model: where to start from, and what its parameters leave."""

from __future__ import annotations

import numpy as np
from scipy.signal import find_peaks

from pam_orthosis.discrepancy.free import of_effect
from pam_orthosis.discrepancy.projection import Projection

QUARTERS = (0.0, 1.57, 3.14, -1.57)  # rad: phases at which a periodic effect starts
LOWEST_PEAK, HIGHEST_PEAK, MOST_PEAKS = 0.1, 20.0, 3  # Hz: where its frequency is looked for
NEAR = 0.01  # of the way from the off value to the typical one


class Trial:
    """One effect beside the present model: residuals by its parameters, everything else projected."""

    def __init__(self, projection: Projection, name: str):
        problem = projection.problem
        self.projection, self.name = projection, name
        self.effects = (*projection.base.effects, name)
        lags = problem.system.catalogue[name].advance is not None
        touched = problem.replay.touched(name)
        self.equations = [e for e in problem.system.equations if lags or e.name in touched]
        self.free = of_effect(problem.system, name)
        self.scale = np.array([one.scale for one in self.free])
        typical = problem.replay.defaults((name,))
        self._rest = {key: value for key, value in typical.items() if key.startswith(f"{name}.")}

    def values(self, position: np.ndarray, ordinary: np.ndarray | None = None) -> dict[str, float]:
        """Return all parameters at scaled positions of its own and of the ordinary ones (of the base)."""
        own = {one.name: float(x * s) for one, x, s in zip(self.free, position, self.scale, strict=True)}
        rest = {} if ordinary is None else self.projection.values(ordinary)
        return {**self.projection.base.values, **rest, **self._rest, **own}

    def residuals(self, position: np.ndarray, ordinary: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Return whitened residuals: of the equations that change."""
        values, problem = self.values(position, ordinary), self.projection.problem
        equations = self.equations if ordinary is None else problem.system.equations
        with np.errstate(all="ignore"):
            return {e.name: problem.residual(e, self.effects, values) for e in equations}

    def starts(self) -> list[np.ndarray]:
        """Return the scaled start positions: typical values and the effect's other starts."""
        effect = self.projection.problem.system.catalogue[self.name]
        first = {q.name: q.typical for q in effect.fitted}
        positions = [first, *({**first, **other} for other in effect.starts)]
        if "frequency" in first and any(q.unit == "Hz" for q in effect.fitted):
            positions += [{**first, "frequency": f, "phase": phi} for f in self._peaks() for phi in QUARTERS]
        size = effect.fitted[0]
        if size.neutral is not None and not effect.states:
            # a signature near the off value too: far from it what resembles an ordinary parameter bends
            near = size.neutral + NEAR * (size.typical - size.neutral)
            positions.append({**first, size.name: near})
        return [np.array([p[q.name] for q in effect.fitted]) / self.scale for p in positions]

    def _peaks(self) -> list[float]:
        """Return the frequencies, Hz, at which the residuals of its equations are largest."""
        problem, found = self.projection.problem, []
        for equation in self.equations:
            one = max(problem.scored, key=lambda scored: scored.run.recording.samples)
            values = self.projection.base.values
            raw = problem.replay.residuals(one.run, equation, self.projection.base.effects, values)[:, 0]
            white = one.white(equation.channels[0], raw)
            power = np.abs(np.fft.rfft(white * np.hanning(len(white)), 4 * len(white))) ** 2
            frequency = np.fft.rfftfreq(4 * len(white), one.run.period)
            inside = (frequency > LOWEST_PEAK) & (frequency < HIGHEST_PEAK)
            peaks = find_peaks(np.where(inside, power, 0.0))[0]
            found += frequency[peaks[np.argsort(power[peaks])[::-1][:MOST_PEAKS]]].tolist()
        return found

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the scaled bounds."""
        return (
            np.array([one.lower for one in self.free]) / self.scale,
            np.array([one.upper for one in self.free]) / self.scale,
        )
