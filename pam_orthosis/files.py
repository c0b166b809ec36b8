# SPDX-License-Identifier: Apache-2.0
"""Files that are whole or not there at all."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from pam_orthosis.errors import OrthosisError


def bag_name(path: Path) -> str:
    """Return the name of a bag: that of its folder, or of its file without the ending."""
    return path.name.removesuffix(".mcap")


def write_text(path: Path, text: str) -> None:
    """Write a text as a whole, its folder too if need be; all is as it was if that fails.

    Raises:
        OrthosisError: it cannot be written.
    """
    write_whole(path, lambda part: part.write_text(text, encoding="utf-8"))


def write_whole(path: Path, write: Callable[[Path], Any]) -> None:
    """Let `write` fill a file beside the path, then put it in its place; make its folder if need be.

    Raises:
        OrthosisError: it cannot be written; all is as it was.
    """
    made = make_folder(path.parent)
    part = path.with_name(f".{path.name}.part")
    with told(path):
        try:
            write(part)
            part.replace(path)
        except BaseException:
            if os.path.lexists(part):
                part.unlink()
            remove_empty(made)
            raise


def make_folder(path: Path) -> list[Path]:
    """Make a folder with those above it; return what was made, for `remove_empty`.

    Raises:
        OrthosisError: it cannot be made.
    """
    with told(path):
        made = [folder for folder in (path, *path.parents) if not folder.exists()]
        path.mkdir(parents=True, exist_ok=True)
    return made


def remove_empty(folders: Iterable[Path]) -> None:
    """Remove folders, the innermost first, as far as they are empty."""
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()


@contextmanager
def told(path: Path) -> Iterator[None]:
    """Turn what the system says against writing to a path into the error of this program."""
    try:
        yield
    except OSError as error:
        raise OrthosisError(f"cannot write {path}: {error.strerror or error}") from error
