# SPDX-License-Identifier: Apache-2.0
"""Legs that walk: the same orthosis twice, half a cycle apart, and the joints of a device."""

from collections.abc import Mapping
from typing import Any

from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.device import Device, of_joint
from pam_orthosis.model.parameters import Parameters, Section, load

PERIODIC = ("gait", "sine")


def differences(parameters: Parameters) -> dict[str, dict[str, Any]]:
    """Return by leg what differs from the parameters: none on the left.

    The right leg has noise of its own, and its cycle, if there is one, begins half a cycle later in
    the shape, at the position that the shape has there.
    """
    right: dict[str, Any] = {"scenario.seed": parameters.scenario.seed + 1}
    if parameters.scenario.trajectory in PERIODIC:
        right["scenario.start_phase"] = (parameters.scenario.start_phase + 0.5) % 1.0
        right[parameters.declared.start] = make_trajectory(parameters.changed(right)).sample(0).position
        if parameters.scenario.plan.enabled:
            right |= _half_a_cycle_later(parameters.scenario.plan)
    return {"left": {}, "right": right}


def _half_a_cycle_later(plan: Section) -> dict[str, list[float]]:
    """Return a plan, whose phase is that since the start, half a cycle later: odd harmonics change sign."""
    return {
        f"scenario.plan.{name}.{part}": [(-1) ** n * value for n, value in enumerate(getattr(series, part))]
        for name, series in (("angle", plan.angle), ("pressure", plan.pressure))
        for part in ("cosine", "sine")
    }


def device_parameters(device: Device, values: Mapping[str, Any]) -> dict[str, Parameters]:
    """Return the parameters of each joint by its namespace, the right side half a cycle ahead.

    `values` are of each joint that has the key; `ankle/KEY` is of one joint, on both sides.

    Raises:
        OrthosisError: no joint has a key, or a value is unusable.
    """
    joints = {name: load(_own(device, name, values), one) for name, one in device.joints.items()}
    for number, (name, one) in enumerate(joints.items()):  # each sensor has noise of its own
        joints[name] = one.changed({"scenario.seed": one.scenario.seed + len(device.sides) * number})
    known = {key for one in joints.values() for key in one.flat()}
    if lost := sorted({key.rpartition("/")[2] for key in values} - known):
        raise OrthosisError(f"no joint of the {device.name} has a parameter {lost[0]}")
    made: dict[str, Parameters] = {}
    for side in device.sides:
        there = {name: one.changed(differences(one).get(side, {})) for name, one in joints.items()}
        made |= {f"{side}/{name}".strip("/"): _beside(name, there) for name in there}
    return made


def _own(device: Device, name: str, values: Mapping[str, Any]) -> dict[str, Any]:
    known = load({}, device.joints[name]).flat()
    of_all = {key for key in values if "/" not in key}
    return {key: one for key, one in of_joint(name, values).items() if key in known or key not in of_all}


def _beside(name: str, joints: Mapping[str, Parameters]) -> Parameters:
    """Return a joint's parameters with the motion of its neighbour, which its cascade knows."""
    own = joints[name]
    if not own.declared.coupled:
        return own
    kind = own.declared.neighbour
    (other,) = [one for one in joints.values() if one.declared.kind == kind and one.declared.coupled]
    gait = other.scenario.gait
    known = {"start": other.at(other.declared.start), "cosine": gait.cosine, "sine": gait.sine}
    return own.changed({f"scenario.beside.{key}": value for key, value in known.items()})
