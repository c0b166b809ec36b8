# SPDX-License-Identifier: Apache-2.0
"""Train a person on both legs by a programme of stages, in simulation, and record a bag.

The programme is a YAML file: `stages`, each of `strides` (with `cycle_time_s`, `mode`, `stiffness`,
`damping`, `tunnel`) or of `pause_s`; what a stage does not give keeps its value.
A safety monitor watches each leg. `pam-orthosis report` makes a page of the bag.
"""

import argparse
import json
import sys
from contextlib import ExitStack
from pathlib import Path

from pam_orthosis.cli.run import claim
from pam_orthosis.files import output
from pam_orthosis.progress import shown


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument("programme", type=Path, metavar="PROGRAMME", help="YAML file")
    parser.add_argument("--out", type=output, metavar="DIR", help="new bag (runs/session-N)")
    parser.add_argument("--json", action="store_true", help="print what was done as JSON")


def execute(arguments: argparse.Namespace) -> int:
    """Train and record; return 0 if the programme was carried out to its end, 1 if not."""
    from pam_orthosis.bag.session import write_session
    from pam_orthosis.control.programme import read_programme
    from pam_orthosis.control.session import Session

    programme = read_programme(arguments.programme)
    with ExitStack() as stack, shown("session") as progress:
        bag = claim(stack, arguments.out, "session")
        trained = Session(programme).run(progress)
        progress("writing")
        write_session(bag, programme, trained)
    seconds = float(next(iter(trained.signals.values()))["time"][-1])
    print(f"recorded {bag}", file=sys.stderr)
    trips = [
        f"{one.leg} leg, {one.time:.1f} s: {one.limit} {one.value:.4g} beyond {one.allowed:.4g}"
        for one in trained.trips
    ]
    found = {"strides": len(trained.strides), "seconds": round(seconds, 3), "trips": trips,
             "completed": not trained.ended, "ended": trained.ended}  # fmt: skip
    words = [f"{len(trained.strides)} strides in {seconds / 60:.1f} min, {len(trips)} trips", *trips]
    words.append(f"ENDED EARLY: {trained.ended}" if trained.ended else "COMPLETED")
    print(json.dumps(found) if arguments.json else "\n".join(words))
    return int(bool(trained.ended))
