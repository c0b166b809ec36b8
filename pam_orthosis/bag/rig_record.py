# SPDX-License-Identifier: Apache-2.0
"""Record runs of the test rig as bags; no ROS needed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from pam_orthosis.bag.record import RIG_EFFECTS, BagWriter, run_metadata
from pam_orthosis.bag.rig_topics import NAMESPACE, RIG_TOPICS
from pam_orthosis.bag.topics import JOINT, SECOND_NS, resolve
from pam_orthosis.control.linearisation import CarriageReference
from pam_orthosis.control.rig_loop import RigSample
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.rig import RigTruth

CARRIAGE = "carriage"


def record_rig(
    folder: Path,
    parameters: Parameters,
    specimen: str,
    test: str,
    samples: Iterable[RigSample],
    every: int = 1,
) -> int:
    """Write samples of a rig run into a new bag; return how many.

    Args:
        folder: of the bag.
        parameters: the whole tree, kept in the bag's metadata.
        specimen: the investigated muscle.
        test: `force`, `volume` or `decay`; with the specimen it names the scenario of the bag.
        every: keep one sample in so many, and each that has a calliper reading.

    Raises:
        OrthosisError: the folder holds a bag or cannot be written.
    """
    run = run_metadata(parameters, f"rig-{specimen}-{test}", branches=RIG_EFFECTS)
    run |= {"specimen": specimen, "test": test}
    count = 0
    with BagWriter(folder, run) as writer:
        for topic in RIG_TOPICS:
            writer.add_topic(resolve(topic.name), topic.type)
        for index, sample in enumerate(samples):
            if index % every and sample.cylinder is None:
                continue
            for name, message in _messages(sample):
                writer.write(resolve(name), sample.time_ns, _serialised(message))
            count += 1
    return count


def _messages(s: RigSample) -> Iterator[tuple[str, object]]:
    """Yield topic name and message, in the order of the table."""
    t, truth = s.time_ns, s.truth
    rows = [
        ("joint_states", _joint(t, [CARRIAGE], position=[s.measured.position])),
        ("specimen/pressure", _pressure(t, "specimen", s.measured.specimen_pressure)),
        ("positioner/pressure", _pressure(t, "positioner", s.measured.positioner_pressure)),
        ("specimen/force", _force(t, s.measured.force)),
    ]
    if s.cylinder is not None:
        rows.append(("specimen/cylinder", _joint(t, ["diameter", "length"], position=s.cylinder)))
    rows += [
        ("truth", _truth(t, truth)),
        ("reference", _reference(t, s.reference)),
        ("specimen/pressure_reference", _pressure(t, "specimen", s.pressure_reference)),
        ("estimate", _joint(t, [CARRIAGE], [s.estimate.position], [s.estimate.velocity])),
    ]
    for muscle, flow in zip(("specimen", "positioner"), s.flows, strict=True):
        rows.append((f"{muscle}/mass_flow", _joint(t, [f"{muscle}_valve"], velocity=[flow])))
    for muscle, voltage in zip(("specimen", "positioner"), s.voltages, strict=True):
        rows.append((f"{muscle}/valve_voltage", _joint(t, [f"{muscle}_valve"], effort=[voltage])))
    return ((f"{NAMESPACE}/{name}", message) for name, message in rows)


@lru_cache(maxsize=1)
def _store() -> Typestore:
    return get_typestore(Stores.ROS2_JAZZY)


def _type(name: str) -> Any:
    return _store().types[name]


def _serialised(message: Any) -> bytes:
    return bytes(_store().serialize_cdr(message, message.__msgtype__))


def _header(time_ns: int, frame: str = "") -> Any:
    stamp = _type("builtin_interfaces/msg/Time")(time_ns // SECOND_NS, time_ns % SECOND_NS)
    return _type("std_msgs/msg/Header")(stamp, frame)


def _joint(
    time_ns: int,
    names: Sequence[str],
    position: Sequence[float] = (),
    velocity: Sequence[float] = (),
    effort: Sequence[float] = (),
) -> Any:
    arrays = (np.array(values, dtype=float) for values in (position, velocity, effort))
    return _type(JOINT)(_header(time_ns), list(names), *arrays)


def _pressure(time_ns: int, muscle: str, pressure: float) -> Any:
    return _type("sensor_msgs/msg/FluidPressure")(_header(time_ns, f"{muscle}_muscle"), pressure, 0.0)


def _force(time_ns: int, force: float) -> Any:
    vector = _type("geometry_msgs/msg/Vector3")
    wrench = _type("geometry_msgs/msg/Wrench")(vector(force, 0.0, 0.0), vector(0.0, 0.0, 0.0))
    return _type("geometry_msgs/msg/WrenchStamped")(_header(time_ns, "load_cell"), wrench)


def _reference(time_ns: int, reference: CarriageReference) -> Any:
    zero = _type("builtin_interfaces/msg/Duration")(0, 0)
    values = [np.array([value]) for value in reference[:3]]
    point = _type("trajectory_msgs/msg/JointTrajectoryPoint")(*values, np.array([]), zero)
    return _type("trajectory_msgs/msg/JointTrajectory")(_header(time_ns), [CARRIAGE], [point])


def _truth(time_ns: int, truth: RigTruth) -> Any:
    names = [CARRIAGE, "specimen", "positioner", "specimen_gas", "positioner_gas"]
    position = [truth.position, 0.0, 0.0, 0.0, 0.0]
    velocity = [truth.velocity, 0.0, 0.0, truth.specimen_flow, truth.positioner_flow]
    forces = [truth.specimen_force, truth.positioner_force]
    pressures = [truth.specimen_pressure, truth.positioner_pressure]
    return _joint(time_ns, names, position, velocity, [0.0, *forces, *pressures])
