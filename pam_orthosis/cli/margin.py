# SPDX-License-Identifier: Apache-2.0
"""Measure the margins of the closed loop: how far the hardware may change before the machine follows badly.

One property of the emulated hardware at a time is changed, more and less: the loop's delay, the joint's
friction, the muscles' hysteresis, the valve's lag, the supply, the masses. The controllers stay as they are.
For each, the value is found at which the maximum error has doubled, and the one at which the machine is
lost: the error is beyond control.guard.tracking_error (20 deg for the knee), a guard vents, or the actuators
cannot hold it at the start. The first change that is tried is small, each further one twice as large; then
the limit is bisected to a tenth of the change (or an eighth of the first one). Where nothing happens up to
the end of the range, the end is printed, such as "> 50". Exit status 0: measured.
"""

import argparse
import json
import os
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from pam_orthosis.cli.parameters import add_model_argument, add_parameter_arguments, chosen, with_model
from pam_orthosis.files import as_text, claimed, output, write_files
from pam_orthosis.progress import shown


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    add_parameter_arguments(parser, "what the machine does (default)")
    add_model_argument(parser)
    parser.add_argument(
        "--duration", type=float, default=6.0, metavar="S", help="simulated seconds a run (6)"
    )
    parser.add_argument(
        "--out",
        type=output,
        metavar="DIR",
        help="new folder for page, table, picture and all runs (margin.json)",
    )
    parser.add_argument("--json", action="store_true", help="print limits and all runs as JSON")


def execute(arguments: argparse.Namespace) -> int:
    """Measure and print; return 0."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # units share the cores; set before numpy is loaded
    from pam_orthosis.batch.margin import measure

    parameters = with_model(chosen(arguments, {"scenario.duration": arguments.duration}), arguments)
    with claimed(arguments.out) if arguments.out else nullcontext(), shown("margins") as progress:
        margins = measure(parameters, os.cpu_count() or 1, progress)
        _show({"scenario": arguments.scenario, **margins}, arguments.out, arguments.json)
    return 0


def _show(found: dict[str, Any], folder: Path | None, as_json: bool) -> None:
    from pam_orthosis.report import margin
    from pam_orthosis.report.picture import draw

    table, text = margin.table(found), json.dumps(found, indent=2)
    if folder:
        write_files({
            folder / "margin.json": as_text(text + "\n"),
            folder / "margin.md": as_text(table + "\n"),
            folder / "margin.html": as_text(margin.page(found)),
            folder / "margin.png": lambda stream: draw(margin.plots(found), stream, 3),
        })  # fmt: skip
    print(text if as_json else table)
