# SPDX-License-Identifier: Apache-2.0
"""What the relays of a graph pass round: the topics of each step of the knee, or of a device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from pam_orthosis.bag.topics import PLANT, RECORDER, Topic, Topics, asked_beside, in_leg
from pam_orthosis.control.legs import device_parameters
from pam_orthosis.model.device import device_named
from pam_orthosis.model.machines import KNEE


@lru_cache
def step_topics(graph: str) -> list[Topic]:
    """Return the topics of each step; those of a device, and their nodes, under full names."""
    device = device_named(Path(graph))
    if device is None:
        return [topic for topic in Topics(KNEE).of_run().values() if topic.rate == "step"]
    joints = device_parameters(device, {})
    return [
        replace(
            topic,
            name=in_leg(topic.name, leg, list(joints)),
            producers=_full(topic.producers, leg),
            consumers=_full(topic.consumers, leg),
        )
        for leg, own in joints.items()
        for topic in Topics(own.declared).of_run(beside=asked_beside(own)).values()
        if topic.rate == "step"
    ]


def _full(roles: Sequence[str], leg: str) -> tuple[str, ...]:
    return tuple(role if role == PLANT else f"{leg}/{role}" for role in roles)


def nodes(graph: str) -> list[str]:
    """Return the names of the relays, the recorder first and the plant last."""
    speak = dict.fromkeys(one for topic in step_topics(graph) for one in topic.producers if one != PLANT)
    return [RECORDER, *speak, PLANT]
