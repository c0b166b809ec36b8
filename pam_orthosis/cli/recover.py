# SPDX-License-Identifier: Apache-2.0
"""Copy what is whole of a damaged or unclosed bag into a new, readable bag."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from pam_orthosis.files import bag_name

if TYPE_CHECKING:
    from pam_orthosis.bag.salvage import Loss


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument("bag", type=Path, metavar="BAG", help="bag folder or .mcap file")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the new bag (BAG-recovered)")


def execute(arguments: argparse.Namespace) -> int:
    """Recover the bag."""
    from pam_orthosis.bag.recover import recover  # what reads bags takes its time to load

    bag = arguments.bag.resolve()
    out = arguments.out or bag.with_name(f"{bag_name(bag)}-recovered")
    recovered = recover(bag, out)
    print(f"{recovered.messages} messages recovered into {out}")
    if recovered.left_out:
        print(f"left out: {recovered.left_out} messages of topics that are not ROS 2 topics (cdr, ros2msg)")
    for loss in recovered.lost:
        print(f"lost: {_told(loss)}")
    return 0


def _told(loss: Loss) -> str:
    if loss.first_ns is None or loss.last_ns is None:
        return f"{loss.size} bytes"
    return f"{loss.size} bytes, of messages from {loss.first_ns / 1e9:.3f} to {loss.last_ns / 1e9:.3f} s"
