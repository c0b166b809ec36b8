# SPDX-License-Identifier: Apache-2.0
"""Faults of signals and of the hardware, injected between the emulated plant and the real controllers.

From an instant on a sensor, a command, a valve or the supply misbehaves. Judged are the true knee and
the true muscles: what leaves the inverse valve model, the pressures, the joint, and what the guards say.
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from pam_orthosis.control import guard
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model.parameters import load
from pam_orthosis.model.plant import Plant

QUICK = {"scenario.start_hold": 0.1, "scenario.start_ramp": 0.5, "scenario.control_period": 0.005}
SECONDS = 5.0
STOP_DEPTH = 0.12  # rad that the soft stops of the joint give way under all the muscles can do
PRESSURE_SLACK = 5e3  # Pa
SENSORS = {"angle": 0, "extensor pressure": 1, "flexor pressure": 2}


class Starved(Plant):
    """The plant without supply: air leaves, none comes; to take over from another plant."""

    def __init__(self, parameters, seed: int):
        ambient = parameters.valve.ambient_pressure
        super().__init__(parameters.substituted({"valve.supply_pressure": 1.001 * ambient}), seed)

    def _start(self, hardware, accelerate) -> np.ndarray:
        return np.zeros(len(self.states))

    def take_over(self, plant: Plant) -> None:
        """Go on from where another plant is."""
        self.state[:] = plant.state
        self.lines, self._index = plant.lines, plant._index


class FaultyPlant:
    """A plant that is healthy until an instant; `measured` and `commanded` then change what passes.

    Args:
        parameters, seed: of the plant.
        start: s.
        measured: (measurement, generator) -> measurement.
        commanded: (voltages, generator) -> voltages.
        starved: whether the supply is lost.
    """

    def __init__(
        self, parameters, seed: int, start: float, measured=None, commanded=None, starved: bool = False
    ):
        self._plant = Plant(parameters, seed)
        self.period_ns = self._plant.period_ns
        self._start = round(start * 1e9 / self.period_ns)
        self._measured, self._commanded = measured, commanded
        self._starved = Starved(parameters, seed) if starved else None
        self._rng = np.random.default_rng(seed)
        self._index = 0

    @property
    def broken(self) -> bool:
        """Whether the fault is there."""
        return self._index >= self._start

    def measure(self):
        """Return the readings of the sensors, faulty or not."""
        reading = self._plant.measure()
        return self._measured(reading, self._rng) if self.broken and self._measured else reading

    def advance(self, *voltages: float) -> None:
        """Let a period pass."""
        if self.broken and self._starved is not None and self._plant is not self._starved:
            self._starved.take_over(self._plant)
            self._plant = self._starved
        if self.broken and self._commanded:
            voltages = self._commanded(voltages, self._rng)
        self._plant.advance(*voltages)
        self._index += 1

    def truth(self):
        """Return the true state."""
        return self._plant.truth()


@dataclass(frozen=True)
class Fault:
    """A fault and the reaction that is promised: `hold`, `limited`, `vent`, or `none` where it is harmless.

    `make` returns what `FaultyPlant` takes beside its instant, for a sensor of `SENSORS` or a muscle.
    """

    name: str
    targets: tuple[str, ...]
    reaction: str
    make: Callable[[int], dict[str, Any]]


def _reading(change: Callable) -> Callable[[int], dict[str, Any]]:
    """Return a fault of one sensor: (value, memory, generator) -> value."""

    def make(place: int) -> dict[str, Any]:
        memory: list[float] = []

        def measured(reading, rng):
            values = list(reading)
            memory.append(values[place])
            values[place] = change(values[place], memory, rng)
            return reading._make(values)

        return {"measured": measured}

    return make


def _sometimes(value: float) -> Callable:
    return lambda v, memory, rng: value if rng.random() < 0.05 else v


def _late(samples: int) -> Callable:
    return lambda v, memory, rng: memory[max(0, len(memory) - 1 - samples)]


def _swapped(v, memory, rng):
    """Every second pair of samples comes in the wrong order."""
    return memory[-2] if len(memory) > 1 and len(memory) % 2 else v


def _stuck(voltage: float | None) -> Callable[[int], dict[str, Any]]:
    def make(place: int) -> dict[str, Any]:
        held: list[float] = []

        def commanded(voltages, rng):
            held.append(voltages[place])
            changed = list(voltages)
            changed[place] = held[0] if voltage is None else voltage
            return changed

        return {"commanded": commanded}

    return make


def _no_command(place: int) -> dict[str, Any]:
    """The valves' drive is cut: a valve without a drive goes to the vent, as hardware is built."""
    return {"commanded": lambda voltages, rng: (0.0, 0.0)}


ALL, PRESSURES, MUSCLES = tuple(SENSORS), tuple(SENSORS)[1:], ("extensor", "flexor")
FAULTS = (
    Fault("NaN now and then", ALL, "hold", _reading(_sometimes(math.nan))),
    Fault("NaN for good", ALL, "vent", _reading(lambda v, m, r: math.nan)),
    Fault("infinite for good", ALL, "vent", _reading(lambda v, m, r: math.inf)),
    Fault("spikes", ALL, "hold", _reading(_sometimes(1e6))),
    Fault("out of range for good", ALL, "vent", _reading(lambda v, m, r: -1e7)),
    Fault("unplugged: reads 0", PRESSURES, "vent", _reading(lambda v, m, r: 0.0)),
    Fault("unplugged: reads full scale", ALL, "vent", _reading(lambda v, m, r: 1e6)),
    Fault("frozen", ALL, "vent", _reading(lambda v, m, r: m[0])),
    Fault("stale by one sample", ALL, "none", _reading(_late(1))),
    Fault("stale by 50 ms", ("angle",), "any", _reading(_late(10))),
    Fault("out of order", ALL, "none", _reading(_swapped)),
    Fault("duplicated", ALL, "none", _reading(lambda v, m, r: m[(len(m) - 1) // 2 * 2])),
    Fault("jumps by 0.5 rad", ("angle",), "any", _reading(lambda v, m, r: v + 0.5)),
    Fault("reads 1 bar too much", PRESSURES, "any", _reading(lambda v, m, r: v + 1e5)),
    Fault("valve stuck where it is", MUSCLES, "any", _stuck(None)),
    Fault("valve stuck closed", MUSCLES, "any", _stuck(5.0)),
    Fault("valve stuck at fill", MUSCLES, "any", _stuck(10.0)),
    Fault("valve stuck at vent", MUSCLES, "vent", _stuck(0.0)),
    Fault("command lost", ("both valves",), "vent", _no_command),
    Fault("supply lost", ("supply",), "vent", lambda place: {"starved": True}),
)


def places() -> list[tuple[Fault, str, int]]:
    """Return each fault with each of its targets and the target's place."""
    order = {**SENSORS, "extensor": 0, "flexor": 1, "both valves": 0, "supply": 0}
    return [(fault, target, order[target]) for fault in FAULTS for target in fault.targets]


def suffer(fault: Fault, place: int, start: float, seed: int, **overrides: Any) -> dict[str, Any]:
    """Run the closed loop into a fault; return what happened to knee and muscles, and the reactions."""
    p = load({**QUICK, "scenario.seed": seed, **overrides})
    plant = FaultyPlant(p, seed, start, **fault.make(place))
    loop = ClosedLoop(p, seed, plant=plant)
    watched = Watched(plant)
    loop.plant = watched
    run = loop.run(round(SECONDS / p.scenario.control_period))
    voltages = np.concatenate([run["extensor_voltage"], run["flexor_voltage"]])
    return {
        "voltages_good": bool(
            np.isfinite(voltages).all()
            and voltages.min() >= p.valve.minimum_voltage
            and voltages.max() <= p.valve.maximum_voltage
        ),
        "highest_pressure": float(watched.pressure.max()),
        "lowest_pressure": float(watched.pressure.min()),
        "angle": (float(run["true_angle"].min()), float(run["true_angle"].max())),
        "fastest": float(np.abs(run["true_velocity"]).max()),
        "health": loop.health(),
    }


class Watched:
    """A plant whose true pressures are kept."""

    def __init__(self, plant):
        self._plant = plant
        self.period_ns = plant.period_ns
        self._seen: list[tuple[float, float]] = []

    def measure(self):
        """Pass the measurement on."""
        return self._plant.measure()

    def advance(self, *voltages: float) -> None:
        """Let a period pass."""
        self._plant.advance(*voltages)

    def truth(self):
        """Keep the pressures, pass the truth on."""
        truth = self._plant.truth()
        self._seen.append((truth.extensor_pressure, truth.flexor_pressure))
        return truth

    @property
    def pressure(self) -> np.ndarray:
        """True pressures, (n, 2) Pa."""
        return np.array(self._seen)


def reaction(health: dict[str, dict]) -> str:
    """Return the strongest reaction that the guards tell of, with its reason if it is the vent."""
    for name, each in health.items():
        if each["vent"] or each["vented_samples"]:
            return f"vent: {each['vent'] or 'for some time'} ({name})"
    for name, word in (("held_samples", "hold"), ("limited_samples", "limited")):
        if any(each[name] for each in health.values()):
            return word
    return "none"


def complaints(fault: Fault, outcome: dict[str, Any], parameters) -> list[str]:
    """Return what is wrong about an outcome."""
    joint, valve = parameters.leg.joint, parameters.valve
    low, high = outcome["angle"]
    reacted = reaction(outcome["health"]).split(":")[0]
    checks = {
        "a voltage is not finite or out of range": outcome["voltages_good"],
        f"pressure {outcome['highest_pressure']:.0f} Pa above the supply": (
            outcome["highest_pressure"] <= valve.supply_pressure + PRESSURE_SLACK
        ),
        f"knee from {low:.2f} to {high:.2f} rad": (
            joint.minimum - STOP_DEPTH <= low and high <= joint.maximum + STOP_DEPTH
        ),
        f"reaction {reacted}, promised {fault.reaction}": fault.reaction in (reacted, "any"),
    }
    return [words for words, good in checks.items() if not good]


def campaign(count: int, seed: int, only: Iterable[str] = ()) -> dict[str, list[dict[str, Any]]]:
    """Let each fault of each target happen at so many instants at random; return outcomes by fault."""
    rng, p = np.random.default_rng(seed), load(QUICK)
    told: dict[str, list[dict[str, Any]]] = {}
    for fault, target, place in places():
        for _ in range(0 if only and fault.name not in only else count):
            start, noise = float(rng.uniform(0.2, 4.0)), int(rng.integers(1, 1000))
            outcome = suffer(fault, place, start, noise)
            wrong = [f"{target} at {start:.2f} s: {words}" for words in complaints(fault, outcome, p)]
            told.setdefault(fault.name, []).append(outcome | {"target": target, "wrong": wrong})
            for words in wrong:
                print(f"{fault.name}: {words}", file=sys.stderr, flush=True)
    return told


def summary(outcomes: dict[str, list[dict[str, Any]]]) -> dict:
    """Return by fault: targets, promised and seen reactions, how often tried, extremes, what was wrong."""
    promised = {fault.name: fault.reaction for fault in FAULTS}
    return {
        name: {
            "targets": list(dict.fromkeys(each["target"] for each in mine)),
            "promised": promised[name],
            "tried": len(mine),
            "reactions": dict(Counter(reaction(each["health"]).split(":")[0] for each in mine)),
            "highest_pressure_bar": round(max(each["highest_pressure"] for each in mine) / 1e5, 2),
            "angle_deg": [
                round(math.degrees(min(each["angle"][0] for each in mine)), 1),
                round(math.degrees(max(each["angle"][1] for each in mine)), 1),
            ],
            "bad_voltages": sum(not each["voltages_good"] for each in mine),
            "wrong": [words for each in mine for words in each["wrong"]],
        }
        for name, mine in outcomes.items()
    }


# guard that is taken out -> the faults that have to find that it is missing
REMOVED = {
    "unusable samples": ("NaN now and then", "spikes"),
    "frozen signals": ("frozen",),
    "what does not follow": ("valve stuck at fill", "supply lost"),
}


@contextmanager
def without(name: str) -> Iterator[None]:
    """Take a guard out, on purpose."""
    owner, method, replacement = {
        "unusable samples": (guard.SignalGuard, "_fault", lambda self, value, periods: ""),
        "frozen signals": (guard.SignalGuard, "_watch_motion", lambda self, value, followed: None),
        "what does not follow": (guard.Overdue, "step", lambda self, holds: False),
    }[name]
    kept = getattr(owner, method)
    setattr(owner, method, replacement)
    try:
        yield
    finally:
        setattr(owner, method, kept)
