# SPDX-License-Identifier: Apache-2.0
"""Show a recorded run: a page that opens offline (plots, leg, verdict), pictures, or a CSV table."""

from __future__ import annotations

import argparse
from pathlib import Path

from pam_orthosis.cli.check import describe, not_negative
from pam_orthosis.files import bag_name, write_text


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument("bag", type=Path, metavar="BAG", help="bag folder or .mcap file")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of page and picture (beside the bag)")
    parser.add_argument(
        "--bound-deg", type=not_negative, default=3.0, help="bound on the largest error, degrees (3)"
    )
    parser.add_argument(
        "--only",
        choices=("page", "picture", "animation", "table"),
        help="make one of them (page and picture)",
    )
    parser.add_argument("--namespace", default="", metavar="NS", help="namespace of the leg in the bag")


def execute(arguments: argparse.Namespace) -> int:
    """Write what is asked for and say where."""
    bag = arguments.bag.resolve()
    folder = arguments.out or bag.parent
    leg = arguments.namespace.strip("/").replace("/", "-")
    makers = {"page": ("html", _page), "picture": ("png", _picture), "table": ("csv", _table),
              "animation": ("gif", _animation)}  # fmt: skip
    for name in [arguments.only] if arguments.only else ["page", "picture"]:
        ending, make = makers[name]
        file = folder / f"{bag_name(bag)}{leg and '-'}{leg}.{ending}"
        make(bag, file, arguments)
        print(file)
    return 0


def _page(bag: Path, file: Path, arguments: argparse.Namespace) -> None:
    from pam_orthosis.bag.verdict import judge
    from pam_orthosis.report.run_data import read_run
    from pam_orthosis.report.run_page import run_page  # plotly takes a second to load

    verdict = judge(bag, arguments.bound_deg, namespace=arguments.namespace)
    page = run_page(read_run(bag, arguments.namespace), verdict, describe(verdict))
    write_text(file, page)


def _picture(bag: Path, file: Path, arguments: argparse.Namespace) -> None:
    from pam_orthosis.report.walk import write_walk  # matplotlib takes a second to load

    write_walk(bag, file, arguments.bound_deg, arguments.namespace)


def _table(bag: Path, file: Path, arguments: argparse.Namespace) -> None:
    from pam_orthosis.report.table import write_table

    write_table(bag, file, arguments.namespace)


def _animation(bag: Path, file: Path, arguments: argparse.Namespace) -> None:
    from pam_orthosis.report.animation import write_animation

    write_animation(bag, file, arguments.namespace)
