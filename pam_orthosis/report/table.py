# SPDX-License-Identifier: Apache-2.0
"""A recorded run as a table, for programs that read no bags: CSV, or MATLAB's `.mat`; SI units."""

import csv
import math
from io import TextIOWrapper
from pathlib import Path
from typing import BinaryIO

from pam_orthosis.bag.sampled import sampled


def write_table(bag_path: Path, namespace: str, stream: BinaryIO) -> None:
    """Write all signals of a bag at the stamps of the measured coordinate; `time` is in s since the first.

    A cell is empty where a topic has no message of that stamp. Names and units are those of
    `bag.topics.Topics`; `gap` reads such a table.
    """
    run = sampled(bag_path, namespace)
    columns = [map(_cell, values.tolist()) for values in (run.time, *run.signals.values())]
    text = TextIOWrapper(stream, encoding="utf-8", newline="")
    writer = csv.writer(text)
    writer.writerow(["time", *run.signals])
    writer.writerows(zip(*columns, strict=True))
    text.detach()  # flushes, and leaves the stream open


def _cell(value: float) -> str:
    """Return text that reads back to the bit."""
    return "" if math.isnan(value) else repr(value)


def write_mat(bag_path: Path, namespace: str, stream: BinaryIO) -> None:
    """Write the same for MATLAB, NaN where nothing has that stamp; OrthosisError for an unusable bag."""
    from scipy.io import savemat  # takes its time to load

    run = sampled(bag_path, namespace)
    savemat(stream, {"time": run.time, **run.signals}, oned_as="column")
