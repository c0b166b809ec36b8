# SPDX-License-Identifier: Apache-2.0
"""Where files and folders are made: whole or not at all, and never in the place of somebody else's.

A file is written under a random name that is created exclusively and follows no link, then it takes its own
name, which must be free. A folder for many files must be new or empty, and belongs to one process: its lock
(`flock`) ends with that process, however it ends. What fails leaves all as it was.
"""

import errno
import fcntl
import os
import secrets
import shutil
import stat
from argparse import ArgumentTypeError
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, BinaryIO

from pam_orthosis.errors import OrthosisError

UNFINISHED = ".pam-orthosis-"  # begins the name of what is not whole yet, or never will be
NEW_FILE = os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_WRONLY | os.O_CLOEXEC

Write = Callable[[BinaryIO], Any]


class Used(OrthosisError):
    """A folder is not empty, or another process has claimed it."""


def bag_name(path: Path) -> str:
    """Return the name of a bag: that of its folder, or of its file without the ending."""
    return path.name.removesuffix(".mcap")


def output(text: str) -> Path:
    """Return the path of an --out: without `..`, so that it is the same before and after folders are made."""
    if not text:
        raise ArgumentTypeError("give a path, not an empty text")
    path = Path(text)
    return path.resolve() if ".." in path.parts else path


@contextmanager
def instead_of_out(option: str) -> Iterator[None]:
    """Let a refusal name the option that was given for what is written."""
    try:
        yield
    except OrthosisError as error:
        raise type(error)(str(error).replace("another --out", f"another {option}")) from error


def write_text(path: Path, text: str, overwrite: bool = False) -> None:
    """Write a text as `write_files` writes."""
    write_files({path: as_text(text)}, {path} if overwrite else ())


def as_text(text: str) -> Write:
    """Return what writes a text; bytes of a name that are no text are written as escapes."""
    return lambda stream: stream.write(text.encode("utf-8", "backslashreplace"))


def as_bytes(content: bytes) -> Write:
    """Return what writes these bytes."""
    return lambda stream: stream.write(content)


def write_files(files: Mapping[Path, Write], replaced: Container[Path] = ()) -> None:
    """Write files, and the folders that they need, all of them or none.

    Those that take the place of another come last, for what they replace is gone then: if one of these cannot
    take it, though it could be written, those that already have done so keep theirs.

    Args:
        files: what fills each.
        replaced: which of them take the place of a regular file of that name, if there is one.

    Raises:
        OrthosisError: one exists (and is no regular file, if it is to be replaced) or cannot be written.
    """
    refuse_existing(files, replaced)
    there = {path for path in files if status(path)}
    made: list[Path] = []
    parts: dict[Path, Path] = {}
    new: list[Path] = []
    try:
        for path, write in files.items():
            made = make_folder(path.parent) + made
            with writing(path):
                stream = _new_part(path.parent)
                parts[path] = Path(stream.name)
                with stream:
                    write(stream)
        for path in sorted(parts, key=there.__contains__):
            with writing(path):
                if path not in there:
                    _take_name(path)
                    new.append(path)
                parts[path].replace(path)
    except BaseException:
        for path in (*new, *parts.values()):
            with suppress(OSError):
                path.unlink()
        remove_empty(made)
        raise


def refuse_existing(paths: Iterable[Path], replaced: Container[Path] = ()) -> None:
    """Raise OrthosisError if there is something where a file is to be, or none can be made there.

    So it is known before anything is computed. Of `replaced` a regular file may be there.
    """
    folders = set()
    for path in paths:
        with writing(path):
            if (there := status(path)) and not (path in replaced and stat.S_ISREG(there.st_mode)):
                why = "is no regular file" if path in replaced else "exists"
                raise OrthosisError(f"{path} {why}; choose another --out")
        folders.add(path.parent)
    for folder in folders:
        try_place(folder)


def status(path: Path) -> os.stat_result | None:
    """Return what is known of what is at a path, be it a link; None if nothing is."""
    try:
        return path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return None


def try_place(folder: Path) -> None:
    """Raise OrthosisError if no file can be made in a folder, or in the one that it is to be made in."""
    with writing(folder):
        above = next(one for one in (folder, *folder.parents, Path()) if status(one))
        if not above.is_dir():
            raise OrthosisError(f"{above} is no folder; choose another --out")
        for name in folder.relative_to(above).parts:
            status(above / name)  # too long a name
        with TemporaryFile(dir=above):
            pass


def _new_part(folder: Path) -> BinaryIO:
    part = folder / f"{UNFINISHED}{secrets.token_hex(8)}"
    return open(part, "wb", opener=lambda name, _: os.open(name, NEW_FILE, 0o666))


def _take_name(path: Path) -> None:
    """Make an empty file, which a finished one is to replace: nobody else takes the name meanwhile."""
    os.close(os.open(path, NEW_FILE, 0o666))


def make_folder(path: Path) -> list[Path]:
    """Make a folder with those above; return what was made, innermost first; OrthosisError if it fails."""
    made: list[Path] = []
    with writing(path):
        try:
            for folder in (*reversed(path.parents), path):
                if _made(folder):
                    made.insert(0, folder)
        except BaseException:
            remove_empty(made)
            raise
    return made


def _made(folder: Path) -> bool:
    """Make a folder if it is not there; return whether it was made."""
    try:
        folder.mkdir()
    except OSError as error:  # there already, perhaps on a disk that cannot be written to
        if os.path.isdir(folder):
            return False
        if os.path.lexists(folder):
            raise OrthosisError(f"{folder} is no folder; choose another --out") from error
        raise
    return True


def remove_empty(folders: Iterable[Path]) -> None:
    """Remove folders, the innermost first, as far as they are empty."""
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Keep a folder for this process alone; make it if need be, remove what was made if nothing is in it.

    Raises:
        OrthosisError: another process has it, or it cannot be made.
    """
    made = make_folder(path)
    try:
        with writing(path):
            lock = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            _lock(lock, path)
            yield
        finally:
            remove_empty(made)  # before the lock is: nobody finds a folder that is about to go
            os.close(lock)
    except BaseException:
        remove_empty(made)
        raise


@contextmanager
def claimed(path: Path) -> Iterator[None]:
    """Keep a folder, a new or an empty one, as `locked` does; OrthosisError if something is in it."""
    refuse_used(path)
    with locked(path):
        refuse_used(path)  # another process has just ended
        yield


def _lock(lock: int, path: Path) -> None:
    taken = f"{path} belongs to another run; choose another --out"
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise Used(taken) from None
    except OSError as error:  # some network file systems lock no folders
        if error.errno not in (errno.EBADF, errno.ENOLCK, errno.ENOTSUP, errno.EINVAL):
            raise
    if not path.exists() or not os.path.samestat(os.fstat(lock), path.stat()):
        raise Used(taken)


def refuse_used(folder: Path, instead: str = "") -> None:
    """Raise OrthosisError if there is something where a folder is to be filled, or none can be made there.

    `instead`: what to do, beside choosing another --out.
    """
    with writing(folder):
        used = status(folder) and (not folder.is_dir() or any(_held(folder)))
    if used:
        raise Used(f"{folder} exists and is not an empty folder; choose another --out{instead}")
    try_place(folder)


def _held(folder: Path) -> Iterator[Path]:
    """Yield what is in a folder, but for what a killed process did not finish."""
    return (one for one in folder.iterdir() if not one.name.startswith(UNFINISHED))


@contextmanager
def filled(path: Path) -> Iterator[Path]:
    """Yield a folder of the same name to fill; what is in it in the end goes to the path, at once.

    Raises:
        OrthosisError: as `claimed`; all is as it was.
    """
    with claimed(path):
        unfinished = path / f"{UNFINISHED}{secrets.token_hex(8)}"
        with writing(path):
            unfinished.mkdir()
        try:
            part = unfinished / path.resolve().name
            with writing(path):
                part.mkdir()
            yield part
            with writing(path):
                _move(part, path)
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)


@contextmanager
def placed(path: Path) -> Iterator[Path]:
    """Yield where to make a folder of this name; it is at the path in the end, whole, or not at all.

    Raises:
        OrthosisError: there is something, or nothing can be made there.
    """
    refuse_existing([path])
    made = make_folder(path.parent)
    unfinished = path.parent / f"{UNFINISHED}{secrets.token_hex(8)}"
    try:
        with writing(path):
            unfinished.mkdir()
        yield unfinished / path.name
        refuse_existing([path])
        with writing(path):
            (unfinished / path.name).rename(path)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
        remove_empty(made)


def _move(source: Path, folder: Path) -> None:
    """Move all that is in a folder into another one, or nothing."""
    refuse_existing(folder / one.name for one in source.iterdir())
    moved: list[Path] = []
    try:
        for one in sorted(source.iterdir(), key=lambda one: one.stat().st_mtime_ns):
            moved.append(one.rename(folder / one.name))
    except BaseException:
        for one in moved:
            one.rename(source / one.name)
        raise


def write_folder(path: Path, files: Mapping[str, Write]) -> None:
    """Write a new or empty folder, with all files or not at all; OrthosisError if used or not writable."""
    refuse_used(path)
    part = path.parent / f"{UNFINISHED}{secrets.token_hex(8)}"
    write_files({part / name: write for name, write in files.items()})
    try:
        with writing(path):
            part.rename(path)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn what the system raises when a path is written into the error of this program."""
    try:
        yield
    except FileExistsError as error:
        raise OrthosisError(f"{error.filename or path} exists; choose another --out") from error
    except OSError as error:
        link = "it is a link, and links are not followed" if error.errno == errno.ELOOP else ""
        raise OrthosisError(f"cannot write {path}: {link or error.strerror or error}") from error
