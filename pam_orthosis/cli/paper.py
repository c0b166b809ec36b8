# SPDX-License-Identifier: Apache-2.0
"""Draw the paper's figures again, and show its results beside those of the emulation."""

from __future__ import annotations

import argparse
import json
import tempfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from pam_orthosis.files import Write, as_bytes, as_text, output
from pam_orthosis.model.parameters import load
from pam_orthosis.progress import Progress, shown
from pam_orthosis.results import refuse_foreign, write_results

if TYPE_CHECKING:
    from pam_orthosis.identification.identify import Identified
    from pam_orthosis.report.paper.table import Results

MUSCLE = "dmsp_20"
FIGURES = ("force.png", "residual.png", "volume.png")  # of `report.identification`
SCHEMES = ("device.png", "rig.png", "rig_control.png", "mechanics.png", "knee_control.png")
PICTURES = ("observer.png", "trade_off.png", "tracking.png", *SCHEMES, *FIGURES)
PAGES = "paper.md", "paper.html"
FOLDER = "pictures"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument(
        "--out", type=output, metavar="DIR", default=Path("runs/paper"),
        help="folder of paper.md, paper.html and pictures (runs/paper)",
    )  # fmt: skip
    parser.add_argument("--overwrite", action="store_true", help="replace the page and its pictures")
    parser.add_argument("--json", action="store_true", help="print the numbers as JSON")


def execute(arguments: argparse.Namespace) -> int:
    """Make the runs, draw, write the page."""
    refuse_foreign(arguments.out, (*PAGES, *(f"{FOLDER}/{name}" for name in PICTURES)), arguments.overwrite)
    with shown("compiling the model") as progress:
        found, files = _made(progress)
        write_results(arguments.out, files, arguments.overwrite)
    print(json.dumps(found.as_dict(), indent=2) if arguments.json else arguments.out / PAGES[0])
    return 0


def _made(progress: Progress) -> tuple[Results, dict[str, Write]]:
    """Make all results; return them, and what writes the page and its pictures."""
    from pam_orthosis.report.identification import drawn
    from pam_orthosis.report.pages import paper as pages
    from pam_orthosis.report.paper import (  # matplotlib takes a second
        by_hand,
        drawings,
        force_rate,
        inertia,
        observer,
        table,
        tracking,
    )
    from pam_orthosis.report.picture import draw

    identified = _identified(progress)
    progress("fig. 8: observer")
    observed = observer.observe()
    on_hardware, points = observer.observe(exact=False), observer.trade_off(progress=progress)
    progress("fig. 9: tracking")
    tracked = tracking.track()
    moved, compared = by_hand.all_moved(progress), force_rate.compared(progress)
    found = table.Results(
        identified, observed, on_hardware, points, tracked, moved, compared, inertia.compared()
    )
    progress("drawing the figures")
    schematic = drawings.schemes()
    pictures: dict[str, Write] = {
        "observer.png": partial(draw, pages.observer_plots(observed)),
        "trade_off.png": partial(draw, pages.trade_off_plots(points, observed), columns=3),
        "tracking.png": partial(draw, pages.tracking_plots(tracked), columns=2),
        **{f"{name}.png": as_bytes(png) for name, png in schematic.items()},
        **drawn(identified),
    }
    texts = as_text(table.page(found)), as_text(pages.page(found, schematic))
    placed = {f"{FOLDER}/{name}": write for name, write in pictures.items()}
    return found, placed | dict(zip(PAGES, texts, strict=True))


def _identified(progress: Progress) -> Identified:
    """Record the procedure of sections 2.4 and 2.5 on the emulated rig and identify the muscle from it."""
    from pam_orthosis.cli import rig
    from pam_orthosis.identification.data import read_data
    from pam_orthosis.identification.identify import identify

    parameters = load()
    held_out = [p - parameters.valve.ambient_pressure for p in parameters.rig.procedure.held_out_pressures]
    with tempfile.TemporaryDirectory() as folder:
        rig.record_tests(parameters, MUSCLE, rig.IDENTIFICATION, Path(folder), progress)
        return identify(read_data([Path(folder)], progress=progress), held_out, progress=progress)
