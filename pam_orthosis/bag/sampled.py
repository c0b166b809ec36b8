# SPDX-License-Identifier: Apache-2.0
"""All signals of a bag on one grid: the stamps of the measured coordinate."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from pam_orthosis.bag.read import Bag, Series, read_bag, recorded_machine
from pam_orthosis.bag.topics import SECOND_NS, Topics


class Sampled(NamedTuple):
    """A bag, the stamps (n,) ns of its measured coordinate, and each signal there, (n,) SI.

    A value is NaN where the signal's topic has no message of that stamp.
    """

    bag: Bag
    stamps_ns: np.ndarray
    signals: dict[str, np.ndarray]

    @property
    def time(self) -> np.ndarray:
        """Seconds since the first stamp, (n,)."""
        return since_first(self.stamps_ns)


def since_first(stamps_ns: np.ndarray) -> np.ndarray:
    """Return seconds since the first stamp, (n,)."""
    seconds: np.ndarray = (stamps_ns - stamps_ns[0]) / SECOND_NS
    return seconds


def sampled(path: Path, namespace: str = "") -> Sampled:
    """Read all signals of a bag, named as in `bag.topics.Topics`; OrthosisError if it is unusable."""
    first, *others = known = list(Topics(recorded_machine(path, namespace)).signals)
    bag = read_bag(path, [first], others, namespace)
    stamps = bag[first].stamp_ns
    return Sampled(bag, stamps, {name: at_stamps(stamps, bag[name]) for name in known if name in bag.series})


def at_stamps(stamps: np.ndarray, series: Series) -> np.ndarray:
    """Return a signal at stamps (n,), NaN where it has no sample."""
    place = np.minimum(np.searchsorted(series.stamp_ns, stamps), len(series.stamp_ns) - 1)
    return np.where(series.stamp_ns[place] == stamps, series.value[place], np.nan)
