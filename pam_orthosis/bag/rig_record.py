# SPDX-License-Identifier: Apache-2.0
"""Record runs of the test rig as bags; no ROS needed."""

from collections.abc import Iterable
from pathlib import Path

from pam_orthosis.bag.arrays import by_topic, template
from pam_orthosis.bag.record import RIG_EFFECTS, BagWriter, run_metadata
from pam_orthosis.bag.rig_topics import MUSCLES, NAMESPACE, RIG_SIGNALS
from pam_orthosis.bag.topics import resolve
from pam_orthosis.control.rig_loop import RigSample
from pam_orthosis.model.components.spool import spool_position
from pam_orthosis.model.parameters import Parameters, Section


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
    topics = by_topic(RIG_SIGNALS.values())
    templates = {topic: template(members, "load_cell") for topic, members in topics.items()}
    count = 0
    with BagWriter(folder, run) as writer:
        for topic, members in topics.items():
            writer.add_topic(resolve(topic), members[0].type)
        for index, sample in enumerate(samples):
            if index % every and sample.cylinder is None:
                continue
            numbers = _numbers(sample, parameters.valve)
            for topic, members in topics.items():
                if values := [numbers[one.name] for one in members if one.name in numbers]:
                    writer.write(resolve(topic), sample.time_ns, templates[topic](sample.time_ns, *values))
            count += 1
    return count


def _numbers(s: RigSample, valve: Section) -> dict[str, float]:
    """Return signal -> number; without a reading of the calliper if it was not put on."""
    voltages = (spool_position(voltage, valve) for voltage in s.voltages)
    truth = s.truth._asdict()
    motion = ("reference_position", "reference_velocity", "reference_acceleration")
    known = {
        "position": s.measured.position,
        "pressure": s.measured.specimen_pressure,
        "positioner_pressure": s.measured.positioner_pressure,
        "force": s.measured.force,
        **{f"truth_{name}": number for name, number in truth.items()},
        "truth_force": truth["specimen_force"],
        **dict(zip(motion, s.reference[:3], strict=True)),
        "pressure_reference": s.pressure_reference,
        "estimate_position": s.estimate.position,
        "estimate_velocity": s.estimate.velocity,
        **{f"{name}_mass_flow": flow for name, flow in zip(MUSCLES, s.flows, strict=True)},
        **dict(zip(("voltage", "positioner_voltage"), voltages, strict=True)),
    }
    if s.cylinder is not None:
        known |= {"diameter": s.cylinder.diameter, "cylinder_length": s.cylinder.length}
    return {f"{NAMESPACE}_{name}": number for name, number in known.items()}
