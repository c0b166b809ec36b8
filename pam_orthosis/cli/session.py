# SPDX-License-Identifier: Apache-2.0
"""Train a person on both legs by a programme of stages, emulated, and record a bag.

The programme is a YAML file: `stages`, each of `strides` (with `cycle_time_s`, `mode`, `stiffness`,
`damping`, `tunnel`) or of `pause_s`; what a stage does not give keeps its value.
A safety monitor watches each leg. `pam-orthosis report` makes a page of the bag. With --graph the ROS nodes
of both legs do it, led by their parameters and services; the run is as long as the programme takes without
trips, and --spare seconds.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from pam_orthosis.cli.run import beside, claim, last_words, need_ros, simulated, supervise_recorded
from pam_orthosis.errors import OrthosisError, RunFailed
from pam_orthosis.files import output
from pam_orthosis.progress import shown
from pam_orthosis.reading import from_json

if TYPE_CHECKING:
    from pam_orthosis.control.programme import Programme
    from pam_orthosis.control.session import Trained


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument("programme", type=Path, metavar="PROGRAMME", help="YAML file")
    parser.add_argument("--out", type=output, metavar="DIR", help="new bag (runs/session-N)")
    parser.add_argument("--graph", action="store_true", help="with the ROS nodes of both legs")
    parser.add_argument("--composed", action="store_true", help="with --graph: one process a leg")
    parser.add_argument(
        "--spare", type=float, default=0.0, metavar="S", help="with --graph: time for stops by a monitor (0)"
    )
    parser.add_argument("--json", action="store_true", help="print what was done as JSON")


def execute(arguments: argparse.Namespace) -> int:
    """Train and record; return 0 if the programme was carried out to its end, 1 if not."""
    from pam_orthosis.control.programme import read_programme

    programme = read_programme(arguments.programme)
    if arguments.graph:
        need_ros()
    elif arguments.composed or arguments.spare:
        raise OrthosisError("--composed and --spare are for --graph")
    with ExitStack() as stack:
        bag = claim(stack, arguments.out, "session")
        trained, seconds = (_by_graph if arguments.graph else _by_cores)(programme, bag, arguments)
    print(f"recorded {bag}", file=sys.stderr)
    return _show(trained, seconds, arguments.json)


def _show(trained: Trained, seconds: float, as_json: bool) -> int:
    trips = [
        f"{one.leg} leg, {one.time:.1f} s: {one.limit} {one.value:.4g} beyond {one.allowed:.4g}"
        for one in trained.trips
    ]
    found = {"strides": len(trained.strides), "seconds": round(seconds, 3), "trips": trips,
             "completed": not trained.ended, "ended": trained.ended}  # fmt: skip
    words = [
        f"{_count(len(trained.strides), 'stride')} in {seconds / 60:.1f} min, {_count(len(trips), 'trip')}",
        *trips,
    ]
    words.append(f"ENDED EARLY: {trained.ended}" if trained.ended else "COMPLETED")
    print(json.dumps(found) if as_json else "\n".join(words))
    return int(bool(trained.ended))


def _count(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _by_cores(programme: Programme, bag: Path, _arguments: argparse.Namespace) -> tuple[Trained, float]:
    from pam_orthosis.bag.session import write_session
    from pam_orthosis.control.session import Session

    with shown("session") as progress:
        trained = Session(programme).run(progress)
        progress("writing")
        write_session(bag, programme, trained)
    return trained, float(next(iter(trained.signals.values()))["time"][-1])


def _by_graph(programme: Programme, bag: Path, arguments: argparse.Namespace) -> tuple[Trained, float]:
    from pam_orthosis.bag.session import differing, write_beside
    from pam_orthosis.control.session import as_led, planned_seconds, trained_in
    from pam_orthosis.nodes import launch

    late = 2.0  # s that the conductor may be
    seconds = planned_seconds(programme) + late + arguments.spare
    first, own = differing({name: as_led(one, programme, seconds) for name, one in programme.legs.items()})
    mode = launch.Mode(arguments.composed, legs=own)
    with (
        tempfile.TemporaryDirectory(prefix="pam-orthosis-") as folder,
        launch.free_domain() as domain,
        shown(f"ROS domain {domain}: starting the nodes") as progress,
    ):
        work = Path(folder)
        environment = launch.environment(work, domain)
        commands = launch.commands(work, first, bag.resolve(), programme.scenario, mode)
        command = launch.conductor_command(arguments.programme)
        with _led(command, environment, work) as conductor:
            supervise_recorded(
                commands, environment, work, simulated(progress, seconds, domain), bag.resolve()
            )
        trained = trained_in(from_json(conductor[0], "session_conductor"))
    write_beside(bag, programme, trained)
    return trained, seconds


@contextmanager
def _led(command: list[str], environment: Mapping[str, str], work: Path) -> Iterator[list[str]]:
    """Lead a run for as long as it lasts; what was done is in the list then, or RunFailed is raised."""
    log, said = work / "session_conductor.log", list[str]()
    with beside(command, environment, log) as conductor:
        yield said
        conductor.terminate()
        with suppress(subprocess.TimeoutExpired):
            said.append(conductor.communicate(timeout=10.0)[0])
    if not said or not said[0].strip():
        raise RunFailed(f"the session's conductor failed: {last_words(log)}")
