# SPDX-License-Identifier: Apache-2.0
"""Walk, find the effects that are missing in the nominal model, add them, walk again with the same gains.

Recordings are made in one process without ROS; `run --model DIR/model.yaml` lets the real nodes walk with the
improved model.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path

from pam_orthosis.files import as_text, claimed, output, write_files
from pam_orthosis.model.parameters import load, scenario_overrides


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument("--scenario", default="default", metavar="NAME", help="motion and person (default)")
    parser.add_argument(
        "--seeds", type=_positive, default=3, metavar="N", help="noise seeds of the runs that judge (3)"
    )
    parser.add_argument("--rounds", type=_positive, default=3, metavar="N", help="rounds at most (3)")
    parser.add_argument(
        "--out", type=output, required=True, metavar="DIR", help="folder of model, table, figure and bags"
    )
    parser.add_argument(
        "--param", action="append", default=[], metavar="KEY=VALUE", help="set a parameter (repeatable)"
    )
    parser.add_argument("--json", action="store_true", help="print the rounds as JSON")


def execute(arguments: argparse.Namespace) -> int:
    """Improve; return 0 if the knee follows better in the end, 1 if not."""
    # the search has threads of its own; set before numpy is loaded
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from pam_orthosis.cli.run import assignments
    from pam_orthosis.improvement.rounds import improve

    parameters = load(scenario_overrides(arguments.scenario) | assignments(arguments.param))
    seeds = [parameters.scenario.seed + number for number in range(arguments.seeds)]
    with claimed(arguments.out):
        rounds = improve(parameters, arguments.scenario, arguments.out, seeds, arguments.rounds, _progress())
        _write(arguments.out, rounds, arguments.json)
    return 0 if any(one.kept for one in rounds[1:]) else 1


def _write(folder: Path, rounds, as_json: bool) -> None:
    from pam_orthosis.discrepancy import patch
    from pam_orthosis.report import improvement

    told = [one.as_dict() for one in rounds]
    table = improvement.table(told)
    write_files({
        folder / "model.yaml": as_text(patch.text(rounds[-1].model)),
        folder / "improve.json": as_text(json.dumps(told, indent=2) + "\n"),
        folder / "improve.md": as_text(table),
        folder / "improve.png": lambda stream: improvement.draw(rounds, stream),
    })  # fmt: skip
    print(json.dumps(told, indent=2) if as_json else table)


def _progress():
    start = time.monotonic()

    def tell(line: str) -> None:
        print(f"[{time.monotonic() - start:5.1f} s] {line}", file=sys.stderr, flush=True)

    return tell


def _positive(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 100:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 1 to 100")
    return int(text)
