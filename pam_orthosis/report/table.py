# SPDX-License-Identifier: Apache-2.0
"""A recorded run as a CSV table, for programs that read no bags: one row a sample, SI units."""

from __future__ import annotations

import csv
from io import TextIOWrapper
from pathlib import Path
from typing import BinaryIO

import numpy as np

from pam_orthosis.bag.read import read_bag, recorded_machine
from pam_orthosis.bag.topics import SECOND_NS, Topics


def write_table(bag_path: Path, namespace: str, stream: BinaryIO) -> None:
    """Write all signals of a bag at the stamps of the measured coordinate; `time` is in s since the first.

    A cell is empty where a topic has no message of that stamp. Names and units are those of
    `bag.topics.Topics`; `gap` reads such a table.

    Raises:
        OrthosisError: the bag is unusable.
    """
    sampled, *others = known = list(Topics(recorded_machine(bag_path)).signals)
    bag = read_bag(bag_path, [sampled], others, namespace)
    stamps = bag[sampled].stamp_ns
    names = [name for name in known if name in bag.series]
    time = [repr(second) for second in ((stamps - stamps[0]) / SECOND_NS).tolist()]
    columns = [time, *(_cells(stamps, *bag[name]) for name in names)]
    text = TextIOWrapper(stream, encoding="utf-8", newline="")
    writer = csv.writer(text)
    writer.writerow(["time", *names])
    writer.writerows(zip(*columns, strict=True))
    text.detach()  # flushes, and leaves the stream open


def _cells(stamps: np.ndarray, own: np.ndarray, value: np.ndarray) -> list[str]:
    """Return the values at stamps as text that reads back to the bit."""
    place = np.minimum(np.searchsorted(own, stamps), len(own) - 1)
    there = own[place] == stamps
    return [
        repr(one) if known else "" for one, known in zip(value[place].tolist(), there.tolist(), strict=True)
    ]
