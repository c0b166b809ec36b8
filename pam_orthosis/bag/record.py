# SPDX-License-Identifier: Apache-2.0
"""Write bags as rosbag2 (Jazzy) does: MCAP of profile ros2 with `metadata.yaml` beside it.

Layout after rosbag2_storage_mcap and rosbag2_storage (metadata version 9). Log and publish time are
the header stamp, so a bag depends on seed and parameters alone. Small chunks: a killed recorder
loses about a tenth of a second. A long bag is split into files, since the index of a file is kept in memory
until it is closed.
"""

from __future__ import annotations

import json
import os
import subprocess
from collections import Counter
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.records import Message
from mcap.writer import CompressionType, Writer

from pam_orthosis import __version__
from pam_orthosis.bag import cdr
from pam_orthosis.bag.information import (
    BAG_RECORD,
    METADATA_FILE,
    RUN_RECORD,
    FileContent,
    as_yaml,
    information,
    metadata_text,
    serialised,
    topic_row,
)
from pam_orthosis.bag.topics import PUBLISHED_DEPTH, SECOND_NS
from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import make_folder, remove_empty, write_text, writing
from pam_orthosis.model.parameters import Parameters

CHUNK_BYTES = 64 * 1024
FLUSH_NS = 150_000_000  # of the bag's time, after which a chunk ends however small it is
FILE_NS = 600 * SECOND_NS  # of the bag's time in one file
EFFECTS, RIG_EFFECTS = ("plant.effects.", "effects."), ("plant.rig.effects.",)
_FOREVER = {"sec": 9223372036, "nsec": 854775807}
QOS = [
    {
        "history": "keep_last",
        "depth": PUBLISHED_DEPTH,
        "reliability": "reliable",
        "durability": "volatile",
        "deadline": _FOREVER,
        "lifespan": _FOREVER,
        "liveliness": "automatic",
        "liveliness_lease_duration": _FOREVER,
        "avoid_ros_namespace_conventions": False,
    }
]
LATCHED_QOS = [{**QOS[0], "durability": "transient_local"}]


class OnDisk(NamedTuple):
    """What of a bag does not die with the process that writes it: messages, last file, its size in bytes."""

    messages: int
    file: int
    size: int


class Declared(NamedTuple):
    """A channel of a bag: absolute name of the topic, type and how it is defined, metadata after rosbag2.

    `encoding` is that of the definition; None: there is neither type nor definition.
    """

    topic: str
    msgtype: str
    encoding: str | None
    definition: bytes
    metadata: Mapping[str, str]


class BagWriter:
    """A new bag in a folder; use it as a context manager or call `close`.

    As a context manager it leaves nothing behind if what it surrounds fails.

    Args:
        folder: created if need be; must not hold a bag.
        run: run metadata (texts), kept in the MCAP file and, but for parameters and machine, in
            `metadata.yaml` as custom data.
        behind: go on with the bag of another writer that was killed, in a file behind this; what that one
            wrote later is cut off.

    Raises:
        OrthosisError: the folder holds a bag or cannot be written.
    """

    def __init__(self, folder: Path, run: Mapping[str, str] | None = None, behind: OnDisk | None = None):
        self.folder = Path(folder)
        self.run = dict(run or {})
        self._channels: dict[Hashable, int] = {}
        self._topics: dict[Hashable, dict[str, Any]] = {}
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._declared: dict[Hashable, Declared] = {}
        self._counts: Counter[Hashable] = Counter()
        self._files: list[FileContent] = []
        self._flushed_ns = 0
        self._stream: BinaryIO | None = None
        self._first = behind.file + 1 if behind else 0
        self._made = make_folder(self.folder)
        try:
            if behind:
                self._cut(behind)
            else:
                _check_empty(self.folder)
            self._open()
        except OrthosisError:
            self.discard()
            raise

    def _open(self) -> None:
        """Begin the next file."""
        self._file = self._numbered(self._first + len(self._files))
        self._stream = stream = _create(self._file)
        self._files.append(FileContent(self._file.name))
        self._writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._channels.clear()
        self._schemas.clear()
        with writing(self._file):
            self._writer.start(profile="ros2", library=f"pam_orthosis {__version__}")
            if self.run:
                self._writer.add_metadata(RUN_RECORD, self.run)
            self.flush()
        for key, channel in self._declared.items():
            self._register(key, channel)

    def _numbered(self, number: int) -> Path:
        return self.folder / f"{self.folder.name}_{number}.mcap"

    def _cut(self, behind: OnDisk) -> None:
        with writing(self.folder):
            os.truncate(self._numbered(behind.file), behind.size)
            self._numbered(behind.file + 1).unlink(missing_ok=True)

    def _seal(self) -> None:
        """Finish the file."""
        with writing(self._file):
            self._writer.add_metadata(BAG_RECORD, serialised(self._information()))
            self._writer.finish()
            self._open_stream.close()

    def add_topic(self, topic: str, msgtype: str, latched: bool = False) -> None:
        """Declare a topic (absolute name) of a standard ROS 2 type, once; `latched`: transient local."""
        if topic in self._topics:
            return
        definition, type_hash = message_definition(msgtype)
        metadata = {"offered_qos_profiles": _qos_text(latched), "topic_type_hash": type_hash}
        self.add_channel(topic, Declared(topic, msgtype, "ros2msg", definition.encode(), metadata))

    def add_channel(self, key: Hashable, channel: Declared) -> None:
        """Declare a channel once; `key` stands for it when messages are written."""
        if key not in self._declared:
            self._declared[key] = channel
            self._topics[key] = topic_row(channel.topic, channel.msgtype, channel.metadata)
            self._register(key, channel)

    def _register(self, key: Hashable, channel: Declared) -> None:
        topic, msgtype, encoding, definition, metadata = channel
        schema = 0
        if encoding is not None:
            same = msgtype, encoding, definition
            if same not in self._schemas:
                self._schemas[same] = self._writer.register_schema(*same)
            schema = self._schemas[same]
        self._channels[key] = self._writer.register_channel(topic, "cdr", schema, dict(metadata))

    def write(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """Append a serialised message of a declared topic; OrthosisError if the disk takes no more."""
        self.write_all([(topic, stamp_ns, data)])

    def write_all(self, messages: Iterable[tuple[str, int, bytes]]) -> None:
        """Append messages: topic, stamp, data; OrthosisError if the disk takes no more."""
        with writing(self._file):
            for topic, stamp_ns, data in messages:
                self._add(topic, stamp_ns, data, stamp_ns)

    def copy(self, key: Hashable, message: Message) -> None:
        """Append a message of another bag as it is; OrthosisError if the disk takes no more."""
        with writing(self._file):
            self._add(key, message.log_time, message.data, message.publish_time, message.sequence)

    def _add(self, key: Hashable, log_ns: int, data: bytes, publish_ns: int, sequence: int = 0) -> None:
        if log_ns - self._flushed_ns >= FLUSH_NS:
            self._flushed_ns = log_ns
            self._part(log_ns)
        self._writer.add_message(self._channels[key], log_ns, data, publish_ns, sequence)
        self._counts[key] += 1
        file = self._files[-1]
        file.count += 1
        file.first_ns, file.last_ns = min(file.first_ns, log_ns), max(file.last_ns, log_ns)

    def _part(self, stamp_ns: int) -> None:
        """Write out what there is, so that it does not die with this process; begin a new file in time."""
        file = self._files[-1]
        if file.count and stamp_ns - file.first_ns >= FILE_NS:
            self._seal()
            self._open()
        else:
            self.flush()

    def flush(self) -> None:
        """Write out what there is; OrthosisError if the disk takes no more."""
        with writing(self._file):
            self._writer.flush()
            number = self._first + len(self._files) - 1
            self.on_disk = OnDisk(self._counts.total(), number, self._open_stream.tell())

    def close(self) -> None:
        """Finish the file and write `metadata.yaml`; OrthosisError if the disk takes no more."""
        self._seal()
        write_text(self.folder / METADATA_FILE, metadata_text(self._information()))

    def leave(self) -> None:
        """Write out what there is and leave the bag unclosed; OrthosisError if the disk takes no more."""
        if not self._open_stream.closed:
            self.flush()
            self._open_stream.close()

    def discard(self) -> None:
        """Remove what was written."""
        if self._stream:
            with suppress(OSError):  # what is still buffered may not fit
                self._stream.close()
        for file in self._files:
            (self.folder / file.name).unlink(missing_ok=True)
        remove_empty(self._made)

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            try:
                self.close()
                return
            except OrthosisError:
                self.discard()
                raise
        self.discard()

    @property
    def _open_stream(self) -> BinaryIO:
        assert self._stream is not None  # there is one from the start on, unless it could not be made
        return self._stream

    def _information(self) -> dict[str, Any]:
        topics = [(topic, self._counts[name]) for name, topic in self._topics.items()]
        return information(self._files, topics, self.run)


@lru_cache
def _qos_text(latched: bool) -> str:
    return as_yaml(LATCHED_QOS if latched else QOS).strip()


def run_metadata(
    parameters: Parameters, scenario: str, legs: str = "", branches: Sequence[str] = EFFECTS
) -> dict[str, str]:
    """Return what a bag says of its run: version, commit, scenario, seed, effects, parameters.

    Of a user's machine it holds the file; of several `legs`, in which parameters each differs: JSON, by
    namespace. Effects are those that are switched on in these branches of the parameters.
    """
    flat = parameters.flat()
    machine = parameters.declared
    on = [key.removesuffix(".enabled") for key, value in flat.items() if key.endswith(".enabled") and value]
    return {
        "version": __version__,
        "commit": _commit(),
        "scenario": scenario,
        "seed": str(flat["scenario.seed"]),
        "effects": json.dumps([key for key in on if key.startswith(tuple(branches))]),
        "parameters": json.dumps(flat),
        **({"legs": legs} if legs else {}),
        **({"machine": machine.text, "machine_name": machine.name} if machine.text else {}),
    }


@lru_cache
def message_definition(msgtype: str) -> tuple[str, str]:
    """Return the full text of a standard type and its type hash (RIHS01)."""
    store = cdr.store()
    return store.generate_msgdef(msgtype, ros_version=2)[0], store.hash_rihs01(msgtype)


def _check_empty(folder: Path) -> None:
    with _creating(folder):
        if (folder / METADATA_FILE).exists() or any(folder.glob("*.mcap")):
            raise OrthosisError(f"{folder} holds a bag already; choose another folder")


def _create(file: Path) -> BinaryIO:
    with _creating(file.parent):
        return open(file, "xb")


@contextmanager
def _creating(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise OrthosisError(f"cannot write a bag to {folder}: {error.strerror}") from error


def _commit() -> str:
    """Return the git commit of the source tree, marked if edited; nothing if it is no checkout."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return ""
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40"]
    command += ["--exclude", "*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""
