# SPDX-License-Identifier: Apache-2.0
"""Folders of results that a command may make again: it replaces what it wrote there, and nothing else.

A list in the folder holds the name of each file and the digest of what was written. A file that is not in it,
or was changed since, is somebody else's.
"""

import hashlib
import json
import stat
from collections.abc import Iterable, Mapping
from io import BytesIO
from pathlib import Path

from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import UNFINISHED, Write, as_bytes, as_text, status, try_place, write_files, writing
from pam_orthosis.reading import from_json, read_text

LIST = f"{UNFINISHED}made.json"
REMAKE = ", or --overwrite to make it again"


def write_results(folder: Path, files: Mapping[str, Write], overwrite: bool = False) -> None:
    """Write files below a folder, all or none, and list them; OrthosisError as `refuse_foreign`."""
    listed = _refuse_names(folder, files, overwrite)
    contents = {name: _content(folder / name, write) for name, write in files.items()}
    listed |= {name: digest(data) for name, data in contents.items()}
    written = {folder / name: as_bytes(data) for name, data in contents.items()}
    written[folder / LIST] = as_text(json.dumps(listed, indent=2) + "\n")
    write_files(written, {path for path in written if status(path)})


def refuse_foreign(
    folder: Path, names: Iterable[str], overwrite: bool = False, beside: Iterable[str] = ()
) -> None:
    """Raise OrthosisError if a folder of results is not new, empty or one's own, or cannot be written.

    Args:
        folder: may hold what `write_results` wrote, unchanged where it is to be written again.
        names: of what is to be written there.
        overwrite: whether it is written again.
        beside: names of what may be there too.
    """
    try_place(folder)
    listed = _refuse_names(folder, names, overwrite)
    own = {Path(name).parts[0] for name in listed} | set(beside)
    for one in sorted(folder.iterdir()) if folder.is_dir() else ():
        if one.name not in own and not one.name.startswith(UNFINISHED):
            raise OrthosisError(f"{folder} holds {one.name}, of something else; choose another --out")


def _refuse_names(folder: Path, names: Iterable[str], overwrite: bool) -> dict[str, str]:
    """Raise OrthosisError if there is another's file by one of these names; return what is listed."""
    listed = _listed(folder)
    for path, written in ((folder / name, listed.get(name)) for name in names):
        if status(path) and not as_written(path, written):
            raise OrthosisError(f"{path} was not written by this, or changed since; choose another --out")
        if status(path) and not overwrite:
            raise OrthosisError(f"{path} exists; choose another --out{REMAKE}")
    return listed


def digest(content: bytes) -> str:
    """Return what distinguishes a content from others."""
    return hashlib.sha256(content).hexdigest()


def as_written(path: Path, written: str | None) -> bool:
    """Return whether a file is a regular one of the content of this digest."""
    there = status(path)
    return there is not None and stat.S_ISREG(there.st_mode) and digest(path.read_bytes()) == written


def _content(path: Path, write: Write) -> bytes:
    with writing(path):
        write(stream := BytesIO())
    return stream.getvalue()


def _listed(folder: Path) -> dict[str, str]:
    """Return the digests of what was written into a folder, by name; OrthosisError if their list is none."""
    if not status(file := folder / LIST):
        return {}
    listed = from_json(read_text(file), str(file))
    if not isinstance(listed, dict):
        raise OrthosisError(f"{file} is no list of files; choose another --out")
    return {str(name): str(one) for name, one in listed.items()}
