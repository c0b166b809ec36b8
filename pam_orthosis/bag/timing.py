# SPDX-License-Identifier: Apache-2.0
"""How fast a run in real time answered its samples, from its bag alone."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pam_orthosis.bag.bounded import open_bag
from pam_orthosis.bag.cdr import store
from pam_orthosis.bag.topics import ANSWERED, JOINT, SAMPLE, SECOND_NS, TIME_REFERENCE, resolve


@dataclass(frozen=True)
class Timing:
    """Latency: from the instant of a sample until the voltages that answer it leave.

    `missed_deadlines` counts, of all `periods`, those whose sample was answered later than one period
    after it, was never answered, or was skipped because the machine was too busy to take it.
    """

    periods: int
    skipped_samples: int
    deadline_ms: float
    missed_deadlines: int
    latency_median_ms: float
    latency_p99_ms: float
    latency_max_ms: float


def timing(path: Path, namespace: str = "", period_s: float | None = None) -> Timing | None:
    """Return the timing of a bag that can be read; None if it is of no run in real time.

    The period is that of most samples, if it is not given.
    """
    samples, _ = _instants(path, resolve(SAMPLE, namespace))
    answers, left = _instants(path, resolve(ANSWERED, namespace))
    if len(samples) < 2 or not np.isin(answers, samples).any():
        return None
    period_ns = int(np.median(np.diff(samples))) if period_s is None else round(period_s * SECOND_NS)
    return judge_timing(samples, dict(zip(answers.tolist(), left.tolist(), strict=True)), period_ns)


def judge_timing(samples: np.ndarray, answered: dict[int, int], period_ns: int) -> Timing:
    """Return the timing of samples (n,) ns, n > 1, with stamp -> instant of the answer, ns."""
    latency = np.array([answered[stamp] - stamp for stamp in samples.tolist() if stamp in answered])
    periods = max(len(samples), round((samples[-1] - samples[0]) / period_ns) + 1)
    median, p99 = np.percentile(latency, [50, 99]) if len(latency) else (np.nan, np.nan)
    return Timing(
        periods=periods,
        skipped_samples=periods - len(samples),
        deadline_ms=period_ns / 1e6,
        missed_deadlines=periods - int(np.count_nonzero(latency <= period_ns)),
        latency_median_ms=float(median) / 1e6,
        latency_p99_ms=float(p99) / 1e6,
        latency_max_ms=float(latency.max()) / 1e6 if len(latency) else np.nan,
    )


def _instants(path: Path, topic: str) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps, ns, and the instants that the messages name, or else their stamps again."""
    rows = []
    types = JOINT, TIME_REFERENCE
    with open_bag(path) as reader:
        connections = [one for one in reader.connections if one.topic == topic and one.msgtype in types]
        # without a connection the reader would give every message there is
        for connection, _, data in reader.messages(connections) if connections else ():
            message: Any = store().deserialize_cdr(data, connection.msgtype)
            stamp = message.header.stamp
            rows.append([_ns(stamp), _ns(getattr(message, "time_ref", stamp))])
    table = np.array(sorted(rows), dtype=np.int64).reshape(-1, 2)
    return table[:, 0], table[:, 1]


def _ns(stamp: Any) -> int:
    return int(stamp.sec * SECOND_NS + stamp.nanosec)
