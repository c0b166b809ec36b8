# SPDX-License-Identifier: Apache-2.0
"""Open bags within bounds.

rosbags reads records and unpacks chunks whole, and follows YAML wherever it leads. Here its readers get
streams that refuse long reads, decompressors that stop, and the YAML of `reading`.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO, ClassVar

import apsw
from mcap.opcode import Opcode
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader, metadata, reader, storage_mcap
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from pam_orthosis.bag import unpack
from pam_orthosis.bag.information import METADATA_FILE, refusal
from pam_orthosis.errors import OrthosisError
from pam_orthosis.reading import check_file, from_yaml, open_file, read_text

PROFILE = "ros2"  # of the files that rosbag2's readers take


@contextmanager
def open_bag(path: Path) -> Iterator[Reader]:
    """Open a bag's folder or file; OrthosisError, then or later, if it is unclosed, damaged, too large."""
    check_bag(path)
    with damage_told(path), unpack.allowed(_on_disk(path)), _Reader(path) as opened:
        yield opened


def check_bag(path: Path) -> None:
    """Refuse, by OrthosisError, what is no bag's folder or regular file, and a bag never closed."""
    with suppress(OSError):
        if path.is_dir():
            if (path / METADATA_FILE).exists():
                read_text(path / METADATA_FILE)
                return
            if files := sorted(path.glob("*.mcap")):
                told = f"{path} was never closed (no {METADATA_FILE}); run"
                raise OrthosisError(_not_ros(path, files) or f"{told} {_remedy(path, files)}")
            raise OrthosisError(f"{path} holds no bag (no {METADATA_FILE})")
        if not path.exists():
            raise OrthosisError(f"no bag at {path}")
    check_file(path)
    if path.suffix not in _Reader.STORAGE_PLUGINS:
        raise OrthosisError(f"{path} is no bag: give a bag's folder, or its .mcap or .db3 file")


@contextmanager
def damage_told(path: Path) -> Iterator[None]:
    """Turn whatever the readers raise over a damaged file into the error of this program."""
    try:
        yield
    except OrthosisError:
        raise
    except Exception as error:
        reason = str(error).splitlines()[0][:200] if str(error).strip() else type(error).__name__
        told = f"{path} cannot be read as a bag ({reason}); try `pam-orthosis recover {path}`"
        files = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
        raise OrthosisError(_not_ros(path, files) or told) from error


def _declared(file: Path) -> tuple[str, dict[str, str]]:
    """Return the profile of a closed MCAP file, and topic -> why it is refused."""
    with (
        suppress(Exception),
        unpack.Limited(open_file(file)) as stream,
    ):  # damage makes the reader raise anything
        for _ in unpack.records_of(stream):  # mcap's reader walks through a hole for hours
            pass
        stream.seek(0)
        reader = make_reader(stream)
        if summary := reader.get_summary():
            refused = {one.topic: refusal(one, summary.schemas) for one in summary.channels.values()}
            return reader.get_header().profile, refused
    return PROFILE, {}


def _not_ros(path: Path, files: Sequence[Path]) -> str:
    """Return what to say of files whose topics are all refused; empty if there is one that is not."""
    told = {topic: why for file in files for topic, why in _declared(file)[1].items()}
    if not told or not all(told.values()):
        return ""
    topic, why = next(iter(told.items()))
    return f"{path} is no bag of ROS: {topic}: {why}"


def _remedy(path: Path, files: Sequence[Path]) -> str:
    """Return what makes a bag readable: a copy if readers refuse its profile or one of its topics."""
    declared = [_declared(file) for file in files]
    copied = any(profile != PROFILE or any(refused.values()) for profile, refused in declared)
    return f"`pam-orthosis recover {path}{'' if copied else ' --in-place'}`"


class _Source:
    """A path as the reader of MCAP files opens it."""

    def __init__(self, path: Path):
        self._path = path

    def __str__(self) -> str:
        return str(self._path)

    def open(self, _mode: str) -> BinaryIO:
        """Open the file; OrthosisError or ValueError if it is not one that can be read."""
        stream = unpack.Limited(open_file(self._path))
        unpack.take(0, sum(one.opcode == Opcode.CHANNEL for one in unpack.records_of(stream)))
        stream.seek(0)
        return stream


class _Mcap(McapReader):
    def __init__(self, path: Path):
        super().__init__(_Source(path))  # type: ignore[arg-type]  # it is asked for `open` alone


class _Sqlite(Sqlite3Reader):
    def open(self) -> None:
        check_file(Path(str(self.path)))
        super().open()


class _Folder(reader.DirectoryReader):
    STORAGE_PLUGINS: ClassVar = {"mcap": _Mcap, "sqlite3": _Sqlite}  # type: ignore[misc]


class _Reader(Reader):
    STORAGE_PLUGINS: ClassVar = {"dir": _Folder, ".mcap": _Mcap, ".db3": _Sqlite}  # type: ignore[misc]


class _Yaml:
    """Stands for ruamel's class in rosbags, which reads quality of service and `metadata.yaml` with it."""

    def __init__(self, **_: Any):
        pass

    def load(self, text: str) -> Any:
        """Return what a text holds; ValueError if it is malformed or beyond the bounds."""
        try:
            return from_yaml(text, "its metadata or a quality of service")
        except OrthosisError as error:
            raise ValueError(str(error)) from error


def _on_disk(path: Path) -> int:
    files = path.iterdir() if path.is_dir() else [path]
    return sum(512 * one.stat().st_blocks for one in files if one.is_file())


def _restrict(connection: apsw.Connection) -> None:
    """Let no database make up what it does not hold: views run without end, texts and blobs have no bound."""
    connection.limit(apsw.SQLITE_LIMIT_LENGTH, unpack.MOST_BYTES)
    for option, value in ((apsw.SQLITE_DBCONFIG_ENABLE_VIEW, 0), (apsw.SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0)):
        connection.config(option, value)


# rosbags has no setting for any of these; a version in which they are elsewhere fails here, at once
for _name in list(storage_mcap.DECOMPRESSORS):
    storage_mcap.DECOMPRESSORS[_name] = partial(unpack.unpacked_bytes, _name)
_reader: Any = reader
_metadata: Any = metadata
for _module in (_reader, _metadata):
    assert _module.YAML
    _module.YAML = _Yaml
assert _reader.zstd.decompress
_reader.zstd = SimpleNamespace(decompress=unpack.unpacked_message, open=unpack.unpacked_file)
apsw.connection_hooks.append(_restrict)
