# SPDX-License-Identifier: Apache-2.0
"""Walk, find the effects that are missing in the nominal model, add them, walk again with the same gains.

Recordings are made in one process without ROS; `run --model DIR/model.yaml` lets the real nodes walk with the
improved model.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pam_orthosis.cli.parameters import add_parameter_arguments, check_controllable, chosen
from pam_orthosis.files import as_text, locked, output, refuse_used, write_files
from pam_orthosis.progress import Shown, shown

if TYPE_CHECKING:
    from pam_orthosis.improvement.rounds import Round

RESULTS = "model.yaml", "improve.json", "improve.md", "improve.png", "improve.html"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    add_parameter_arguments(parser, "motion and person (default)")
    parser.add_argument(
        "--seeds", type=_positive, default=3, metavar="N", help="noise seeds of the runs that judge (3)"
    )
    parser.add_argument("--rounds", type=_positive, default=3, metavar="N", help="rounds at most (3)")
    parser.add_argument(
        "--out", type=output, required=True, metavar="DIR", help="folder of model, table, figure and bags"
    )
    parser.add_argument("--json", action="store_true", help="print the rounds as JSON")


def execute(arguments: argparse.Namespace) -> int:
    """Improve; return 0 if the machine follows better in the end, 1 if not."""
    # the search has threads of its own; set before numpy is loaded
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with shown("compiling the model") as progress:
        rounds, table = _improved(arguments, progress)
    print(json.dumps([one.as_dict() for one in rounds], indent=2) if arguments.json else table)
    return 0 if any(one.kept for one in rounds[1:]) else 1


def _improved(arguments: argparse.Namespace, progress: Shown) -> tuple[Sequence[Round], str]:
    """Make what is missing of the rounds and the files; return the rounds and their table."""
    from pam_orthosis.improvement import resumed
    from pam_orthosis.improvement.rounds import improve

    parameters = chosen(arguments)
    check_controllable(parameters)
    machine = parameters.declared
    seeds = [parameters.scenario.seed + number for number in range(arguments.seeds)]
    given = parameters.flat() | {"seeds": seeds, "rounds": arguments.rounds, "scenario": arguments.scenario}
    given |= {"machine": machine.text} if machine.text else {}
    if not (arguments.out / resumed.STATE).exists():
        refuse_used(arguments.out)
    with locked(arguments.out):
        if resumed.begin(arguments.out, resumed.digest(given), RESULTS):
            progress.note(f"continuing what was begun in {arguments.out}")
        rounds = improve(parameters, arguments.scenario, arguments.out, seeds, arguments.rounds, progress)
        progress("writing the results")
        return rounds, _write(arguments.out, rounds)


def _write(folder: Path, rounds: Sequence[Round]) -> str:
    """Write model, rounds, table and figure; return the table."""
    from pam_orthosis.discrepancy.answer import patch
    from pam_orthosis.report import improvement
    from pam_orthosis.report.picture import draw

    data = [one.as_dict() for one in rounds]
    table = improvement.table(data)
    contents = (
        as_text(patch.text(rounds[-1].model)),
        as_text(json.dumps(data, indent=2) + "\n"),
        as_text(table),
        lambda stream: draw(improvement.plots(rounds), stream),
        as_text(improvement.page(rounds, table)),
    )
    write_files({folder / name: write for name, write in zip(RESULTS, contents, strict=True)})
    return table


def _positive(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 100:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 1 to 100")
    return int(text)
