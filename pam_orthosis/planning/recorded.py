# SPDX-License-Identifier: Apache-2.0
"""What a recorded run shows by the phase of the cycle: the effort that the model missed, the cycle made."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pam_orthosis.bag.read import Bag, aligned, read_bag, recorded_machine
from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.errors import OrthosisError, naming
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.rules import FARTHEST_PLAN

HARMONICS = 12

Series = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Recorded:
    """What came again in each cycle of a run, as functions of the phases (n,), 0 where the motion starts.

    Attributes:
        missing: in the model: torque or force in the direction of the coordinate. It is what the observer
            found, Eq. (29), with its lag: the controllers will meet it with that lag again.
        position: coordinate, rad or m.
        pressures: absolute, Pa.
        followed: coordinate that was to be followed.
        planned: whether that was a plan's, which the actuators can make, and not the wanted one.
    """

    missing: Series
    position: Series
    pressures: tuple[Series, ...]
    followed: Series
    planned: bool


def recorded_in(path: Path, parameters: Parameters, namespace: str = "") -> Recorded:
    """Return what `recorded` does of the run in a bag, with or without a plan.

    Args:
        path: bag of a run of the scenario that is to be planned, by the same model.
        parameters: of what is to be planned.
        namespace: of the leg, e.g. `/left`.

    Raises:
        OrthosisError: the bag is unusable, of another motion or model, or has no whole cycle at full cadence.
    """
    machine, of_bag = parameters.declared, recorded_machine(path)
    if of_bag.text != machine.text:
        raise OrthosisError(f"{path} is of another machine ({of_bag.name}, planned is {machine.name})")
    reference, needed = f"reference_{machine.coordinate.name}", _needed(machine)
    bag = read_bag(path, needed, namespace=namespace)
    _check_model(bag, parameters)
    stamps, values = aligned(*(bag[name] for name in needed))
    signals = dict(zip(needed, values, strict=True))
    time = (stamps - bag[reference].stamp_ns[0]) / SECOND_NS
    _check_motion(bag, parameters, time, signals[reference])
    with naming(path):
        return recorded(time, signals, parameters)


def recorded(time: np.ndarray, signals: Mapping[str, np.ndarray], parameters: Parameters) -> Recorded:
    """Return what comes again in each cycle at full cadence.

    Args:
        time: (n,) since the start of the run, s.
        signals: (n,) each: of the coordinate the reference, what was followed and what was measured; measured
            pressures, Pa; `disturbance`, tau of Eq. (26).
        parameters: of the run.

    Raises:
        OrthosisError: no whole cycle at full cadence, or the machine was far from the wanted motion there.
    """
    scenario = parameters.scenario
    steady = time >= scenario.start_hold + scenario.start_ramp
    if not steady.any() or np.ptp(time[steady]) < scenario.cycle_time:
        raise OrthosisError("no whole cycle at full cadence; record a longer run")
    q, names = parameters.declared.coordinate.name, parameters.declared.names
    reference, followed = signals[f"reference_{q}"], signals[f"followed_{q}"]
    _check_near(parameters, np.abs(reference - signals[q])[steady].max())
    phase = (time[steady] - scenario.start_hold - 0.5 * scenario.start_ramp) / scenario.cycle_time
    there = np.sort(phase % 1.0)
    if max(np.diff(there, append=there[0] + 1.0)) > 0.5 / HARMONICS:
        raise OrthosisError("no whole cycle at full cadence: part of each is missing; record another run")
    waves = _waves(phase)

    def series(values: np.ndarray) -> Series:
        found, *_ = np.linalg.lstsq(waves, values[steady], rcond=None)
        return lambda phase: _waves(phase) @ found

    pressures = tuple(series(signals[f"{name}_pressure"]) for name in names)
    planned = bool(np.any(followed != reference))
    return Recorded(series(-signals["disturbance"]), series(signals[q]), pressures, series(followed), planned)


def _needed(machine: Machine) -> list[str]:
    q = machine.coordinate.name
    return [f"reference_{q}", "disturbance", *machine.channels, f"followed_{q}"]


def _waves(phase: np.ndarray) -> np.ndarray:
    """Return the constant, cosines and sines at phases (n,), as columns."""
    at = 2 * np.pi * np.outer(phase, np.arange(HARMONICS + 1))
    return np.hstack([np.cos(at), np.sin(at[:, 1:])])


def _check_near(parameters: Parameters, away: float) -> None:
    if away >= FARTHEST_PLAN:
        machine = parameters.declared
        what = f"the {machine.name} was {machine.coordinate.shown(away, '.0f')} away from the wanted motion"
        raise OrthosisError(f"{what}: record a run with a plan that was made without --after")


def _check_motion(bag: Bag, parameters: Parameters, time: np.ndarray, reference: np.ndarray) -> None:
    trajectory = make_trajectory(parameters)
    wanted = np.array([trajectory.sample(round(each * SECOND_NS)).position for each in time])
    away = float(np.abs(wanted - reference).max())
    same_motion = 1.0e-3  # rad or m
    if away > same_motion:
        what = f"shows another motion, {parameters.declared.coordinate.shown(away, '.1f')} away"
        raise OrthosisError(f"{bag.path} {what}: record a run of the scenario that is to be planned")


def _check_model(bag: Bag, parameters: Parameters) -> None:
    """Refuse a run by another model: what that one missed this one may have."""
    now = parameters.nominal().flat()
    for key, then in bag.parameters.items():  # a foreign recorder records none
        if not key.startswith("scenario.") and key in now and now[key] != then:
            what = f"{key} was {then}, is {now[key]}"
            raise OrthosisError(f"{bag.path} is of another model: {what}; give it by --model or --param")
