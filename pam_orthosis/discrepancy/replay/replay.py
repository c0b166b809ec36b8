# SPDX-License-Identifier: Apache-2.0
"""Replay of recordings by a system's model with chosen effects on; residuals and their derivatives."""

import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import replace
from threading import Lock
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from pam_orthosis.discrepancy.replay.kernel import Kernel
from pam_orthosis.discrepancy.replay.lanes import WARM_SECONDS, Lanes
from pam_orthosis.discrepancy.replay.run import Run, Shift
from pam_orthosis.discrepancy.replay.store import Store
from pam_orthosis.discrepancy.systems.cut import Part, cut, divided
from pam_orthosis.discrepancy.systems.system import Assembled, Equation, Names, System, Values
from pam_orthosis.discrepancy.workers import Workers
from pam_orthosis.progress import Progress, silent

STEP_TIMES_RATE = 1.4  # longest Runge-Kutta step times the fastest eigenvalue (stable up to 2.78), and
EXACT, FEW = 0.7, 4  # the same where so many steps do: a lag of the valve is followed to 0.1 %
MOST_SUBSTEPS = 64
PROBED = 6  # samples of each kind at which the fastest eigenvalue is looked for
REMEMBERED, PREPARED = 144, 36  # results; recordings as kernels read them, an equation and a shift each
_CASADI = Lock()  # expression graphs are built by one thread at a time


class Replay:
    """Replays runs of one system; kernels are built when they are first needed, and kept.

    Args:
        workers: the cores that it may use (all).
    """

    def __init__(self, system: System, workers: Workers | None = None):
        self.system, self.workers = system, workers or Workers()
        self._nominal = Shift(inputs=system.late)
        self._parts: dict[tuple[str, tuple[str, ...]], tuple[Part, ...]] = {}
        self._kernels: dict[Hashable, Kernel] = {}
        self._touched: dict[str, frozenset[str]] = {}
        self._memory: Store[np.ndarray] = Store(REMEMBERED)
        self._data: Store[Lanes] = Store(PREPARED)
        self._latest: tuple[tuple[str, ...], Assembled, Assembled] | None = None
        self._shared: set[tuple[str, Hashable]] = set()
        effects = system.bare().catalogue.values()  # those that the model has already among them
        self._scales = {n: s for one in effects for n, s in zip(one.states, one.scales, strict=False)}

    def defaults(self, effects: Names) -> dict[str, float]:
        """Return all parameters at their neutral or typical values: calibrations, shapes, effects."""
        values = {one.name: 0.0 for one in self.system.calibrations}
        values.update(
            (f"{name}.{q.name}", 0.0)
            for name in self.system.shapes
            for q in self.system.catalogue[name].parameters
        )
        for name in set(effects) - set(self.system.shapes):
            values.update((f"{name}.{q.name}", q.typical) for q in self.system.catalogue[name].parameters)
        return values

    def touched(self, effect: str) -> frozenset[str]:
        """Return the equations that an effect changes."""
        if effect not in self._touched:
            effects = self.system.shapes if effect in self.system.shapes else (*self.system.shapes, effect)
            self._touched[effect] = frozenset(
                equation.name
                for equation in self.system.equations
                if any(name.startswith(f"{effect}.") for name in _parameters(self._cut(equation, effects)))
            )
        return self._touched[effect]

    def touching(self, names: Iterable[str], progress: Progress = silent) -> list[str]:
        """Return those effects that change something."""
        every = list(names)
        new = [name for name in every if name not in self._touched]
        self.workers.forked(self.touched, new, self, progress, "taking the effects into the equations")
        return [name for name in every if self.touched(name)]

    def news(self) -> dict[str, dict[Hashable, Any]]:
        """Return what was built since the last call: see `together.Memory`."""
        kept: dict[str, Any] = {
            "_parts": self._parts,
            "_touched": self._touched,
            "_kernels": self._kernels,
        }
        new = {
            name: {key: one for key, one in store.items() if (name, key) not in self._shared}
            for name, store in kept.items()
        }
        self._shared |= {(name, key) for name, store in new.items() for key in store}
        new["_kernels"] = {key: one for key, one in new["_kernels"].items() if one.built}
        return new

    def learn(self, news: Mapping[str, Mapping[Hashable, Any]]) -> None:
        """Take what another process has built."""
        for name, store in news.items():
            known = getattr(self, name)
            for key, one in store.items():
                known.setdefault(key, one)

    def residuals(
        self, run: Run, equation: Equation, effects: Names, values: Values, parts: Sequence[Part] = ()
    ) -> np.ndarray:
        """Return recorded minus predicted, (n, channels of some of an equation's parts: of all)."""
        return self._evaluate(run, equation, parts or self.parts(equation, effects), effects, values, ())

    def sensitivities(
        self,
        run: Run,
        equation: Equation,
        effects: Names,
        values: Values,
        wrt: Names,
        parts: Sequence[Part] = (),
    ) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
        """Return residuals (n, c), their derivatives (n, c, k), and the k parameters of `wrt` that matter.

        A parameter by which neighbouring signals are advanced is not differentiated through that.
        """
        parts = parts or self.parts(equation, effects)
        known = _parameters(parts)
        names = tuple(name for name in wrt if name in known)
        if not names:
            residuals = self._evaluate(run, equation, parts, effects, values, ())
            return residuals, np.zeros((*residuals.shape, 0)), ()
        every = self._with_details(names, known)
        both = self._evaluate(run, equation, parts, effects, values, every)
        slopes = both.T[[1 + every.index(name) for name in names]].T  # columns stay in one piece
        return both[:, :, 0], slopes, names

    def _with_details(self, names: Names, known: set[str]) -> tuple[str, ...]:
        """Return parameters and all details of their effects: one kernel, whether these are free or not."""
        effects = {name.partition(".")[0] for name in names} & {*self.system.catalogue}
        own = (f"{one}.{q.name}" for one in effects for q in self.system.catalogue[one].parameters)
        return tuple(sorted({*names, *known.intersection(own)}))

    def parts(self, equation: Equation, effects: Names) -> tuple[Part, ...]:
        """Return the parts of an equation that do not feel each other."""
        others = sorted(set(effects) - set(self.system.shapes))
        touching = [name for name in others if equation.name in self.touched(name)]
        kept = (name for name in touching if not self.shifts(name, equation, effects))
        return self._cut(equation, (*self.system.shapes, *kept))

    def part(self, equation: Equation, channel: str) -> Part:
        """Return the part of an equation, without effects, that predicts a channel."""
        return next(part for part in self.parts(equation, ()) if channel in part.channels)

    def forget(self, run: Run) -> None:
        """Drop what is remembered of a run."""
        self._memory.forget(run.serial)
        self._data.forget(run.serial)

    def shifts(self, name: str, equation: Equation, effects: Names) -> bool:
        """Return whether one of several effects enters an equation as a shift of recorded signals alone.

        A delay is exact so. It is not possible for one of several channels that feel each other.
        """
        effect = self.system.catalogue[name]
        if effect.late is not None:
            return equation.name in self.touched(name)
        if effect.advance is None:
            return False
        typical = SimpleNamespace(**{q.name: q.typical for q in effect.parameters})
        moved = set(effect.advance(typical)) & set(equation.channels)
        if len(equation.channels) == 1 or not moved:
            return True
        parts = self._cut(equation, self._inside(equation, effects))
        return all(len(part.channels) == 1 for part in parts if moved & set(part.channels))

    def _evaluate(
        self,
        run: Run,
        equation: Equation,
        parts: Sequence[Part],
        effects: Names,
        values: Values,
        wrt: Names,
    ) -> np.ndarray:
        """Return residuals (n, channels), with `wrt` (n, channels, 1 + len(wrt)): the derivatives behind."""
        shifts = [self._shift(equation, part, effects, values) for part in parts]
        if len(parts) == 1:
            return self._evaluate_part(run, equation, parts[0], values, shifts[0], wrt)
        shape = (run.recording.samples, len(equation.channels))
        joined = np.zeros((*shape, 1 + len(wrt)) if wrt else shape, order="F")
        for part, shift in zip(parts, shifts, strict=True):
            names = tuple(name for name in wrt if name in part.parameters)
            result = self._evaluate_part(run, equation, part, values, shift, names)
            columns = [0, *(1 + wrt.index(name) for name in names)]
            for i, channel in enumerate(part.channels):
                row = equation.channels.index(channel)
                if wrt:
                    joined[:, row, columns] = result[:, i].reshape(len(joined), -1)
                else:
                    joined[:, row] = result[:, i]
        return joined

    def _evaluate_part(
        self, run: Run, equation: Equation, part: Part, values: Values, shift: Shift, wrt: Names
    ) -> np.ndarray:
        theta = np.array([values[name] for name in part.parameters])
        key = (run.serial, part.channels, part.parameters, wrt, theta.tobytes(), shift.key())
        known = self._memory.get(key)
        if known is not None:
            return known
        kernel = self._kernel(part, wrt)
        data = self._rows(run, part, shift)
        # the base states of most models are slow; states of an effect need not be
        fast = equation.stiff or not set(part.own) <= set(equation.states)
        substeps = self._substeps(run, part, data, theta) if fast else 1
        result = kernel(data, theta, run.states(part, data.starts), run.period, substeps)
        return result if wrt else self._memory.keep(key, result)

    def _rows(self, run: Run, part: Part, shift: Shift) -> Lanes:
        # seen by an own channel that is on time, all channels are alike
        key = (run.serial, part.channels if shift.own else (), shift.key())
        known = self._data.get(key)
        if known is not None:
            return known
        rows = Lanes.cut(run.data(part.channels, shift), round(WARM_SECONDS / run.period))
        return self._data.keep(key, rows)

    def _shift(self, equation: Equation, part: Part, effects: Names, values: Values) -> Shift:
        """Return how what a part of an equation sees is shifted; it does not see other parts."""
        advance: dict[str, float] = {}
        later = {**self.system.later}
        own, late = 0.0, self.system.late
        for name in effects:
            if not self.shifts(name, equation, effects):
                continue
            effect, values_of = self.system.catalogue[name], self._own_values(name, values)
            delay = 0.0 if effect.late is None else effect.late(values_of)
            if effect.late_of:
                later[effect.late_of] = later.get(effect.late_of, 0.0) + delay
            else:
                late += delay
            for channel, seconds in (effect.advance(values_of) if effect.advance else {}).items():
                if channel in part.channels:
                    own += seconds
                elif channel not in equation.channels:
                    advance[channel] = advance.get(channel, 0.0) + seconds
        return Shift(own, own + late, advance, later)

    def _own_values(self, name: str, values: Values) -> SimpleNamespace:
        parameters = self.system.catalogue[name].parameters
        return SimpleNamespace(**{q.name: values[f"{name}.{q.name}"] for q in parameters})

    def _inside(self, equation: Equation, effects: Names) -> Names:
        """Return the effects that are in an equation's model in any case: no shifts, and no delays."""
        others, catalogue = sorted(set(effects) - set(self.system.shapes)), self.system.catalogue
        inside = [n for n in others if catalogue[n].advance is None and catalogue[n].late is None]
        return (*self.system.shapes, *(n for n in inside if equation.name in self.touched(n)))

    def _cut(self, equation: Equation, effects: Names) -> tuple[Part, ...]:
        key = (equation.name, effects)
        if key not in self._parts:
            with _CASADI:
                whole, static = self._assembled(effects)
                pieces = divided(self.system, whole, equation)
                self._parts[key] = tuple(cut(self.system, whole, static, piece) for piece in pieces)
        return self._parts[key]

    def _assembled(self, effects: Names) -> tuple[Assembled, Assembled]:
        """Return the assembly with effects on, and the same without lagging sensors."""
        if self._latest is None or self._latest[0] != effects:
            whole = static = self.system.assemble(effects)
            rest = tuple(name for name in effects if self.system.catalogue[name].advance is None)
            if rest != effects:
                static = _with_theta_of(whole, self.system.assemble(rest))
            self._latest = effects, whole, static
        return self._latest[1], self._latest[2]

    def _kernel(self, part: Part, wrt: Names) -> Kernel:
        key = (part.channels, part.parameters, wrt)
        if key not in self._kernels:
            with _CASADI:
                kernel = Kernel(part, wrt)
            kernel.build()
            self._kernels[key] = kernel
        return self._kernels[key]

    def _substeps(self, run: Run, part: Part, data: Lanes, theta: np.ndarray) -> int:
        """Return the steps a period that the fastest state needs.

        Looked for with effect states at rest and deflected, and at standstill, where friction is stiffest.
        """
        places = run.probing(PROBED)
        rest = run.states(part, places)
        deflected = np.array([self._scales.get(name, 0.0) for name in part.own])
        still = rest * [name not in self.system.derived for name in part.own]
        states = np.concatenate([rest, rest + deflected, rest - deflected, still])
        with _CASADI:  # the first call for so many rows builds a graph
            fastest = part.fastest(np.tile(data.at(places), (4, 1)), theta, states, run.period)
        needed = run.period * fastest / STEP_TIMES_RATE
        needed *= STEP_TIMES_RATE / EXACT if needed <= FEW else 1.0
        return min(max(1, math.ceil(needed)), MOST_SUBSTEPS) if math.isfinite(needed) else 1


def _parameters(parts: Iterable[Part]) -> set[str]:
    return {name for part in parts for name in part.parameters}


def _with_theta_of(whole: Assembled, rest: Assembled) -> Assembled:
    """Return the assembly `rest` in terms of the parameters of `whole`."""
    chosen = ca.vertcat(*(whole.theta[whole.parameters.index(name)] for name in rest.parameters))
    names = list(rest.measured)
    expressions = ca.substitute(
        [rest.rates, *(rest.measured[name] for name in names)], [rest.theta], [chosen]
    )
    return replace(
        rest,
        theta=whole.theta,
        parameters=whole.parameters,
        rates=expressions[0],
        measured=dict(zip(names, expressions[1:], strict=True)),
    )
