# SPDX-License-Identifier: Apache-2.0
"""Which legs, or joints of a device, a bag holds."""

from pathlib import Path

from rosbags.rosbag2 import Reader

from pam_orthosis.bag.bounded import open_bag
from pam_orthosis.bag.read import recorded_machine
from pam_orthosis.bag.topics import JOINT, MOTION, REFERENCE, SAMPLE, resolve
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.machine import Machine


def namespaces(path: Path) -> list[str]:
    """Return the namespaces of the legs in a bag, sorted; `[""]` for one leg in none.

    A leg is where there are joint states with a reference, or, if there is no reference anywhere, joint
    states. A bag that cannot be read, or holds none, is taken for one leg in no namespace: whoever reads its
    signals reports what is wrong with it.
    """
    try:
        with open_bag(path) as reader:
            there = _namespaces(reader, SAMPLE, JOINT)
            led = _namespaces(reader, REFERENCE, MOTION)
    except OrthosisError:
        return [""]
    return sorted(there & led or there) or [""]


def check_named(path: Path, namespace: str) -> None:
    """Raise OrthosisError, which names the legs in a bag, if it holds several and none of this name."""
    names = [one.strip("/") for one in namespaces(path)]
    if (len(names) > 1 or namespace) and names != [""] and namespace.strip("/") not in names:
        what = f"no {namespace.strip('/')}" if namespace else "several machines"
        raise OrthosisError(f"{path} holds {what}; give one by --namespace: {', '.join(names)}")


def joint_beside(path: Path, namespace: str, machine: Machine) -> tuple[str, str]:
    """Return topic and name of the joint that moves a coupled one, in the same leg of a bag."""
    leg = namespace.strip("/").rpartition("/")[0]
    beside = [name.strip("/") for name in namespaces(path) if name.strip("/").rpartition("/")[0] == leg]
    for name in beside:
        other = recorded_machine(path, name)
        if (other.coupled, other.kind) == (machine.coupled, machine.neighbour):
            return resolve(SAMPLE, name), other.name
    raise OrthosisError(f"{path} holds no {machine.neighbour}, which moves the {machine.name}")


def _namespaces(reader: Reader, name: str, kind: str) -> set[str]:
    """Return where a topic of the table is, by its name and type."""
    topics = {one.topic for one in reader.connections if one.msgtype == kind}
    return {topic[: -len(name) - 1] for topic in topics if topic.endswith(f"/{name}")}
