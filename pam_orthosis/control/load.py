# SPDX-License-Identifier: Apache-2.0
"""Whether a sole's cushions can press with the share of the body's weight that is asked for."""

import math

import casadi as ca
import numpy as np

from pam_orthosis.control.axis import Axis
from pam_orthosis.control.position import second_of_mean
from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.mechanisms import Sole
from pam_orthosis.model.parameters import Parameters

SHOWN = 1000  # the largest share is given in these parts, rounded down


def check_load(parameters: Parameters) -> None:
    """Raise OrthosisError if a cushion would need more than its highest pressure; it names the largest share.

    Pressures are those of the reference at rest in each instant of a stride at the full cadence. Their
    distance from those at rest is proportional to the share.
    """
    mechanism = parameters.declared.mechanism(parameters)
    if not isinstance(mechanism, Sole):
        return
    settings, own = parameters.control.position, mechanism.parameters
    resting = _pressures(parameters, [(parameters.at(parameters.declared.start), settings.mean_pressure)])
    rise = _pressures(parameters, _stride(parameters)) - resting
    high = settings.maximum_pressure - parameters.valve.ambient_pressure
    possible = own.share * float(np.min((high - resting) / np.maximum(rise, 1.0)))
    if possible < own.share:
        cushions = Axis(parameters.nominal()).actuators
        worst = int(np.argmax((rise + resting).max(axis=0)))
        asked, limit = (float(cushions[worst].force(0.0, p)) for p in ((rise + resting).max(), high))
        raise OrthosisError(
            f"machine.mechanism.share = {own.share:g} of {own.body_mass:g} kg asks for {asked:.0f} N,"
            f" control.position.maximum_pressure allows {limit:.0f} N:"
            f" give a share of {math.floor(SHOWN * possible) / SHOWN:g} at most"
        )


def _stride(parameters: Parameters) -> list[tuple[float, float]]:
    """Return pitch and mean pressure over a stride, once the run has its full cadence."""
    s, trajectory = parameters.scenario, make_trajectory(parameters)
    begin = s.start_hold + s.start_ramp
    samples = 400  # of a stride
    times = begin + s.cycle_time * np.arange(samples) / samples
    asked = [trajectory.sample(round(time * 1e9)) for time in times]
    mean = parameters.control.position.mean_pressure
    return [
        ((one.planned or one)[0], one.mean_pressure if isinstance(one.mean_pressure, float) else mean)
        for one in asked
    ]


def _pressures(parameters: Parameters, asked: list[tuple[float, float]]) -> np.ndarray:
    """Return the gauge pressures of both cushions that hold pitches at mean pressures, Pa, unlimited."""
    axis = Axis(parameters.nominal())
    q, mean = ca.SX.sym("q"), ca.SX.sym("mean")
    _, arm = axis.lever(q)
    area, _, _ = axis.forces(q, 0, (mean, mean))
    second = second_of_mean(axis.terms(q, 0).gravity / arm, mean, area)
    law = ca.Function("asked", [q, mean], [ca.horzcat(2 * mean - second, second)])
    gauge = [(place, pressure - parameters.valve.ambient_pressure) for place, pressure in asked]
    return np.array([law(*one).full().ravel() for one in gauge])
