# SPDX-License-Identifier: Apache-2.0
"""Draw the paper's figures again, and show its results beside those of the emulation."""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from pam_orthosis.cli.identify import FIGURES
from pam_orthosis.files import REMAKE, as_bytes, as_text, output, refuse_existing, write_files
from pam_orthosis.model.parameters import load
from pam_orthosis.progress import Progress, shown

if TYPE_CHECKING:
    from pam_orthosis.identification.identify import Identified
    from pam_orthosis.report.paper.table import Results

MUSCLE = "dmsp_20"
SCHEMES = ("device.png", "rig.png", "rig_control.png", "mechanics.png", "knee_control.png")
PICTURES = ("observer.png", "trade_off.png", "tracking.png", *SCHEMES, *FIGURES)


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
    page, pictures = arguments.out / "paper.md", arguments.out / "pictures"
    refuse_existing(
        [page, page.with_suffix(".html"), *(pictures / name for name in PICTURES)],
        arguments.overwrite,
        REMAKE,
    )
    with shown("compiling the model") as progress:
        found = _made(page, pictures, arguments.overwrite, progress)
    print(json.dumps(found.as_dict(), indent=2) if arguments.json else page)
    return 0


def _made(page: Path, pictures: Path, overwrite: bool, progress: Progress) -> Results:
    """Make all results, the page and its pictures."""
    from pam_orthosis.report.identification import drawn
    from pam_orthosis.report.pages import paper as pages
    from pam_orthosis.report.paper import (  # matplotlib takes a second
        by_hand,
        drawings,
        figures,
        force_rate,
        inertia,
        observer,
        table,
        tracking,
    )

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
    files = {
        pictures / "observer.png": lambda stream: figures.draw_observer(observed, stream),
        pictures / "trade_off.png": lambda stream: figures.draw_trade_off(points, observed, stream),
        pictures / "tracking.png": lambda stream: figures.draw_tracking(found.tracking, stream),
        **{pictures / f"{name}.png": as_bytes(png) for name, png in schematic.items()},
        **drawn(identified, pictures),
        page: as_text(table.page(found)),
        page.with_suffix(".html"): as_text(pages.page(found, schematic)),
    }
    write_files(files, overwrite)
    return found


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
