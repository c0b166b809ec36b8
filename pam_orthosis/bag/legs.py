# SPDX-License-Identifier: Apache-2.0
"""Which legs a bag holds."""

from __future__ import annotations

from pathlib import Path

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from pam_orthosis.bag.topics import BY_NAME

TELLING, LED = "joint_states", "reference"


def namespaces(path: Path) -> list[str]:
    """Return the namespaces of the legs in a bag, sorted; `[""]` for one leg in none.

    A leg is where there are joint states with a reference, or, if there is no reference anywhere, joint
    states. A bag that cannot be read, or holds none, is taken for one leg in no namespace: whoever reads its
    signals tells what is wrong with it.
    """
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            topics = {name: _namespaces(reader, name) for name in (TELLING, LED)}
    except Exception:  # a damaged file makes the readers raise anything
        return [""]
    return sorted(topics[TELLING] & topics[LED] or topics[TELLING]) or [""]


def _namespaces(reader: AnyReader, name: str) -> set[str]:
    """Return where a topic of the table is, by its name and type."""
    kind = BY_NAME[name].type
    topics = {one.topic for one in reader.connections if one.msgtype == kind}
    return {topic[: -len(name) - 1] for topic in topics if topic.endswith(f"/{name}")}
