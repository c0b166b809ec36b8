# SPDX-License-Identifier: Apache-2.0
"""Tables of numbers: CSV files below one row of names, as spreadsheets and scripts write them."""

import math
import re
from array import array
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from datetime import datetime
from pathlib import Path

import numpy as np

from pam_orthosis.errors import OrthosisError
from pam_orthosis.reading import COMMENT, csv_rows, shown

Choose = Callable[[Sequence[str]], Collection[str] | None]
MARKS = {",": "comma", ".": "point"}
CLOCK = re.compile(r"\d:\d\d|\d{4}-\d\d-\d\d")  # in dates and times of the day
STAMP = re.compile(
    r"((?P<day>\d{4}-\d\d-\d\d)[T ])?(?P<clock>\d\d:\d\d:\d\d)([.,](?P<fraction>\d+))?"
    r"(?P<zone>Z|[-+]\d\d:\d\d)?"
)
HALF_A_DAY = 43_200.0  # s
NUMBER = re.compile(r"[-+]?([.,]?\d|nan|inf)", re.IGNORECASE)  # how numbers begin, and no units


def is_table(path: Path) -> bool:
    """Return whether a file is a table, by its name."""
    return path.suffix.lower() == ".csv"


def read_numbers(
    path: Path, choose: Choose | None = None, lost: bool = False, dated: Choose | None = None
) -> dict[str, np.ndarray]:
    """Return name -> column of a table. Comments and rows of empty cells are left out.

    Args:
        path: of the table.
        choose: called with the names before the rows are read; it returns which columns are (None: all).
        lost: an empty cell, or NaN, is NaN; else it is refused.
        dated: as `choose`; columns that may hold dates or times of the day, read as s since the first one.

    Raises:
        OrthosisError: unreadable, without names or rows, doubled names, a cell that is no finite number.
    """
    rows = _rows(path)
    names, parting = _names(rows)
    _check_names(path, names)
    chosen = choose(names) if choose else None
    wanted = [(at, name) for at, name in enumerate(names) if chosen is None or name in chosen]
    read, numbers = _Cells(parting, lost), array("d")  # as texts they would take ten times as much
    readers: dict[str, _Stamps] = {name: _Stamps(read) for name in (dated and dated(names)) or ()}
    for line, row, _ in rows:
        if len(row) != len(names):
            raise OrthosisError(f"{path}, line {line}: {len(row)} cells below {len(names)} names")
        if not numbers:
            read.check_units([row[at] for at, _ in wanted], f"{path}, line {line}")
        numbers.extend(
            readers.get(name, read).number(row[at], f"{path}, line {line}, column {name}")
            for at, name in wanted
        )
    if not numbers:
        raise OrthosisError(f"{path} holds no rows of numbers below its row of names")
    columns = np.frombuffer(numbers).reshape(-1, len(wanted)).T
    return {name: values for (_, name), values in zip(wanted, columns, strict=True)}


def names_of(path: Path) -> list[str]:
    """Return the names of a table's columns, unchecked; none if it is empty.

    Raises:
        OrthosisError: unreadable, or no table.
    """
    return _names(_rows(path))[0]


def _rows(path: Path) -> Iterator[tuple[int, list[str], str]]:
    """Yield line number, cells, and what parts them, of the rows that hold something."""
    return (one for one in csv_rows(path) if _holds_something(one[1]))


def _names(rows: Iterator[tuple[int, list[str], str]]) -> tuple[list[str], str]:
    """Return the names in the first of some rows, and what parts cells."""
    _, cells, parting = next(rows, (0, [], ","))
    return [name.strip() for name in cells], parting


def _holds_something(row: Sequence[str]) -> bool:
    return any(cell.strip() for cell in row) and not row[0].lstrip().startswith(COMMENT)


def _check_names(path: Path, names: Sequence[str]) -> None:
    if not names:
        raise OrthosisError(f"{path} is empty")
    doubled = [name for name, count in Counter(names).items() if name and count > 1]
    if doubled:
        raise OrthosisError(f"{path}: two columns give {shown(doubled[0])}; leave one")


class _Cells:
    """What cells hold as numbers: with decimal commas where no commas part the columns."""

    def __init__(self, parting: str, lost: bool):
        self.commas, self.lost, self.mark = parting != ",", lost, ""

    def check_units(self, cells: Sequence[str], where: str) -> None:
        """Refuse a first row that is words alone, by OrthosisError: they may be units."""
        words = [text for text in map(str.strip, cells) if text]
        if not words or any(map(NUMBER.match, words)):
            return
        example = ", as `time [ms]`," if self.lost else ""
        raise OrthosisError(
            f"{where}: {shown(words[0])} is no number; if this is a row of units, leave it out and write them"
            f" in the names{example} above"
        )

    def number(self, cell: str, where: str) -> float:
        """Return the number of a cell; OrthosisError if it has none."""
        text = cell.strip()
        if not text and not self.lost:
            raise OrthosisError(f"{where}: the cell is empty; write a number or leave the row out")
        try:
            plain = text.replace("_", "?")  # Python would read 1_5 as 15
            number = float((plain.replace(",", ".") if self.commas else plain) or "nan")
        except ValueError as error:
            raise OrthosisError(f"{where}: {shown(cell)} is no number; {self._hint(text)}") from error
        if not (math.isfinite(number) or (self.lost and math.isnan(number))):
            raise OrthosisError(f"{where}: {shown(cell)} is not finite; leave the row out")
        self._check_mark(text, where)
        return number

    def _hint(self, text: str) -> str:
        """Return what to write in place of a text that is no number."""
        if CLOCK.search(text):
            read = self.lost and not text[:4].isdigit()  # such a date is not read where time has a unit
            dates = ", or as dates such as 2026-03-29T01:59:55.002" if read else ""
            return f"write time in seconds, as a number such as 0.002{dates}"
        if "," in text:
            return f"write {'no sign between thousands' if self.commas else 'a point in place of the comma'}"
        missing = "leave the cell empty, or write NaN," if self.lost else "leave the row out"
        return f"{missing} if the value is missing"

    def _check_mark(self, text: str, where: str) -> None:
        """Check that a table has decimal points or commas: beside the other, one parts thousands."""
        mark = "," if "," in text else "." if "." in text else self.mark
        if self.mark and mark != self.mark:
            raise OrthosisError(
                f"{where}: {shown(text)} has a {MARKS[mark]}, numbers before it have a {MARKS[self.mark]};"
                " write decimals with one of them, and no sign between thousands"
            )
        self.mark = mark


class _Stamps:
    """Cells of a column that may hold dates or times of the day: s since the first one, to 1 us."""

    def __init__(self, cells: _Cells):
        self._cells, self._numbers = cells, False
        self._first: tuple[datetime, tuple[bool, bool]] | None = None  # and whether it lacks day and zone

    def number(self, cell: str, where: str) -> float:
        """Return the s of a cell; OrthosisError if it is not written as those before it."""
        found = STAMP.fullmatch(cell.strip())
        if found is None or self._numbers:
            number = self._cells.number(cell, where)
            self._numbers |= not math.isnan(number)
            if self._numbers and self._first:
                raise OrthosisError(f"{where}: {shown(cell)} is a number below dates; write one or the other")
            return number
        instant, form = _instant(found, where), (found["day"] is None, found["zone"] is None)
        first, first_form = self._first = self._first or (instant, form)
        if form != first_form:
            raise OrthosisError(f"{where}: {shown(cell)} is not written as the dates above; write all alike")
        if found["day"] is None and (first - instant).total_seconds() > HALF_A_DAY:
            raise OrthosisError(f"{where}: the clock passes midnight: write the dates too")
        return (instant - first).total_seconds()


def _instant(found: re.Match[str], where: str) -> datetime:
    """Return the instant of a stamp; OrthosisError if there is none."""
    day, zone = found["day"] or "2000-01-01", (found["zone"] or "").replace("Z", "+00:00")
    fraction = (found["fraction"] or "")[:6].ljust(6, "0")
    try:
        return datetime.fromisoformat(f"{day} {found['clock']}.{fraction}{zone}")
    except ValueError as error:
        raise OrthosisError(f"{where}: {shown(found[0])}: there is no such time: {error}") from error
