# SPDX-License-Identifier: Apache-2.0
"""Copy what is whole of a damaged or unclosed bag into a new, readable bag."""

from __future__ import annotations

import argparse
from pathlib import Path

from pam_orthosis.files import bag_name


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument("bag", type=Path, metavar="BAG", help="bag folder or .mcap file")
    parser.add_argument("--out", type=Path, help="folder of the new bag (BAG-recovered)")


def execute(arguments: argparse.Namespace) -> int:
    """Recover the bag."""
    from pam_orthosis.bag.recover import recover  # what reads bags takes its time to load

    bag = arguments.bag.resolve()
    out = arguments.out or bag.with_name(f"{bag_name(bag)}-recovered")
    print(f"{recover(bag, out)} messages recovered into {out}")
    return 0
