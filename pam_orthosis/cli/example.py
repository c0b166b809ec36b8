# SPDX-License-Identifier: Apache-2.0
"""Write recordings that come with the package into a new folder: bags to look at, a case for `gap`."""

import argparse
from pathlib import Path

from pam_orthosis.bag.examples import BAGS, CASES, write_example
from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import output


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument("name", nargs="?", metavar="NAME", help=", ".join([*BAGS, *CASES]))
    parser.add_argument("--list", action="store_true", help="print the examples with their meaning")
    parser.add_argument("--out", type=output, metavar="DIR", help="new folder (NAME)")


def execute(arguments: argparse.Namespace) -> int:
    """Write the example and print its bags, or print which examples there are."""
    if arguments.list:
        print("\n".join(f"{name:10s} {meaning}" for name, meaning in (BAGS | CASES).items()))
        return 0
    if arguments.name is None:
        raise OrthosisError(f"give the name of an example ({', '.join([*BAGS, *CASES])}) or --list")
    folder = arguments.out or Path(arguments.name)
    for bag in write_example(arguments.name, folder):
        print(bag)
    return 0
