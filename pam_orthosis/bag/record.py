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
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import yaml
from mcap.writer import CompressionType, Writer

from pam_orthosis import __version__
from pam_orthosis.bag import cdr
from pam_orthosis.bag.topics import PUBLISHED_DEPTH, SECOND_NS
from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import make_folder, remove_empty, told, write_text
from pam_orthosis.model.parameters import Parameters

CHUNK_BYTES = 64 * 1024
FLUSH_NS = 150_000_000  # of the bag's time, after which a chunk ends however small it is
FILE_NS = 600 * SECOND_NS  # of the bag's time in one file
METADATA_FILE = "metadata.yaml"
RUN_RECORD = "pam_orthosis"
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


class BagWriter:
    """A new bag in a folder; use it as a context manager or call `close`.

    As a context manager it leaves nothing behind if what it surrounds fails.

    Args:
        folder: created if need be; must not hold a bag.
        run: run metadata (texts), kept in the MCAP file and, but for the parameters, in
            `metadata.yaml` as custom data.
        behind: go on with the bag of another writer that was killed, in a file behind this; what that one
            wrote later is cut off.

    Raises:
        OrthosisError: the folder holds a bag or cannot be written.
    """

    def __init__(self, folder: Path, run: Mapping[str, str] | None = None, behind: OnDisk | None = None):
        self.folder = Path(folder)
        self.run = dict(run or {})
        self._channels: dict[str, int] = {}
        self._topics: dict[str, dict] = {}
        self._schemas: dict[str, int] = {}
        self._definitions: dict[str, tuple[str, bytes, dict[str, str]]] = {}
        self._counts: Counter[str] = Counter()
        self._files: list[_File] = []
        self._flushed_ns = 0
        self._stream = None
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
        self._stream = _create(self._file)
        self._files.append(_File(self._file.name))
        self._writer = Writer(self._stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._channels.clear()
        self._schemas.clear()
        with told(self._file):
            self._writer.start(profile="ros2", library=f"pam_orthosis {__version__}")
            if self.run:
                self._writer.add_metadata(RUN_RECORD, self.run)
            self.flush()
        for topic, (msgtype, definition, metadata) in self._definitions.items():
            self._register(topic, msgtype, definition, metadata)

    def _numbered(self, number: int) -> Path:
        return self.folder / f"{self.folder.name}_{number}.mcap"

    def _cut(self, behind: OnDisk) -> None:
        with told(self.folder):
            os.truncate(self._numbered(behind.file), behind.size)
            self._numbered(behind.file + 1).unlink(missing_ok=True)

    def _seal(self) -> None:
        """Finish the file."""
        with told(self._file):
            self._writer.add_metadata("rosbag2", {"serialized_metadata": _as_yaml(self._information())})
            self._writer.finish()
            self._stream.close()

    def add_topic(self, topic: str, msgtype: str, latched: bool = False) -> None:
        """Declare a topic (absolute name) of a standard ROS 2 type, once; `latched`: transient local."""
        if topic in self._topics:
            return
        definition, type_hash = message_definition(msgtype)
        self.add_channel(
            topic,
            msgtype,
            definition.encode(),
            {
                "offered_qos_profiles": _qos_text(latched),
                "topic_type_hash": type_hash,
            },
        )

    def add_channel(self, topic: str, msgtype: str, definition: bytes, metadata: Mapping[str, str]) -> None:
        """Declare a topic by its ros2msg definition and rosbag2 channel metadata."""
        self._definitions[topic] = msgtype, definition, dict(metadata)
        self._register(topic, *self._definitions[topic])
        self._topics[topic] = {
            "name": topic,
            "type": msgtype,
            "serialization_format": "cdr",
            "offered_qos_profiles": _qos_of(metadata.get("offered_qos_profiles", "[]")),
            "type_description_hash": metadata.get("topic_type_hash", ""),
        }

    def _register(self, topic: str, msgtype: str, definition: bytes, metadata: dict[str, str]) -> None:
        if msgtype not in self._schemas:
            self._schemas[msgtype] = self._writer.register_schema(msgtype, "ros2msg", definition)
        self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[msgtype], metadata)

    def write(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """Append a serialised message of a declared topic; OrthosisError if the disk takes no more."""
        self.write_all([(topic, stamp_ns, data)])

    def write_all(self, messages: Iterable[tuple[str, int, bytes]]) -> None:
        """Append messages: topic, stamp, data; OrthosisError if the disk takes no more."""
        with told(self._file):
            for topic, stamp_ns, data in messages:
                if stamp_ns - self._flushed_ns >= FLUSH_NS:
                    self._flushed_ns = stamp_ns
                    self._part(stamp_ns)
                self._writer.add_message(self._channels[topic], stamp_ns, data, stamp_ns)
                self._counts[topic] += 1
                file = self._files[-1]
                file.count += 1
                file.first_ns, file.last_ns = min(file.first_ns, stamp_ns), max(file.last_ns, stamp_ns)

    def _part(self, stamp_ns: int) -> None:
        """Write out what there is, so that it does not die with this process; begin a new file in time."""
        if self._files[-1].reached(stamp_ns):
            self._seal()
            self._open()
        else:
            self.flush()

    def flush(self) -> None:
        """Write out what there is; OrthosisError if the disk takes no more."""
        with told(self._file):
            self._writer.flush()
            number = self._first + len(self._files) - 1
            self.on_disk = OnDisk(self._counts.total(), number, self._stream.tell())

    def close(self) -> None:
        """Finish the file and write `metadata.yaml`; OrthosisError if the disk takes no more."""
        self._seal()
        information = {"rosbag2_bagfile_information": self._information()}
        write_text(self.folder / METADATA_FILE, _as_yaml(information))

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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if error is None:
            try:
                self.close()
                return
            except OrthosisError:
                self.discard()
                raise
        self.discard()

    def _information(self) -> dict:
        whole = _File("")
        for file in self._files:
            whole.include(file)
        custom = {key: value for key, value in self.run.items() if key != "parameters"}
        return {
            "version": 9,
            "storage_identifier": "mcap",
            **whole.span(),
            "topics_with_message_count": [
                {"topic_metadata": topic, "message_count": self._counts[name]}
                for name, topic in self._topics.items()
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [file.name for file in self._files],
            "files": [{"path": file.name, **file.span()} for file in self._files],
            "custom_data": custom or None,
            "ros_distro": "jazzy",
        }


class _File:
    """What one file of a bag holds."""

    def __init__(self, name: str):
        self.name = name
        self.count = 0
        self.first_ns, self.last_ns = 2**63 - 1, 0

    def include(self, other: _File) -> None:
        """Count all of another file."""
        self.count += other.count
        self.first_ns = min(self.first_ns, other.first_ns)
        self.last_ns = max(self.last_ns, other.last_ns)

    def reached(self, stamp_ns: int) -> bool:
        """Whether an instant is so late that it belongs into another file."""
        return self.count > 0 and stamp_ns - self.first_ns >= FILE_NS

    def span(self) -> dict[str, Any]:
        """Return time and number of messages as `metadata.yaml` tells them."""
        first_ns, last_ns = (self.first_ns, self.last_ns) if self.count else (0, 0)
        return {
            "duration": {"nanoseconds": last_ns - first_ns},
            "starting_time": {"nanoseconds_since_epoch": first_ns},
            "message_count": self.count,
        }


class _PlainDumper(yaml.SafeDumper):
    """Writes repeated values out instead of referring to them."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


@lru_cache
def _qos_text(latched: bool) -> str:
    return _as_yaml(LATCHED_QOS if latched else QOS).strip()


@lru_cache
def _qos_of(text: str) -> list[dict]:
    return yaml.safe_load(text)


def _as_yaml(data: Any) -> str:
    return yaml.dump(data, Dumper=_PlainDumper, sort_keys=False)


def run_metadata(
    parameters: Parameters, scenario: str, legs: str = "", branches: Sequence[str] = EFFECTS
) -> dict[str, str]:
    """Return what a bag tells of its run: version, commit, scenario, seed, effects, parameters.

    With several legs it tells in which parameters each differs: JSON, by namespace. Effects are those that
    are switched on in these branches of the parameters.
    """
    flat = parameters.flat()
    on = [key.removesuffix(".enabled") for key, value in flat.items() if key.endswith(".enabled") and value]
    return {
        "version": __version__,
        "commit": _commit(),
        "scenario": scenario,
        "seed": str(flat["scenario.seed"]),
        "effects": json.dumps([key for key in on if key.startswith(tuple(branches))]),
        "parameters": json.dumps(flat),
        **({"legs": legs} if legs else {}),
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


def _create(file: Path):
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
