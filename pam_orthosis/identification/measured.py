# SPDX-License-Identifier: Apache-2.0
"""What a measured table holds: force of a muscle, its volume, or a free decay."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.errors import OrthosisError
from pam_orthosis.identification.groups import levels
from pam_orthosis.identification.samples import (
    DERIVATIVE_SAMPLES,
    Decay,
    Samples,
    Volumes,
    check_even,
    differentiated,
)
from pam_orthosis.identification.table import Table, read_table

BREAK = 10.0  # times the usual step: the recording was stopped in between
MOST = 300  # runs of a table, and repeats: each is left out in turn


class Parts(NamedTuple):
    """What a table holds.

    `marked`: it says where the muscle hangs slack; `unread`: its other columns; `copies`: rows left out, as
    they repeat an earlier one, time included.
    """

    samples: Samples | None = None
    decay: Decay | None = None
    volumes: Volumes | None = None
    marked: bool = False
    unread: tuple[str, ...] = ()
    copies: int = 0


def table_parts(path: Path, nominal: float, ambient: float, serial: int) -> Parts:
    """Return what a table holds whose first run has this number; nominal length in m, ambient pressure in Pa.

    Raises:
        OrthosisError: as `read_table`, lengths that do not fit the nominal one, a decay with gaps.
    """
    table, copies = _without_copies(read_table(path, ambient))
    contraction = table.contraction if table.length is None else nominal - table.length
    assert contraction is not None  # a table has one of the two
    _check_lengths(path, contraction, nominal, begins=table.length is not None and table.mass is None)
    if table.volume is not None:
        return Parts(volumes=Volumes(table.pressure, contraction, table.volume), unread=table.unread)
    _check_time(path, table.time)
    if table.mass is not None:
        return Parts(decay=_decay(path, table, table.mass, contraction), unread=table.unread)
    samples = _samples(path, table, contraction, serial)
    return Parts(samples, marked=table.marked, unread=table.unread, copies=copies)


def _without_copies(table: Table) -> tuple[Table, int]:
    """Return a table without rows that repeat an earlier one at the same time, and how many those are."""
    if table.time is None or len(np.unique(table.time)) == len(table.time):
        return table, 0
    columns = {name: one for name, one in table._asdict().items() if isinstance(one, np.ndarray)}
    first = np.unique(np.column_stack(list(columns.values())), axis=0, return_index=True)[1]
    kept = np.sort(first)
    rows = {name: one[kept] for name, one in columns.items()}
    return Table(**rows, marked=table.marked, unread=table.unread), len(table.time) - len(kept)


def _check_lengths(path: Path, contraction: np.ndarray, nominal: float, begins: bool) -> None:
    """Refuse contractions that no muscle has; `begins`: the least one must be small, too.

    A decay swings about any contraction, and one that was measured as such needs no nominal length.
    """
    shares = (-0.05, 0.1, 0.4)  # of the nominal length: least contraction (two bounds), largest one
    low, first, last = (share * nominal for share in shares)
    if contraction.min() < low or (begins and contraction.min() > first) or contraction.max() > last:
        raise OrthosisError(
            f"{path}: lengths do not fit a nominal length of {nominal:g} m: contractions from"
            f" {contraction.min():.4g} to {contraction.max():.4g} m, they begin at {low:.4g} to {first:.4g} m"
            f" and end below {last:.4g} m; give --nominal-length-m or --muscle, and check the unit"
        )


def _check_time(path: Path, time: np.ndarray | None) -> None:
    if time is not None and not (steps := np.diff(time)).all():
        raise OrthosisError(
            f"{path}: two rows have the time {time[np.argmin(steps != 0)]:g} s; write it with more digits, or"
            " leave its column out"
        )


def _check_count(path: Path, what: str, numbers: np.ndarray, advice: str) -> None:
    if (count := len(np.unique(numbers))) > MOST:
        raise OrthosisError(f"{path}: {count} {what}, {MOST} at most; {advice}")


def _decay(path: Path, table: Table, mass: np.ndarray, contraction: np.ndarray) -> Decay:
    if table.time is None:
        raise OrthosisError(f"{path}: a decay (it has a moved mass) needs a column for the time, e.g. t_s")
    if np.ptp(mass) > 0:
        raise OrthosisError(f"{path}: the moved mass changes; give one decay a table")
    if len(table.time) < DERIVATIVE_SAMPLES:
        raise OrthosisError(f"{path} is too short: {len(table.time)} samples")
    check_even(path, np.round(table.time * SECOND_NS))
    shown = table.force is not None and np.ptp(table.force) > 0  # one force, written in, is none measured
    force = table.force if shown else None
    time = table.time - table.time[0]
    return Decay(time, contraction, table.pressure, force, float(mass[0]), str(path))


def _samples(path: Path, table: Table, contraction: np.ndarray, serial: int) -> Samples:
    assert table.force is not None  # a table without volume and mass has it
    zero = np.zeros(len(table.force))
    sigma = table.sigma if table.sigma is not None else zero + 1.0
    rate, sense, run = table.rate, table.direction, zero - 1
    if table.repeat is not None:
        _check_count(path, "repeats", table.repeat, "number whole measurements, not their rows")
    if table.time is not None:
        run = serial + _runs(table.time)
        _check_count(path, "runs (the time goes back or leaps)", run, "sort the rows, or drop the time")
        rate, sense = _moved(table.pressure, table.time, contraction, run, rate, sense)
    return Samples(
        table.pressure, contraction, zero if rate is None else rate, table.force, sigma,
        levels(table.pressure), run, zero if sense is None else sense,
        zero if table.repeat is None else table.repeat,
    )  # fmt: skip


def _runs(time: np.ndarray) -> np.ndarray:
    """Return a number for each row, another one after the time goes back or leaps."""
    steps = np.diff(time)
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    return np.concatenate([[0], np.cumsum((steps < 0) | (steps > BREAK * usual))])


def _moved(
    pressure: np.ndarray,
    time: np.ndarray,
    contraction: np.ndarray,
    run: np.ndarray,
    rate: np.ndarray | None,
    sense: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return rate of the contraction, m/s, and direction of each row, where the table does not give them."""
    moved, filled, travelled = (np.zeros(len(run)) for _ in range(3))
    for one in np.unique(run):
        rows = run == one
        moved[rows] = _slope(contraction[rows], time[rows])
        filled[rows] = _slope(pressure[rows], time[rows])
        travelled[rows] = np.ptp(contraction[rows])
    given = moved if rate is None else rate
    still = 1.0e-3  # m: a run that moves less was held at one length, and its pressure has the direction
    if sense is None:
        sense = np.where(travelled > still, _direction(given), _direction(filled))
    return given, sense


def _slope(values: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return a rate by local least squares, after the mean step; zero for a few rows."""
    if len(values) < DERIVATIVE_SAMPLES:
        return np.zeros(len(values))
    return differentiated(values, np.linspace(time[0], time[-1], len(time)) * SECOND_NS)


def _direction(rate: np.ndarray) -> np.ndarray:
    fast = np.quantile(np.abs(rate), 0.95)
    slow = 0.1  # of the fast changes (95 %): slower ones have no direction
    return np.asarray(np.sign(rate) * (np.abs(rate) > slow * fast))


def numbered_repeats(parts: Sequence[Samples]) -> list[Samples]:
    """Return samples with the number of their repeat, over all tables and bags.

    Each counts from its own first number: repeats 1 to 3 of two tables at the same pressures are six. Its
    numbers are raised together until each is new at its pressures. At other pressures they stay, and the
    same number is the same repeat, which may be spread over several tables or bags.
    """
    known: dict[float, set[int]] = {}
    found = []
    for one in parts:
        rows = ((number, one.level[one.repeat == number]) for number in np.unique(one.repeat).tolist())
        own = {number: set(np.round(level, -4).astype(int).tolist()) for number, level in rows}
        raised = next(by for by in count() if not _known(own, known, by))
        for number, pressures in own.items():
            known[number + raised] = known.get(number + raised, set()) | pressures
        found.append(replace(one, repeat=one.repeat + raised))
    return found


def _known(own: Mapping[float, set[int]], known: Mapping[float, set[int]], raised: int) -> bool:
    """Return whether a raised number has the pressures of its repeat already."""
    shared = 0.5  # of the pressures of a repeat
    return any(
        len(pressures & known.get(number + raised, set())) >= shared * len(pressures)
        for number, pressures in own.items()
    )
