# SPDX-License-Identifier: Apache-2.0
"""What `metadata.yaml` holds of a bag, laid out as rosbag2_storage (metadata version 9) does."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import yaml
from mcap.records import Channel, Schema

from pam_orthosis.errors import OrthosisError
from pam_orthosis.reading import from_yaml

METADATA_FILE = "metadata.yaml"
RUN_RECORD, BAG_RECORD = "pam_orthosis", "rosbag2"  # metadata in an MCAP file: of the run, of the bag
LONG = ("parameters", "machine", "legs")  # of the metadata of a run, which `metadata.yaml` leaves out
NO_TYPE = "__schemaless__"  # as rosbags calls the type of a channel without a schema

MESSAGES = "cdr"  # encoding of messages that rosbag2's readers take
DEFINITIONS = "ros2msg", "ros2idl", "omgidl", ""  # encodings of types that they take


class FileContent:
    """What one file of a bag holds."""

    def __init__(self, name: str, count: int = 0, first_ns: int = 2**63 - 1, last_ns: int = 0):
        self.name = name
        self.count = count
        self.first_ns, self.last_ns = first_ns, last_ns

    def include(self, other: FileContent) -> None:
        """Count all of another file."""
        self.count += other.count
        self.first_ns = min(self.first_ns, other.first_ns)
        self.last_ns = max(self.last_ns, other.last_ns)

    def span(self) -> dict[str, Any]:
        """Return time and number of messages as `metadata.yaml` holds them."""
        first_ns, last_ns = (self.first_ns, self.last_ns) if self.count else (0, 0)
        return {
            "duration": {"nanoseconds": last_ns - first_ns},
            "starting_time": {"nanoseconds_since_epoch": first_ns},
            "message_count": self.count,
        }


def topic_row(topic: str, msgtype: str, metadata: Mapping[str, str]) -> dict[str, Any]:
    """Return what `metadata.yaml` holds of a topic, from the metadata of its channel."""
    return {
        "name": topic,
        "type": msgtype,
        "serialization_format": "cdr",
        "offered_qos_profiles": _qos_of(metadata.get("offered_qos_profiles", "[]")),
        "type_description_hash": metadata.get("topic_type_hash", ""),
    }


def information(
    files: Sequence[FileContent], topics: Iterable[tuple[Mapping[str, Any], int]], run: Mapping[str, str]
) -> dict[str, Any]:
    """Return the description of a bag: of its files, its topics with their numbers of messages, its run."""
    whole = FileContent("")
    for file in files:
        whole.include(file)
    custom = {key: value for key, value in run.items() if key not in LONG}
    return {
        "version": 9,
        "storage_identifier": "mcap",
        **whole.span(),
        "topics_with_message_count": [
            {"topic_metadata": topic, "message_count": count} for topic, count in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [{"path": file.name, **file.span()} for file in files],
        "custom_data": custom or None,
        "ros_distro": "jazzy",
    }


def metadata_text(description: Mapping[str, Any]) -> str:
    """Return the text of `metadata.yaml`."""
    return as_yaml({"rosbag2_bagfile_information": description})


def serialised(description: Mapping[str, Any]) -> dict[str, str]:
    """Return the same as the record `BAG_RECORD` of an MCAP file."""
    return {"serialized_metadata": as_yaml(description)}


class _PlainDumper(yaml.SafeDumper):  # type: ignore[misc]  # PyYAML has no types
    """Writes repeated values out instead of referring to them."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def as_yaml(data: Any) -> str:
    """Return YAML in the order of the data."""
    return str(yaml.dump(data, Dumper=_PlainDumper, sort_keys=False))


@lru_cache
def _qos_of(text: str) -> list[dict[str, Any]]:
    """Return qualities of service; none if they cannot be read."""
    try:
        read = from_yaml(text, "offered_qos_profiles")
    except OrthosisError:
        return []
    return read if isinstance(read, list) else []


def refusal(channel: Channel, schemas: Mapping[int, Schema]) -> str:
    """Return why messages of a channel keep readers of ROS from a whole bag; empty if they do not."""
    if channel.message_encoding != MESSAGES:
        return f"its messages are {channel.message_encoding or 'of no encoding'}, not {MESSAGES}"
    if not channel.schema_id:
        return ""
    if channel.schema_id not in schemas:
        return f"its schema {channel.schema_id} is missing"
    schema = schemas[channel.schema_id]
    if schema.encoding not in DEFINITIONS:
        return f"its type is defined in {schema.encoding}, which is not of ROS"
    return "" if _is_text(schema.data) else "the definition of its type is no text"


def _is_text(data: bytes) -> bool:
    try:
        data.decode()
    except UnicodeDecodeError:
        return False
    return True
