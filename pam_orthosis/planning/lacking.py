# SPDX-License-Identifier: Apache-2.0
"""What a recorded run shows of the torque that the controllers' model lacks, by the phase of the gait."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from pam_orthosis.bag.read import Bag, aligned, read_bag
from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.control.trajectory import Trajectory, make_trajectory
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Parameters

HARMONICS = 12
SAME_MOTION = 1.0e-3  # rad

Lacking = Callable[[np.ndarray], np.ndarray]


def lacking_in(path: Path, parameters: Parameters, namespace: str = "") -> Lacking:
    """Return what `lacking_torque` does of a recorded run, with or without a plan.

    Args:
        path: bag of a run of the scenario that is to be planned, by the same model.
        parameters: of what is to be planned.
        namespace: of the leg, e.g. `/left`.

    Raises:
        OrthosisError: the bag is unusable, of another motion or model, or has no whole cycle at full cadence.
    """
    bag = read_bag(path, ["reference_angle", "disturbance"], namespace=namespace)
    _check_model(bag, parameters)
    stamps, (angle, disturbance) = aligned(bag["reference_angle"], bag["disturbance"])
    time = (stamps - bag["reference_angle"].stamp_ns[0]) / SECOND_NS
    _check_motion(bag, make_trajectory(parameters), time, angle)
    try:
        return lacking_torque(time, disturbance, parameters)
    except OrthosisError as error:
        raise OrthosisError(f"{path}: {error}") from error


def lacking_torque(time: np.ndarray, disturbance: np.ndarray, parameters: Parameters) -> Lacking:
    """Return phases of the cycle -> torque that the model lacks, N m in the direction of flexion.

    It is what comes again in each cycle of the disturbance that the observer found, Eq. (29), with its lag:
    the controllers will meet it with that lag again. Phase 0 is where the motion starts.

    Args:
        time: (n,) since the start of the run, s.
        disturbance: (n,) torque tau of Eq. (26), N m.
        parameters: of the run.

    Raises:
        OrthosisError: no whole cycle at full cadence.
    """
    scenario = parameters.scenario
    steady = time >= scenario.start_hold + scenario.start_ramp
    if not steady.any() or np.ptp(time[steady]) < scenario.cycle_time:
        raise OrthosisError("no whole cycle at full cadence; record a longer run")
    phase = (time[steady] - scenario.start_hold - 0.5 * scenario.start_ramp) / scenario.cycle_time
    found, *_ = np.linalg.lstsq(_waves(phase), -disturbance[steady], rcond=None)
    return lambda phase: _waves(phase) @ found


def _waves(phase: np.ndarray) -> np.ndarray:
    """Return the constant, cosines and sines at phases (n,), as columns."""
    at = 2 * np.pi * np.outer(phase, np.arange(HARMONICS + 1))
    return np.hstack([np.cos(at), np.sin(at[:, 1:])])


def _check_motion(bag: Bag, trajectory: Trajectory, time: np.ndarray, angle: np.ndarray) -> None:
    wanted = np.array([trajectory.sample(round(each * SECOND_NS)).angle for each in time])
    away = float(np.abs(wanted - angle).max())
    if away > SAME_MOTION:
        what = f"shows another motion, {np.degrees(away):.1f} deg away"
        raise OrthosisError(f"{bag.path} {what}: record a run of the scenario that is to be planned")


def _check_model(bag: Bag, parameters: Parameters) -> None:
    """Refuse a run by another model: what that one lacked this one may have."""
    now = parameters.belief().flat()
    for key, then in bag.parameters.items():  # a foreign recorder tells none
        if not key.startswith("scenario.") and key in now and now[key] != then:
            what = f"{key} was {then}, is {now[key]}"
            raise OrthosisError(f"{bag.path} is of another model: {what}; give it by --model or --param")
