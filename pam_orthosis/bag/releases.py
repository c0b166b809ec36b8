# SPDX-License-Identifier: Apache-2.0
"""When the valves let a machine go instead of leading it: since when, why, and whether it came back.

A machine is released while all its valves vent, whoever asks for that: a guard, the safety monitor, an
emergency stop. Valves that get no commands vent by themselves. Why it was is what the nodes' reports say.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from pam_orthosis.bag.bounded import open_bag
from pam_orthosis.bag.cdr import store
from pam_orthosis.bag.messages import stamp_ns
from pam_orthosis.bag.read import Bag, aligned
from pam_orthosis.bag.topics import ANEW, DIAGNOSTICS, PLANT, POSITION, SAFETY, SECOND_NS, VALVE
from pam_orthosis.control.limits import Trip
from pam_orthosis.errors import OrthosisError
from pam_orthosis.reading import from_json

SHORTEST_NS = 100_000_000  # what is shorter is control, or the last word of a node that leaves
VENTS_WITHIN_NS = 2 * SECOND_NS  # of a trip: a valve closes first, then it vents
APART_NS = 500_000_000  # two releases; and for so long a machine that is back is within the bound
REPORTED_NS = SECOND_NS  # reports come once a second
RETURNS = "returns"  # in the reports of the position controller
ERROR = 2  # level of a report: the node vents until somebody acts
CAUSES = (SAFETY, VALVE, POSITION)  # of reports of one instant, those of a cause before those of its effect
HARDWARE = -1  # order of what a driver says
SESSION = "session"  # of the run metadata: what a programme did
SILENT, BLIND = "no commands", "no samples, so no commands"
CUT_SHORT, UNTOLD = "the run was cut short", "no report tells why"


@dataclass(frozen=True)
class Release:
    """All valves vent, s of the run; `until_s` and `back_s` are None if not before the end of the bag.

    `back_s`: since when the error is within the bound again.
    """

    since_s: float
    until_s: float | None
    back_s: float | None
    reason: str

    @property
    def lasts(self) -> bool:
        """Whether the whole run ended so; one that was cut short vents as it leaves."""
        return self.until_s is None and self.reason != CUT_SHORT

    def __str__(self) -> str:
        """Return it in words."""
        if self.until_s is None:
            return f"at {self.since_s:.3f} s, until the end: {self.reason}"
        back = "not back" if self.back_s is None else f"back at {self.back_s:.3f} s"
        return f"at {self.since_s:.3f} s, for {self.until_s - self.since_s:.3f} s: {self.reason}; {back}"


class Vent(NamedTuple):
    """All valves vent, ns, by themselves if there is a `cause`."""

    since: int
    until: int
    cause: str = ""


class Report(NamedTuple):
    """Why a node says that it vents, and when."""

    stamp_ns: int
    order: int
    reason: str


def releases(
    bag: Bag, lowest: float, tracked: tuple[np.ndarray, np.ndarray], namespace: str
) -> tuple[Release, ...]:
    """Return when the valves of a bag's leg vented; nothing where it does not tell their commands.

    Args:
        bag: with the voltages of the valves, and the pressures that were asked for.
        lowest: the voltage that vents, V.
        tracked: (n,) stamps, ns, and whether the error is within the bound there.
        namespace: of the leg.
    """
    stamps, voltages = _of_all(bag, "voltage")
    if len(stamps) < 2:
        return ()
    sampled = bag[bag.machine.coordinate.name].stamp_ns
    vents = [*_vents(stamps, np.all(np.isclose(voltages, lowest), axis=0)), *_silences(stamps, sampled)]
    vents += _holes(bag, namespace, sampled)
    vents = _joined([_until_led(bag, vent, int(stamps[-1])) for vent in vents])
    reports = sorted([*_reports(bag, namespace), *_trips(bag, namespace, vents)]) if vents else []
    start, last = int(sampled[0]), int(stamps[-1])
    planned_ns = round(bag.parameters.get("scenario.duration", 0.0) * SECOND_NS)
    at_the_end = CUT_SHORT if last - start + APART_NS < planned_ns else UNTOLD

    def told(vent: Vent) -> Release:
        reason, since_s = _reason(reports, vent), (vent.since - start) / SECOND_NS
        if vent.until == last:
            return Release(since_s, None, None, reason or at_the_end)
        reason = reason or vent.cause or UNTOLD
        back = _back(*tracked, vent.until)
        return Release(
            since_s,
            (vent.until - start) / SECOND_NS,
            None if back is None else (back - start) / SECOND_NS,
            reason,
        )

    return tuple(map(told, vents))


def _of_all(bag: Bag, what: str) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return stamps and values of a signal of all actuators, none where the bag lacks one."""
    there = [bag.series[key] for name in bag.machine.names if (key := f"{name}_{what}") in bag.series]
    return aligned(*there) if len(there) == len(bag.machine.names) else (np.empty(0, dtype=np.int64), [])


def _until_led(bag: Bag, vent: Vent, last: int) -> Vent:
    """Return a vent with what follows it: the lowest pressures are asked of a joint that is not yet led."""
    lowest: float = bag.parameters.get("control.position.minimum_pressure", 0.0)
    stamps, asked = _of_all(bag, "pressure_reference")
    if not len(stamps):
        return vent
    led = stamps[(stamps >= vent.until) & np.any(np.array(asked) > lowest * (1 + 1e-9), axis=0)]
    return vent._replace(until=min(int(led[0]), last) if len(led) else last)


def _vents(stamps: np.ndarray, vents: np.ndarray) -> Iterator[Vent]:
    """Yield when all valves are commanded to vent."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], vents.astype(int), [0])))).reshape(-1, 2)
    for first, behind in edges.tolist():
        since, until = int(stamps[first]), int(stamps[min(behind, len(stamps) - 1)])
        if until - since >= SHORTEST_NS:
            yield Vent(since, until)


def _silences(stamps: np.ndarray, sampled: np.ndarray) -> Iterator[Vent]:
    """Yield when valves vent because their commands stay away, though there are samples."""
    for since, until, silence_ns in _gaps(stamps):
        if np.any((sampled > since) & (sampled < until)):
            yield Vent(since + silence_ns, until, SILENT)


def _holes(bag: Bag, namespace: str, sampled: np.ndarray) -> Iterator[Vent]:
    """Yield when there were no samples and the joint was led back behind; else only the bag has a hole."""
    gaps = list(_gaps(sampled))
    returns = list(_returns(bag, namespace)) if gaps else []
    for since, until, _ in gaps:
        before = max((count for at, count in returns if at <= since), default=0)
        behind = max((count for at, count in returns if at <= until + 2 * REPORTED_NS), default=0)
        if behind > before:
            yield Vent(since, until, BLIND)


def _gaps(stamps: np.ndarray) -> Iterator[tuple[int, int, int]]:
    """Yield from when to when, ns, nothing came for so long, ns, that valves vent."""
    passed = np.diff(stamps)
    silence_ns = 20 * int(np.median(passed))
    for index in np.flatnonzero(passed > silence_ns * 1.05).tolist():
        yield int(stamps[index]), int(stamps[index + 1]), silence_ns


def _joined(vents: list[Vent]) -> list[Vent]:
    """Join what is near in time: a guard that tries whether actuators answer has not taken hold yet."""
    joined: list[Vent] = []
    for vent in sorted(vents):
        if joined and vent.since - joined[-1].until < APART_NS:
            last = joined.pop()
            joined.append(Vent(last.since, max(last.until, vent.until), last.cause or vent.cause))
        else:
            joined.append(vent)
    return joined


def _back(stamps: np.ndarray, near: np.ndarray, until: int) -> int | None:
    """Return since when, ns, a machine that is led again is within the bound, and stays there."""
    later = stamps >= until
    stamps, near = stamps[later], near[later]
    edges = np.flatnonzero(np.diff(np.concatenate(([0], near.astype(int), [0])))).reshape(-1, 2)
    spans = ((int(stamps[first]), int(stamps[behind - 1])) for first, behind in edges.tolist())
    return next((since for since, last in spans if last - since >= APART_NS), None)


def _reason(reports: list[Report], vent: Vent) -> str:
    """Return what the first report on a release says; one that is over when it comes tells of it too.

    The hardware's own failure is before what guards make of it.
    """
    failed = (one for one in reports if one.order == HARDWARE)
    for one in failed:
        if vent.since - REPORTED_NS <= one.stamp_ns <= vent.until + REPORTED_NS:
            return one.reason
    there = (one.reason for one in reports if vent.since <= one.stamp_ns <= vent.until + REPORTED_NS)
    return next(there, "")


def _reports(bag: Bag, namespace: str) -> Iterator[Report]:
    """Yield what the nodes of a leg say of why they vent."""
    for at_ns, node, status in _statuses(bag, namespace):
        if ": " not in status.name:  # a driver, which has no loop; its message is its state, and why
            if status.level == ERROR and ": " in status.message:
                yield Report(at_ns, HARDWARE, f"{node} {status.message}")
        elif reason := _said(status):
            yield Report(at_ns, CAUSES.index(node) if node in CAUSES else len(CAUSES), reason)


def _trips(bag: Bag, namespace: str, vents: list[Vent]) -> Iterator[Report]:
    """Yield the trips in the record of a session, each at the vent that it led to."""
    for leg, trip in _recorded_trips(bag):
        begun = (max(vent.since, trip.time_ns) for vent in vents if vent.until >= trip.time_ns)
        at_ns = next(begun, trip.time_ns)
        if leg == namespace.strip("/") and at_ns - trip.time_ns <= VENTS_WITHIN_NS:
            yield Report(at_ns, CAUSES.index(SAFETY), str(trip))


def _recorded_trips(bag: Bag) -> list[tuple[str, Trip]]:
    """Return the trips in the record of a session by leg, if there is one; OrthosisError if it is damaged."""
    if not (record := bag.run.get(SESSION)):
        return []
    kept = from_json(record, str(bag.path))
    try:
        return [
            (leg, Trip(limit, float(value), float(allowed), round(time_s * SECOND_NS)))
            for leg, limit, time_s, value, allowed in kept["trips"]
        ]
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise OrthosisError(f"{bag.path}: the record of the session is damaged") from error


def begun_anew(bag: Bag, namespace: str) -> str:
    """Return when the hardware says that it began while the run was on, if it does."""
    for _, node, status in _statuses(bag, namespace):
        for one in status.values if node == PLANT else ():
            if one.key == ANEW:
                return str(one.value)
    return ""


def _returns(bag: Bag, namespace: str) -> Iterator[tuple[int, int]]:
    """Yield when, ns, the position controller reports, and how often it has led the joint back by then."""
    for at_ns, node, status in _statuses(bag, namespace):
        for one in status.values if node == POSITION else ():
            if one.key == RETURNS and one.value.isdecimal():
                yield at_ns, int(one.value)


def _statuses(bag: Bag, namespace: str) -> Iterator[tuple[int, str, Any]]:
    """Yield stamp, node and status of what the nodes of a leg report."""
    group = namespace.strip("/")
    with open_bag(bag.path) as reader:
        connections = [one for one in reader.connections if one.topic == DIAGNOSTICS]
        for connection, _, data in reader.messages(connections) if connections else ():
            message: Any = store().deserialize_cdr(data, connection.msgtype)
            for status in message.status:
                leg, _, node = status.name.removesuffix(": loop").rpartition("/")
                if leg == group:
                    yield stamp_ns(message), node, status


def _said(status: Any) -> str:
    """Return why a node vents, or has since its last report."""
    if status.level == ERROR:
        return str(status.message)
    values = {one.key: one.value for one in status.values}
    return values.get("released") or values.get("vent") or ""
