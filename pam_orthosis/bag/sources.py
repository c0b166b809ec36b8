# SPDX-License-Identifier: Apache-2.0
"""Which files hold the data that a path stands for, and whether some are given twice."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from pam_orthosis.errors import OrthosisError

DATA = (".mcap", ".db3")


def data_files(path: Path) -> frozenset[Path]:
    """Return the files, resolved, that hold the data of a bag's folder, or the file itself."""
    inside = [one for one in path.iterdir() if one.suffix in DATA] if path.is_dir() else []
    return frozenset(one.resolve() for one in (inside or [path]))


def check_once(paths: Iterable[Path]) -> None:
    """Refuse, by OrthosisError, data that are given twice, as a bag's folder and a file of it."""
    known: dict[Path, Path] = {}
    for path in paths:
        for file in data_files(path):
            if file in known:
                same = f"{path} and {known[file]} are the same recording"
                problem = f"{path} is given twice" if path == known[file] else same
                raise OrthosisError(f"{problem}, and would count twice; give it once")
        known |= dict.fromkeys(data_files(path), path)


def check_apart(fitted: Sequence[Path], judging: Sequence[Path]) -> None:
    """Refuse, by OrthosisError, data that are given twice among or between those to fit and to judge by."""
    check_once(fitted)
    check_once(judging)
    known = {file for path in fitted for file in data_files(path)}
    for path in judging:
        if data_files(path) & known:
            raise OrthosisError(f"{path} is given to fit and to judge by; leave it out of one of the two")
