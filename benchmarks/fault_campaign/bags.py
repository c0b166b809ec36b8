# SPDX-License-Identifier: Apache-2.0
"""Bags to be spoilt: real ones cut short, taken apart into messages, and written again with changes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from pam_orthosis.bag.record import BagWriter
from pam_orthosis.bag.topics import SECOND_NS

STORE = get_typestore(Stores.ROS2_JAZZY)


class Entry(NamedTuple):
    """A message of a bag: topic, type, stamp and the message itself."""

    topic: str
    type: str
    stamp_ns: int
    message: Any


class Content(NamedTuple):
    """What a bag holds: its messages in order, and the run metadata."""

    entries: list[Entry]
    run: dict[str, str]


def content(bag: Path, until_ns: int | None = None) -> Content:
    """Return what a bag of ours holds, up to an instant."""
    (file,) = bag.glob("*.mcap")
    entries: list[Entry] = []
    with open(file, "rb") as stream:
        reader = make_reader(stream)
        run = next(
            dict(record.metadata) for record in reader.iter_metadata() if record.name == "pam_orthosis"
        )
        for schema, channel, record in reader.iter_messages():
            if until_ns is None or record.log_time < until_ns:
                message = STORE.deserialize_cdr(record.data, schema.name)
                entries.append(Entry(channel.topic, schema.name, record.log_time, message))
    return Content(entries, run)


def write(folder: Path, held: Content, raw: Callable[[Entry, bytes], bytes] | None = None) -> Path:
    """Write a bag; `raw` may change the bytes of a message."""
    with BagWriter(folder, held.run) as bag:
        for topic, type_ in dict.fromkeys((entry.topic, entry.type) for entry in held.entries):
            bag.add_topic(topic, type_)
        for entry in held.entries:
            data = bytes(STORE.serialize_cdr(entry.message, entry.type))
            bag.write(entry.topic, entry.stamp_ns, raw(entry, data) if raw else data)
    return folder


def stamped(entry: Entry, stamp_ns: int) -> Entry:
    """Return the message with another stamp, in its header too if it has one."""
    if not hasattr(entry.message, "header"):
        return entry._replace(stamp_ns=max(0, stamp_ns))
    copy = STORE.deserialize_cdr(STORE.serialize_cdr(entry.message, entry.type), entry.type)
    copy.header.stamp.sec, copy.header.stamp.nanosec = divmod(stamp_ns, SECOND_NS)
    return Entry(entry.topic, entry.type, max(0, stamp_ns), copy)


def of_topic(held: Content, topic: str) -> list[int]:
    """Return the places of a topic's messages."""
    return [place for place, entry in enumerate(held.entries) if entry.topic == topic]


def valued(entry: Entry, value: float) -> Entry:
    """Return the message with another number in the place of its first."""
    copy = STORE.deserialize_cdr(STORE.serialize_cdr(entry.message, entry.type), entry.type)
    for name in ("fluid_pressure", "position", "velocity", "effort"):
        if name == "fluid_pressure" and hasattr(copy, name):
            copy.fluid_pressure = value
            break
        if len(getattr(copy, name, ())):
            setattr(copy, name, np.array([value, *getattr(copy, name)[1:]]))
            break
    else:
        if hasattr(copy, "points"):
            copy.points[0].positions = np.array([value])
        elif hasattr(copy, "vector"):
            copy.vector.x = value
        else:
            copy.wrench.torque.y = value
    return entry._replace(message=copy)


def rig_bags(folder: Path) -> list[Path]:
    """Record a short procedure of the test rig: three pressures and a decay."""
    from pam_orthosis.bag.rig_record import record_rig
    from pam_orthosis.control.rig_loop import DecayRig, Rig, force_procedure
    from pam_orthosis.model.parameters import load

    parameters = load()
    for number, pressure in enumerate((2e5, 4e5, 7e5)):
        samples = force_procedure(Rig(parameters, "dmsp_20", number), pressure)
        record_rig(folder / f"force-{number}", parameters, "dmsp_20", "force", samples, 40)
    samples = DecayRig(parameters, "dmsp_20", 9).run(4e5)
    record_rig(folder / "decay", parameters, "dmsp_20", "decay", samples, 4)
    return sorted(folder.iterdir())
