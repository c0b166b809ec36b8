# SPDX-License-Identifier: Apache-2.0
"""Record runs of the test rig as bags; no ROS needed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from pam_orthosis.bag.messages import (
    fluid_pressure,
    header,
    joint_state,
    new,
    serialised,
    trajectory,
    vector,
)
from pam_orthosis.bag.record import RIG_EFFECTS, BagWriter, run_metadata
from pam_orthosis.bag.rig_topics import NAMESPACE, RIG_TOPICS
from pam_orthosis.bag.topics import WRENCH, resolve
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
                writer.write(resolve(name), sample.time_ns, serialised(message.__msgtype__, message))
            count += 1
    return count


def _messages(s: RigSample) -> Iterator[tuple[str, Any]]:
    """Yield topic name and message, in the order of the table."""
    t, truth = s.time_ns, s.truth
    rows = [
        ("joint_states", joint_state(t, [CARRIAGE], position=[s.measured.position])),
        ("specimen/pressure", fluid_pressure(t, "specimen", s.measured.specimen_pressure)),
        ("positioner/pressure", fluid_pressure(t, "positioner", s.measured.positioner_pressure)),
        ("specimen/force", _force(t, s.measured.force)),
    ]
    if s.cylinder is not None:
        rows.append(("specimen/cylinder", joint_state(t, ["diameter", "length"], position=s.cylinder)))
    rows += [
        ("truth", _truth(t, truth)),
        ("reference", _reference(t, s.reference)),
        ("specimen/pressure_reference", fluid_pressure(t, "specimen", s.pressure_reference)),
        ("estimate", joint_state(t, [CARRIAGE], [s.estimate.position], [s.estimate.velocity])),
    ]
    for muscle, flow in zip(("specimen", "positioner"), s.flows, strict=True):
        rows.append((f"{muscle}/mass_flow", joint_state(t, [f"{muscle}_valve"], velocity=[flow])))
    for muscle, voltage in zip(("specimen", "positioner"), s.voltages, strict=True):
        rows.append((f"{muscle}/valve_voltage", joint_state(t, [f"{muscle}_valve"], effort=[voltage])))
    return ((f"{NAMESPACE}/{name}", message) for name, message in rows)


def _force(time_ns: int, force: float) -> Any:
    wrench = new(
        "geometry_msgs/msg/Wrench",
        force=vector((force, 0.0, 0.0)),
        torque=vector((0.0, 0.0, 0.0)),
    )
    return new(WRENCH, header=header(time_ns, "load_cell"), wrench=wrench)


def _reference(time_ns: int, reference: CarriageReference) -> Any:
    names = ("positions", "velocities", "accelerations")
    return trajectory(time_ns, CARRIAGE, dict(zip(names, reference[:3], strict=True)))


def _truth(time_ns: int, truth: RigTruth) -> Any:
    names = [CARRIAGE, "specimen", "positioner", "specimen_gas", "positioner_gas"]
    position = [truth.position, 0.0, 0.0, 0.0, 0.0]
    velocity = [truth.velocity, 0.0, 0.0, truth.specimen_flow, truth.positioner_flow]
    forces = [truth.specimen_force, truth.positioner_force]
    pressures = [truth.specimen_pressure, truth.positioner_pressure]
    return joint_state(time_ns, names, position, velocity, [0.0, *forces, *pressures])
