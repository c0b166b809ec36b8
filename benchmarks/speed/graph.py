# SPDX-License-Identifier: Apache-2.0
"""Lockstep steps of the node graph, at one rate and at two, against relays of the same messages."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from pam_orthosis.bag.topics import RECORDER
from pam_orthosis.control.legs import device_parameters
from pam_orthosis.model.device import device_named, entry_of
from pam_orthosis.model.parameters import load
from pam_orthosis.nodes import launch
from speed.rows import Goal, Row, alternating, row
from speed.stepping import Pace, watched
from speed.tables import nodes

RATE_HZ = 500
PERIOD_NS = round(1e9 / RATE_HZ)
ONE, DEVICE = "knee", "device"  # graphs
SLOW_HZ = 100  # of the position controller, where it is slower than the pressure controllers
STEPS = {False: 120, True: 250}  # composed?
ENDLESS = {"scenario.duration": 3600.0, "scenario.control_period": 1 / RATE_HZ}
FLOOR = Goal("at most 1.5 times the relays", at_most=1.5)
REAL_TIME = {
    False: Goal("at least real time", at_least=1.0),
    True: Goal("at least 4 times real time", at_least=4.0),
}

Spent = tuple[float, float]  # time and processor time of a step, us


def rows(repeats: int) -> Iterator[Row]:
    """Yield the rows: in processes and composed, with and without a recorder."""
    import rclpy  # noqa: F401  without it there is nothing to measure

    for composed in (False, True):
        layout = "one process" if composed else "processes"
        for recorded in (False, True):
            ours, floor = alternating(
                repeats,
                lambda c=composed, r=recorded: stepped(c, r),
                lambda c=composed, r=recorded: relayed(c, r),
            )
            recorder = "recorder included" if recorded else "without recorder"
            yield from steps(f"{layout}, {recorder}", ours, floor)
        yield from real_time(f"{RATE_HZ} Hz, {layout}, recorder included", REAL_TIME[composed], ours, floor)
        yield from _at_two_rates(repeats, composed, layout)


def _at_two_rates(repeats: int, composed: bool, layout: str) -> Iterator[Row]:
    """Yield the rows of a slower position controller, recorder included."""
    every = RATE_HZ // SLOW_HZ
    ours, floor = alternating(
        repeats, lambda: stepped(composed, True, every), lambda: relayed(composed, True, every)
    )
    where = f"{RATE_HZ} Hz, position {SLOW_HZ} Hz, {layout}, recorder included"
    yield from steps(where, ours, floor, " at")
    yield from real_time(where, REAL_TIME[composed], ours, floor)


def steps(
    where: str, ours: Sequence[Spent], floor: Sequence[Spent], joined: str = ",", group: str = "graph"
) -> Iterator[Row]:
    """Yield the rows that compare the time and the processor time of a step with those of the relays."""
    what = f"a step{joined} {where}"
    (elapsed, used), (floor_elapsed, floor_used) = (zip(*side, strict=True) for side in (ours, floor))
    yield row(group, what, "us", elapsed, floor_elapsed, FLOOR)
    yield row(group, f"processor time of {what}", "us", used, floor_used, FLOOR)


def real_time(
    where: str, goal: Goal, ours: Sequence[Spent], floor: Sequence[Spent], group: str = "graph"
) -> Iterator[Row]:
    """Yield the rows that compare the time of a step with the wall clock, and with relays."""
    what = f"simulated time at {where}"
    factors, relays_factors = ([1e6 / RATE_HZ / elapsed for elapsed, _ in side] for side in (ours, floor))
    yield row(group, what, "x real time", factors, goal=goal)
    yield row(group, f"{what}, beside that of the relays", "x real time", factors, relays_factors)


def stepped(composed: bool, recorded: bool, every: int = 1, graph: str = ONE) -> tuple[float, float]:
    """Return the time and the processor time of a step of the graph, us."""
    made = commands_of(composed, recorded, every) if graph == ONE else device_commands()
    return _microseconds(watched(made, PERIOD_NS, STEPS[composed]))


def commands_of(composed: bool, recorded: bool, every: int = 1) -> Callable[[Path], dict[str, list[str]]]:
    """Return what makes the commands of the graph in a folder."""
    parameters = load({**ENDLESS, "control.position.every": every})

    def commands(work: Path) -> dict[str, list[str]]:
        made = launch.commands(work, parameters, work / "bag", "default", launch.Mode(composed=composed))
        return made if recorded else _without_recorder(made)

    return commands


def device_commands() -> Callable[[Path], dict[str, list[str]]]:
    """Return what makes the command of the device's graph, one process with its recorder, in a folder."""
    joints = device_parameters(device_named(Path(DEVICE)), ENDLESS)
    legs = {name: entry_of(one) for name, one in joints.items()}
    first, mode = next(iter(joints.values())), launch.Mode(composed=True, legs=legs, one_plant=True)
    return lambda work: launch.commands(work, first, work / "bag", "default", mode)


def _microseconds(pace: Pace) -> tuple[float, float]:
    return 1e6 * pace.seconds_per_step, 1e6 * pace.processor_seconds_per_step


def _without_recorder(commands: dict[str, list[str]]) -> dict[str, list[str]]:
    made = {}
    for name, (python, _, _, executable, *rest) in commands.items():
        if name != RECORDER:
            roles = [] if executable == launch.COMPOSED else [name]
            others = [word for word in rest if word != RECORDER]
            made[name] = [python, "-m", "speed.unrecorded", *roles, *others]
    return made


def relayed(composed: bool, recorded: bool, every: int = 1, graph: str = ONE) -> tuple[float, float]:
    """Return the time and the processor time of a step of the relays, us."""
    return _microseconds(watched(relays(composed, recorded, every, graph), PERIOD_NS, STEPS[composed]))


def relays(
    composed: bool, recorded: bool, every: int = 1, graph: str = ONE
) -> Callable[[Path], dict[str, list[str]]]:
    """Return what makes the commands of the relays in a folder."""
    roles = [node for node in nodes(graph) if recorded or node != RECORDER]

    def commands(work: Path) -> dict[str, list[str]]:
        folder = str(work / "bag") if recorded else "-"
        base = [sys.executable, "-m", "speed.relay", f"{graph}:{PERIOD_NS}x{every}", folder]
        return {"relays": [*base, *roles]} if composed else {role: [*base, role] for role in roles}

    return commands
