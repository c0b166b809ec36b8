# SPDX-License-Identifier: Apache-2.0
"""Draw a recorded run: the walking leg, angle, error and pressures, as a picture."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument("bag", type=Path, metavar="BAG", help="bag folder or .mcap file")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the picture (beside the bag)")


def execute(arguments: argparse.Namespace) -> int:
    """Write the picture and say where."""
    from pam_orthosis.report.walk import write_walk  # matplotlib takes a second to load

    bag = arguments.bag.resolve()
    file = (arguments.out or bag.parent) / f"{bag.stem}.png"
    write_walk(bag, file)
    print(file)
    return 0
