# SPDX-License-Identifier: Apache-2.0
"""How the time of the gap workflow and of identification grows with the recording and the catalogue.

The recording shows a knee at 500 Hz, moved up and down by its valves, of hardware that is nominal but for
friction in the joint; its last quarter judges. Kernels are compiled before, as they are from the
second run on a machine on. It is processor time of all threads, which others on the machine disturb less than
the time on the wall; that is told for a minute recorded.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pam_orthosis.bag.rig_record import record_rig
from pam_orthosis.control.rig_loop import Rig, force_procedure
from pam_orthosis.discrepancy.recordings.data import Recording, from_arrays
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.systems.knee import knee
from pam_orthosis.discrepancy.systems.system import System
from pam_orthosis.discrepancy.workflow import find_gap
from pam_orthosis.identification.data import Data, Samples, read_data
from pam_orthosis.identification.identify import identify
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import Parameters, load
from pam_orthosis.model.plant import quantised
from pam_orthosis.model.study import MEASURED, Study
from speed.curves import GAP_CATALOGUE, GAP_LENGTH, IDENTIFICATION, told
from speed.rows import Goal, Row, row

HIDDEN = "joint_friction"
AS_BELIEVED = {
    **{f"plant.effects.{name}.enabled": name == HIDDEN for name in KNEE.catalogue},
    **{f"plant.deviation.{name}": 1.0 for name in vars(load().plant.deviation) if not name.startswith("_")},
    "plant.muscle_law": "polynomial",
    "plant.simulation.step": 5e-4,
    "valve.dead_band": 0.0,
    "scenario.control_period": 0.002,
}  # fmt: skip
LENGTHS = (15, 30, 60, 150, 300, 600)  # s
AMPLITUDES, FREQUENCIES = (0.6, 0.4, 0.3), (0.31, 0.83, 2.1)  # V, Hz
WITH_CATALOGUE = 20  # s
SHARES = (0.25, 0.5, 0.75, 1.0)  # of the catalogue
PRESSURES = (2e5, 3.5e5, 5e5, 7e5)  # Pa absolute, of the rig's runs
TIMES = (1, 3, 10, 30)  # the rig's samples
MINUTE = 60
UNIT = "processor s"
IN_TIME = Goal("<= 60 s", at_most=60.0)
LINEAR = Goal("linear: <= 1.2", at_most=1.2)


class Spent(NamedTuple):
    """Seconds by the clock on the wall, and of all threads on all cores."""

    wall: float
    processor: float


def rows(repeats: int) -> Iterator[Row]:
    """Yield the rows of the group; long recordings are taken once, whatever `repeats` says."""
    parameters = load(AS_BELIEVED)
    system = knee(parameters)
    recording = from_arrays("moved", system, moved(parameters, max(LENGTHS)))
    replay = Replay(system)
    timed = partial(_gap, system, replay, parameters)
    timed(_first(recording, min(LENGTHS)))  # compiled
    yield from _lengths(timed, recording, repeats)
    yield from _catalogue(parameters, system, _first(recording, WITH_CATALOGUE))
    yield from _identification(repeats)


def moved(parameters: Parameters, seconds: float) -> dict[str, np.ndarray]:
    """Return a recording: noisy, quantised angle and pressures, and the valves' voltages."""
    period, sensor = parameters.scenario.control_period, parameters.plant.sensor
    time_ = np.arange(round(seconds / period)) * period
    waves = zip(AMPLITUDES, FREQUENCIES, strict=True)
    wave = sum(
        volts * np.sin(2 * np.pi * (hertz * time_[:, None] + np.array([0, 0.35]))) for volts, hertz in waves
    )
    voltages = parameters.valve.closed_voltage + wave
    told = Study(parameters, ()).simulate(np.empty((1, 0)), voltages, 1)
    noise, steps = np.random.default_rng(1), (sensor.angle_resolution, *[sensor.pressure_resolution] * 2)
    shown = {}
    for name, sd, step in zip(
        MEASURED, (sensor.angle_noise, *[sensor.pressure_noise] * 2), steps, strict=True
    ):
        noisy = told[name][0] + sd * noise.standard_normal(len(time_))
        shown[name.removeprefix("measured_")] = np.array([quantised(value, step) for value in noisy])
    extensor, flexor = voltages.T
    return {"time": time_, **shown, "extensor_voltage": extensor, "flexor_voltage": flexor}


def _lengths(timed, recording: Recording, repeats: int) -> Iterator[Row]:
    spent = {s: [timed(_first(recording, s)) for _ in range(_fewer(repeats, s))] for s in LENGTHS}
    found = {s: [one.processor for one in taken] for s, taken in spent.items()}
    for seconds, times in found.items():
        yield row("scaling", told(GAP_LENGTH, seconds), UNIT, times)
    what = f"gap workflow, {MINUTE} s recorded, by the clock on the wall"
    yield row("scaling", what, "s", [one.wall for one in spent[MINUTE]], goal=IN_TIME)
    yield _growth("gap workflow", "s recorded", found)


def _catalogue(parameters: Parameters, system: System, recording: Recording) -> Iterator[Row]:
    shapes, names = set(system.shapes), [HIDDEN, *(n for n in system.candidates if n != HIDDEN)]
    for share in SHARES:
        kept = shapes | set(names[: round(share * len(names))])
        smaller = replace(system, catalogue={n: e for n, e in system.catalogue.items() if n in kept})
        replay = Replay(smaller)
        _gap(smaller, replay, parameters, recording)
        spent = _gap(smaller, replay, parameters, recording)
        yield row("scaling", told(GAP_CATALOGUE, len(kept)), UNIT, [spent.processor])


def _identification(repeats: int) -> Iterator[Row]:
    data, found = _rig_data(), {}
    for times in TIMES:
        longer = replace(data, samples=_repeated(data.samples, times))
        found[len(longer.samples)] = [_spent(partial(identify, longer)).processor for _ in range(repeats)]
    for samples, seconds in found.items():
        yield row("scaling", told(IDENTIFICATION, samples), UNIT, seconds)
    yield _growth("identification", "samples", found)


def _growth(what: str, unit: str, found: Mapping[float, list[float]]) -> Row:
    """Return the row that compares the time per size of the largest with that of the middle."""
    middle, largest = sorted(found)[len(found) // 2 - 1], max(found)
    per_size = [[float(np.median(found[size])) / size * 1e3] for size in (largest, middle)]
    words = f"{what}: time per size, {largest:g} {unit} beside {middle:g}"
    return row("scaling", words, "processor ms", *per_size, goal=LINEAR)


def _gap(system: System, replay: Replay, parameters: Parameters, recording: Recording) -> Spent:
    def work():
        outcome = find_gap(system, [recording], [], parameters.gap, replay=replay)
        assert outcome.effects[0].name == HIDDEN, "a search that finds nothing is no measure"

    return _spent(work)


def _first(recording: Recording, seconds: float) -> Recording:
    return recording.part(0, round(seconds / recording.period), f"the first {seconds:g} s")


def _fewer(repeats: int, seconds: float) -> int:
    return repeats if seconds <= MINUTE else 1


def _rig_data() -> Data:
    parameters = load()
    with tempfile.TemporaryDirectory(prefix="pam-orthosis-bench-") as folder:
        for seed, pressure in enumerate(PRESSURES):
            samples = list(force_procedure(Rig(parameters, "dmsp_20", seed), pressure))
            record_rig(Path(folder, f"force-{seed}"), parameters, "dmsp_20", "force", samples, 1)
        return read_data([Path(folder)])


def _repeated(samples: Samples, times: int) -> Samples:
    """Return the samples of as many procedures, each with noise of its own."""
    noise = np.random.default_rng(1).standard_normal((times, len(samples)))
    many = {name: np.tile(values, times) for name, values in vars(samples).items()}
    many["force"] = many["force"] + many["sigma"] * noise.ravel()
    runs = samples.serial.max() + 1
    many["serial"] = many["serial"] + runs * np.repeat(np.arange(times), len(samples))
    return Samples(**many)


def _spent(work: Callable[[], object]) -> Spent:
    wall, processor = time.monotonic(), _processor()
    work()
    return Spent(time.monotonic() - wall, _processor() - processor)


def _processor() -> float:
    """Return the processor time of this process and of those that it has waited for, s."""
    return sum(os.times()[:4])
