# SPDX-License-Identifier: Apache-2.0
"""What a recorded run shows by the phase of the gait: the torque that the model missed, the cycle made."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pam_orthosis.bag.read import Bag, aligned, read_bag
from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.control.trajectory import Trajectory, make_trajectory
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.rules import FARTHEST_PLAN

HARMONICS = 12
SAME_MOTION = 1.0e-3  # rad

Series = Callable[[np.ndarray], np.ndarray]
MOTION = ("angle", "extensor_pressure", "flexor_pressure", "followed_angle")
NEEDED = ("reference_angle", "disturbance", *MOTION)


@dataclass(frozen=True)
class Recorded:
    """What came again in each cycle of a run, as functions of the phases (n,), 0 where the motion starts.

    Attributes:
        missing: in the model: torque, N m in the direction of flexion. It is what the observer found,
            Eq. (29), with its lag: the controllers will meet it with that lag again.
        angle: of the knee, rad.
        extensor_pressure, flexor_pressure: absolute, Pa.
        followed_angle: that the knee was to follow, rad.
        planned: whether that was a plan's, which muscles can make, and not the wanted one.
    """

    missing: Series
    angle: Series
    extensor_pressure: Series
    flexor_pressure: Series
    followed_angle: Series
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
    bag = read_bag(path, NEEDED, namespace=namespace)
    _check_model(bag, parameters)
    stamps, values = aligned(*(bag[name] for name in NEEDED))
    signals = dict(zip(NEEDED, values, strict=True))
    time = (stamps - bag["reference_angle"].stamp_ns[0]) / SECOND_NS
    _check_motion(bag, make_trajectory(parameters), time, signals["reference_angle"])
    try:
        return recorded(time, signals, parameters)
    except OrthosisError as error:
        raise OrthosisError(f"{path}: {error}") from error


def recorded(time: np.ndarray, signals: Mapping[str, np.ndarray], parameters: Parameters) -> Recorded:
    """Return what comes again in each cycle at full cadence.

    Args:
        time: (n,) since the start of the run, s.
        signals: (n,) each: `reference_angle`, `followed_angle` and measured `angle`, rad, measured
            pressures, Pa, and `disturbance`, tau of Eq. (26), N m.
        parameters: of the run.

    Raises:
        OrthosisError: no whole cycle at full cadence, or the knee was far from the wanted motion there.
    """
    scenario = parameters.scenario
    steady = time >= scenario.start_hold + scenario.start_ramp
    if not steady.any() or np.ptp(time[steady]) < scenario.cycle_time:
        raise OrthosisError("no whole cycle at full cadence; record a longer run")
    _check_near(np.abs(signals["reference_angle"] - signals["angle"])[steady].max())
    phase = (time[steady] - scenario.start_hold - 0.5 * scenario.start_ramp) / scenario.cycle_time
    there = np.sort(phase % 1.0)
    if max(np.diff(there, append=there[0] + 1.0)) > 0.5 / HARMONICS:
        raise OrthosisError("no whole cycle at full cadence: part of each is missing; record another run")
    waves = _waves(phase)

    def series(values: np.ndarray) -> Series:
        found, *_ = np.linalg.lstsq(waves, values[steady], rcond=None)
        return lambda phase: _waves(phase) @ found

    planned = bool(np.any(signals["followed_angle"] != signals["reference_angle"]))
    return Recorded(series(-signals["disturbance"]), *(series(signals[name]) for name in MOTION), planned)


def _waves(phase: np.ndarray) -> np.ndarray:
    """Return the constant, cosines and sines at phases (n,), as columns."""
    at = 2 * np.pi * np.outer(phase, np.arange(HARMONICS + 1))
    return np.hstack([np.cos(at), np.sin(at[:, 1:])])


def _check_near(away: float) -> None:
    if away >= FARTHEST_PLAN:
        what = f"the knee was {np.degrees(away):.0f} deg away from the wanted motion"
        raise OrthosisError(f"{what}: record a run with a plan that was made without --after")


def _check_motion(bag: Bag, trajectory: Trajectory, time: np.ndarray, angle: np.ndarray) -> None:
    wanted = np.array([trajectory.sample(round(each * SECOND_NS)).angle for each in time])
    away = float(np.abs(wanted - angle).max())
    if away > SAME_MOTION:
        what = f"shows another motion, {np.degrees(away):.1f} deg away"
        raise OrthosisError(f"{bag.path} {what}: record a run of the scenario that is to be planned")


def _check_model(bag: Bag, parameters: Parameters) -> None:
    """Refuse a run by another model: what that one missed this one may have."""
    now = parameters.belief().flat()
    for key, then in bag.parameters.items():  # a foreign recorder records none
        if not key.startswith("scenario.") and key in now and now[key] != then:
            what = f"{key} was {then}, is {now[key]}"
            raise OrthosisError(f"{bag.path} is of another model: {what}; give it by --model or --param")
