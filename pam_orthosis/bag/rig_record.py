# SPDX-License-Identifier: Apache-2.0
"""Record runs of the test rig as bags; no ROS needed."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from pam_orthosis.bag.messages import (
    fluid_pressure,
    header,
    joint_state,
    mass_flow,
    new,
    serialised,
    trajectory,
    vector,
)
from pam_orthosis.bag.record import RIG_EFFECTS, BagWriter, run_metadata
from pam_orthosis.bag.rig_topics import MUSCLES, NAMESPACE, RIG_TOPICS
from pam_orthosis.bag.topics import WRENCH, resolve
from pam_orthosis.control.linearisation import CarriageReference
from pam_orthosis.control.rig_loop import RigSample
from pam_orthosis.model.components.spool import spool_position
from pam_orthosis.model.parameters import Parameters, Section
from pam_orthosis.model.rig import RigTruth

CARRIAGE, UNKNOWN = "carriage", float("nan")


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
        samples: of the run.
        every: keep one sample in so many, and each that has a calliper reading.
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
            for name, message in _messages(sample, parameters.valve):
                writer.write(resolve(name), sample.time_ns, serialised(message.__msgtype__, message))
            count += 1
    return count


def _messages(s: RigSample, valve: Section) -> Iterator[tuple[str, Any]]:
    """Yield topic name and message, in the order of the table."""
    t = s.time_ns
    rows = [
        ("joint_states", joint_state(t, [CARRIAGE], position=[s.measured.position])),
        ("specimen/pressure", fluid_pressure(t, "specimen", s.measured.specimen_pressure)),
        ("positioner/pressure", fluid_pressure(t, "positioner", s.measured.positioner_pressure)),
        ("specimen/force", _force(t, s.measured.force)),
    ]
    if s.cylinder is not None:
        rows.append(("specimen/cylinder", joint_state(t, ["diameter", "length"], position=s.cylinder)))
    rows += [
        *_truth(t, s.truth),
        ("reference", _reference(t, s.reference)),
        ("specimen/pressure_reference", fluid_pressure(t, "specimen", s.pressure_reference)),
        ("estimate", joint_state(t, [CARRIAGE], [s.estimate.position], [s.estimate.velocity])),
    ]
    for muscle, flow in zip(MUSCLES, s.flows, strict=True):
        rows.append((f"{muscle}/mass_flow", mass_flow(t, muscle, flow)))
    for muscle, voltage in zip(MUSCLES, s.voltages, strict=True):
        spool = spool_position(voltage, valve)
        rows.append((f"{muscle}/valve_command", joint_state(t, [f"{muscle}_valve"], position=[spool])))
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


def _truth(t: int, truth: RigTruth) -> Iterator[tuple[str, Any]]:
    position, velocity = ([one, UNKNOWN, UNKNOWN] for one in (truth.position, truth.velocity))
    forces = [UNKNOWN, truth.specimen_force, truth.positioner_force]
    yield "truth", joint_state(t, [CARRIAGE, *MUSCLES], position, velocity, forces)
    for muscle in MUSCLES:
        yield f"truth/{muscle}/pressure", fluid_pressure(t, muscle, getattr(truth, f"{muscle}_pressure"))
    for muscle in MUSCLES:
        yield f"truth/{muscle}/mass_flow", mass_flow(t, muscle, getattr(truth, f"{muscle}_flow"))
