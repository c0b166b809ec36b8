# SPDX-License-Identifier: Apache-2.0
"""Which legs a bag holds."""

from __future__ import annotations

from pathlib import Path

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from pam_orthosis.bag.topics import BY_NAME

TELLING = "joint_states"


def namespaces(path: Path) -> list[str]:
    """Return the namespaces of the legs in a bag, sorted; `[""]` for one leg in none.

    A leg is where there are joint states. A bag that cannot be read, or holds none, is taken for one
    leg in no namespace: whoever reads its signals tells what is wrong with it.
    """
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            topics = {one.topic for one in reader.connections if one.msgtype == BY_NAME[TELLING].type}
    except Exception:  # a damaged file makes the readers raise anything
        return [""]
    found = sorted(topic[: -len(TELLING) - 1] for topic in topics if topic.endswith(f"/{TELLING}"))
    return found or [""]
