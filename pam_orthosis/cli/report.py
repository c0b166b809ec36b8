# SPDX-License-Identifier: Apache-2.0
"""Show a recorded run: an offline page (plots, leg, verdict), pictures, or a table (CSV, MATLAB)."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from pam_orthosis.cli.check import add_bound_arguments, bound_of, describe
from pam_orthosis.files import (
    REMAKE,
    Write,
    as_text,
    bag_name,
    output,
    refuse_existing,
    refuse_used,
    write_files,
)
from pam_orthosis.progress import counted, shown


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument("bag", type=Path, metavar="BAG", help="bag folder or .mcap file")
    parser.add_argument(
        "--out", type=output, metavar="DIR", help="folder of page and picture (a new one, BAG-report, here)"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an earlier report of that name")
    add_bound_arguments(parser)
    parser.add_argument(
        "--only",
        choices=("page", "picture", "animation", "table", "mat"),
        help="make one of them (page and picture); mat: a table for MATLAB",
    )
    parser.add_argument("--namespace", default="", metavar="NS", help="namespace of the leg in the bag")


def execute(arguments: argparse.Namespace) -> int:
    """Write what is asked for and say where."""
    bag = arguments.bag.resolve()
    folder = arguments.out or Path(f"{bag_name(bag)}-report")
    if not (arguments.out or arguments.overwrite):
        refuse_used(folder, REMAKE)
    leg = arguments.namespace.strip("/").replace("/", "-")
    name = f"{bag_name(bag)}{leg and '-'}{leg}"
    makers = {"page": ("html", _page), "picture": ("png", _picture), "table": ("csv", _table),
              "mat": ("mat", _mat), "animation": ("gif", _animation)}  # fmt: skip
    kinds = [arguments.only] if arguments.only else ["page", "picture"]
    paths = {kind: folder / f"{name}.{makers[kind][0]}" for kind in kinds}
    refuse_existing(paths.values(), arguments.overwrite, REMAKE)
    with shown(f"reading {arguments.bag}") as progress:
        made = [makers[kind][1](bag, arguments) for kind in counted(kinds, progress, "drawing")]
        progress(f"writing {folder}")
        write_files(dict(zip(paths.values(), made, strict=True)), arguments.overwrite)
    print(*paths.values(), sep="\n")
    return 0


def _page(bag: Path, arguments: argparse.Namespace) -> Write:
    from pam_orthosis.bag.verdict import judge
    from pam_orthosis.report.run_data import read_run
    from pam_orthosis.report.run_page import run_page

    verdict = judge(bag, bound_of(arguments), namespace=arguments.namespace)
    return as_text(run_page(read_run(bag, arguments.namespace), verdict, describe(verdict)))


def _picture(bag: Path, arguments: argparse.Namespace) -> Write:
    from pam_orthosis.bag.read import recorded_machine
    from pam_orthosis.bag.verdict import bound_in
    from pam_orthosis.report.walk import draw_run  # matplotlib takes a second to load

    bound = bound_in(bound_of(arguments), recorded_machine(bag))
    return partial(draw_run, bag, bound, arguments.namespace)


def _table(bag: Path, arguments: argparse.Namespace) -> Write:
    from pam_orthosis.report.table import write_table

    return partial(write_table, bag, arguments.namespace)


def _mat(bag: Path, arguments: argparse.Namespace) -> Write:
    from pam_orthosis.report.table import write_mat

    return partial(write_mat, bag, arguments.namespace)


def _animation(bag: Path, arguments: argparse.Namespace) -> Write:
    from pam_orthosis.report.animation import write_animation

    return partial(write_animation, bag, arguments.namespace)
