# SPDX-License-Identifier: Apache-2.0
"""Do the same to many bags, or walk with many parameter sets: on all cores, or on a cluster."""

from __future__ import annotations

import argparse
import json
import os
import shlex
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pam_orthosis.cli.check import add_bound_arguments, bound_of, not_negative
from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import as_text, output
from pam_orthosis.progress import shown

if TYPE_CHECKING:
    from pam_orthosis.batch.unit import Unit

PROGRAM = "pam_orthosis.cli.main"
TASKS = {
    "check": "judge the tracking of each bag",
    "gap": "find missing effects, bag by bag",
    "report": "a page of each bag",
    "study": "walk with each parameter set and seed of a study (YAML), without ROS; judge each walk",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    tasks = "; ".join(f"{name}: {meaning}" for name, meaning in TASKS.items())
    parser.add_argument("task", choices=TASKS, metavar="TASK", help=tasks)
    parser.add_argument("inputs", type=Path, nargs="+", metavar="INPUT", help="bags, or the file of a study")
    parser.add_argument("--out", type=output, required=True, metavar="DIR",
                        help="results, one folder for each bag; finished bags are not repeated")  # fmt: skip
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--workers", type=at_least_1, metavar="N", help="processes at a time (number of cores)"
    )
    where.add_argument(
        "--cluster", metavar="ADDRESS", help="address of a Dask scheduler, e.g. tcp://host:8786"
    )
    parser.add_argument(
        "--retries", type=_whole, default=1, metavar="N", help="further tries for a bag that fails (1)"
    )
    parser.add_argument(
        "--timeout", type=not_negative, metavar="S", help="seconds after which a bag counts as failed"
    )
    add_bound_arguments(parser)
    parser.add_argument("--with", dest="more", default="", metavar="ARGUMENTS",
                        help="more arguments for the task, e.g. --with='--skip-s 2'")  # fmt: skip
    parser.add_argument("--overwrite", action="store_true", help="replace the page of a batch of more bags")
    parser.add_argument("--json", action="store_true", help="print the summary as JSON")


def execute(arguments: argparse.Namespace) -> int:
    """Work off all; return 0 if all say yes, 1 if one says no, 3 if one failed."""
    from pam_orthosis.batch.batch import PAGE, Batch
    from pam_orthosis.batch.unit import cluster, local
    from pam_orthosis.report.pages.batch import page

    batch = Batch(_units(arguments), arguments.out, arguments.overwrite)
    if batch.skipped:
        print(f"{len(batch.skipped)} done before", file=sys.stderr)
    where = (
        cluster(arguments.cluster) if arguments.cluster else local(arguments.workers or os.cpu_count() or 1)
    )
    with shown("starting") as progress, where as (executor, lives):

        def show(line: str) -> None:
            progress.note(line)
            progress("working", batch.done, len(batch.units))

        progress("working", batch.done, len(batch.units))
        batch.run(executor, lives, arguments.retries, show)
    summary = batch.summary()
    batch.write(PAGE, as_text(page(summary, batch.results)))
    print(json.dumps(summary, indent=2) if arguments.json else describe(summary))
    return 3 if summary["failed"] else 1 if summary["no"] else 0


def describe(summary: dict[str, Any]) -> str:
    """Return the summary in words."""
    yes, no, failed = (summary[key] for key in ("yes", "no", "failed"))
    lines = [f"no: {', '.join(no)}"] if no else []
    lines += [f"failed: {name} ({one['tries']} tries): {one['why']}" for name, one in failed.items()]
    return "\n".join([*lines, f"{len(yes)} yes, {len(no)} no, {len(failed)} failed"])


def _units(arguments: argparse.Namespace) -> list[Unit]:
    from pam_orthosis.bag.verdict import bound_in
    from pam_orthosis.batch.unit import Unit
    from pam_orthosis.cli.main import verb_parser
    from pam_orthosis.model.machines import machine_named

    task, seconds = arguments.task, arguments.timeout
    try:
        more = tuple(shlex.split(arguments.more))
    except ValueError as error:
        raise OrthosisError(f"--with {arguments.more!r}: {error}") from None
    if task == "study":
        bound = f"{bound_in(bound_of(arguments), machine_named()):g}"
        return [
            Unit(name, "pam_orthosis.batch.walk", (text, bound), True, True, seconds)
            for name, text in _walks(arguments.inputs, more)
        ]
    bounds = [
        f"--bound-{unit}=" + ",".join([f"{value:g}", *(f"{joint}={one:g}" for joint, one in own.items())])
        for value, unit, own in filter(None, [arguments.bound])
    ]
    given = {"check": ("--json", *bounds), "gap": ("--json", "--jobs=1"), "report": ()}[task]
    verb_parser(task).parse_args(["BAG", *given, *more])  # or each bag would fail by it, again and again
    return [
        Unit(name, PROGRAM, (task, str(bag), *given, *more), task != "check", task != "report", seconds, bag)
        for name, bag in _named([path.resolve() for path in arguments.inputs]).items()
    ]


def _walks(inputs: Sequence[Path], more: Sequence[str]) -> list[tuple[str, str]]:
    from pam_orthosis.batch.study import read_study

    if len(inputs) > 1 or more:
        raise OrthosisError("a study is one file, and takes no --with")
    walks = read_study(inputs[0])
    digits = len(str(len(walks) - 1))
    return [(f"walk-{number:0{digits}d}", json.dumps(walk)) for number, walk in enumerate(walks)]


def _named(bags: Sequence[Path]) -> dict[str, Path]:
    """Return bags by name; those of the same name by as much of their paths as they differ in."""
    names = {bag: bag.name for bag in dict.fromkeys(bags)}
    for depth in range(2, max(len(bag.parts) for bag in bags)):
        common = {name for name, count in Counter(names.values()).items() if count > 1}
        # the anchor would make it the name of a folder elsewhere
        longer = {bag: "-".join(bag.parts[max(1, len(bag.parts) - depth) :]) for bag in names}
        names = {bag: longer[bag] if name in common else name for bag, name in names.items()}
    found: dict[str, Path] = {}
    for bag, name in names.items():
        found[name if name not in found else f"{name}-{len(found)}"] = bag
    return found


def _whole(text: str, least: int = 0) -> int:
    if not text.isdecimal() or int(text) < least:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number of {least} or more")
    return int(text)


def at_least_1(text: str) -> int:
    """Return the whole number that a text is, 1 or more."""
    return _whole(text, 1)
