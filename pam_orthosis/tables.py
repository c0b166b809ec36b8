# SPDX-License-Identifier: Apache-2.0
"""Tables of numbers: CSV files below one row of names, as spreadsheets and scripts write them."""

import math
from array import array
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from pam_orthosis.errors import OrthosisError
from pam_orthosis.reading import COMMENT, csv_rows, shown


def is_table(path: Path) -> bool:
    """Return whether a file is a table, by its name."""
    return path.suffix.lower() == ".csv"


def read_numbers(path: Path, check: Callable[[Sequence[str]], None] | None = None) -> dict[str, np.ndarray]:
    """Return name -> column of a table. Comments and rows of empty cells are left out.

    `check` is called with the names before the rows are read.

    Raises:
        OrthosisError: unreadable, without names or rows, doubled names, a cell that is no finite number.
    """
    rows = (one for one in csv_rows(path) if _holds_something(one[1]))
    names = [name.strip() for name in next(rows, (0, []))[1]]
    _check_names(path, names)
    if check:
        check(names)
    numbers = array("d")  # row by row: as texts they would take ten times as much
    for line, row in rows:
        numbers.extend(_numbers(path, names, line, row))
    if not numbers:
        raise OrthosisError(f"{path} holds no rows of numbers below its row of names")
    return dict(zip(names, np.frombuffer(numbers).reshape(-1, len(names)).T, strict=True))


def _holds_something(row: Sequence[str]) -> bool:
    return any(cell.strip() for cell in row) and not row[0].lstrip().startswith(COMMENT)


def _check_names(path: Path, names: Sequence[str]) -> None:
    if not names:
        raise OrthosisError(f"{path} is empty")
    doubled = [name for name, count in Counter(names).items() if count > 1]
    if doubled:
        raise OrthosisError(f"{path}: two columns give {shown(doubled[0])}; leave one")


def _numbers(path: Path, names: Sequence[str], line: int, row: Sequence[str]) -> list[float]:
    if len(row) != len(names):
        raise OrthosisError(f"{path}, line {line}: {len(row)} cells below {len(names)} names")
    return [
        _number(cell, f"{path}, line {line}, column {name}") for name, cell in zip(names, row, strict=True)
    ]


def _number(cell: str, where: str) -> float:
    if not cell.strip():
        raise OrthosisError(f"{where}: the cell is empty; write a number or leave the row out")
    try:
        number = float(cell)
    except ValueError as error:
        point = "; write a point in place of the comma" if "," in cell else ""
        raise OrthosisError(f"{where}: {shown(cell)} is no number{point}") from error
    if not math.isfinite(number):
        raise OrthosisError(f"{where}: {shown(cell)} is not finite")
    return number
