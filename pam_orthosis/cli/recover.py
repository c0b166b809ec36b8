# SPDX-License-Identifier: Apache-2.0
"""Copy what is whole of a damaged or unclosed bag into a new, readable bag."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import bag_name, output
from pam_orthosis.progress import Progress, shown

if TYPE_CHECKING:
    from pam_orthosis.bag.recover import Recovered
    from pam_orthosis.bag.salvage import Loss


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument("bag", type=Path, metavar="BAG", help="bag folder or .mcap file")
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--out", type=output, metavar="DIR", help="folder of the new bag (BAG-recovered, here)"
    )
    where.add_argument(
        "--in-place",
        action="store_true",
        help="close a bag whose recorder was killed where it is, by cutting off the torn end;"
        " quick, and needs no space",
    )
    parser.add_argument("--json", action="store_true", help="print what was recovered as JSON")


def execute(arguments: argparse.Namespace) -> int:
    """Recover the bag."""
    bag = arguments.bag.resolve()
    out = arguments.bag if arguments.in_place else arguments.out or Path(f"{bag_name(bag)}-recovered")
    with shown(f"reading {arguments.bag}") as progress:
        recovered = _recovered(bag, None if arguments.in_place else out, progress)
    if arguments.json:
        print(json.dumps({"bag": str(out), **recovered.as_dict()}, indent=2))
        return 0
    print(f"{recovered.messages} messages recovered into {out}")
    for one in recovered.left_out:
        print(f"left out: {one.messages} messages of {one.topic}: {one.why}")
    for loss in recovered.lost:
        print(f"lost: {_told(loss)}")
    return 0


def _recovered(bag: Path, out: Path | None, progress: Progress) -> Recovered:
    """Recover a bag into a new one, or close it where it is."""
    from pam_orthosis.bag.recover import Recovered, recover, recover_in_place  # takes its time to load
    from pam_orthosis.bag.unclosed import Damaged

    if out:
        return recover(bag, out, progress)
    try:
        return Recovered(recover_in_place(bag), (), ())
    except Damaged as error:
        raise OrthosisError(f"{error}; leave --in-place out: what is whole is copied then") from error


def _told(loss: Loss) -> str:
    if loss.first_ns is None or loss.last_ns is None:
        return f"{loss.size} bytes"
    return f"{loss.size} bytes, of messages from {loss.first_ns / 1e9:.3f} to {loss.last_ns / 1e9:.3f} s"
