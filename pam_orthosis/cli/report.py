# SPDX-License-Identifier: Apache-2.0
"""Show a recorded run or session: an offline page, pictures, an animation, or a table."""

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from pam_orthosis.cli.check import add_bound_arguments, bound_of, describe
from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import Write, as_text, bag_name, output, refuse_existing, refuse_used, write_files
from pam_orthosis.progress import counted, shown
from pam_orthosis.results import REMAKE, refuse_foreign, write_results

Maker = Callable[[Path, argparse.Namespace], Write]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument("bag", type=Path, metavar="BAG", help="bag folder or .mcap file")
    parser.add_argument(
        "--out", type=output, metavar="DIR", help="folder of page and picture (a new one, BAG-report, here)"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an earlier report of that name")
    add_bound_arguments(parser)
    kinds = parser.add_mutually_exclusive_group()
    kinds.add_argument(
        "--animation",
        type=_gif,
        metavar="FILE",
        help="make a GIF of the moving leg and its error, nothing else",
    )
    kinds.add_argument(
        "--only",
        choices=("page", "picture", "table", "mat"),
        help="make one of them (page and picture); mat: a table for MATLAB",
    )
    parser.add_argument(
        "--earlier", type=Path, metavar="BAG", help="beside the session BAG, an earlier one to compare with"
    )
    parser.add_argument("--namespace", default="", metavar="NS", help="namespace of the leg in the bag")


def execute(arguments: argparse.Namespace) -> int:
    """Write what is asked for and say where."""
    from pam_orthosis.bag.legs import check_named, namespaces
    from pam_orthosis.bag.session import is_session

    bag = arguments.bag.resolve()
    several = namespaces(bag) != [""] and not (arguments.namespace or arguments.animation)
    whole = several and arguments.only in (None, "page")
    if not whole:
        check_named(bag, arguments.namespace)
    session = not arguments.animation and is_session(bag)
    _check_earlier(arguments, session, whole)
    if arguments.animation:
        return _animate(arguments)
    if whole:
        return _written(arguments, ["page"], _session if session else _pages)
    return _written(arguments, [arguments.only] if arguments.only else ["page", "picture"], _page)


def _check_earlier(arguments: argparse.Namespace, session: bool, whole: bool) -> None:
    if arguments.earlier and not session:
        raise OrthosisError(f"--earlier is for sessions, {arguments.bag} is none")
    if arguments.earlier and not whole:
        raise OrthosisError("--earlier is for the page of both legs; leave --only and --namespace out")


def _written(arguments: argparse.Namespace, kinds: Sequence[str], page: Maker) -> int:
    """Write files of these kinds, all of them or none."""
    bag = bag_name(arguments.bag.resolve())
    folder = arguments.out or Path(f"{bag}-report")
    if not (arguments.out or arguments.overwrite):
        refuse_used(folder, REMAKE)
    leg = arguments.namespace.strip("/").replace("/", "-")
    makers = {"page": ("html", page), "picture": ("png", _picture), "table": ("csv", _table),
              "mat": ("mat", _mat)}  # fmt: skip
    named = {f"{bag}{leg and '-'}{leg}.{makers[kind][0]}": makers[kind][1] for kind in kinds}
    refuse_foreign(folder, named, arguments.overwrite)
    with shown(f"reading {arguments.bag}") as progress:
        made = {
            name: named[name](arguments.bag.resolve(), arguments)
            for name in counted(list(named), progress, "drawing")
        }
        progress("writing")
        write_results(folder, made, arguments.overwrite)
    print(*(folder / name for name in made), sep="\n")
    return 0


def _animate(arguments: argparse.Namespace) -> int:
    """Write the animation, into a new file."""
    from pam_orthosis.report.animation import write_animation

    if arguments.overwrite:
        raise OrthosisError("--overwrite is for the files of a folder; an --animation is a new file")
    refuse_existing([arguments.animation])
    with shown(f"drawing {arguments.bag}"):
        made = partial(write_animation, arguments.bag.resolve(), arguments.namespace)
        write_files({arguments.animation: made})
    print(arguments.animation)
    return 0


def _gif(text: str) -> Path:
    """Return the path of an animation."""
    path = output(text)
    if path.suffix != ".gif":
        raise argparse.ArgumentTypeError(f"{text}: an animation is a GIF, give a name that ends in .gif")
    return path


def _page(bag: Path, arguments: argparse.Namespace) -> Write:
    from pam_orthosis.bag.verdict import judge
    from pam_orthosis.report.run_data import read_run
    from pam_orthosis.report.run_page import run_page

    verdict = judge(bag, bound_of(arguments), namespace=arguments.namespace)
    return as_text(run_page(read_run(bag, arguments.namespace), verdict, describe(verdict)))


def _pages(bag: Path, arguments: argparse.Namespace) -> Write:
    from pam_orthosis.bag.verdict import judge_all
    from pam_orthosis.report.run_data import read_run
    from pam_orthosis.report.run_page import device_page

    verdicts = judge_all(bag, bound_of(arguments))
    runs = {name: read_run(bag, name) for name in verdicts}
    words = "\n\n".join(f"{name}\n{describe(verdict)}" for name, verdict in verdicts.items())
    return as_text(device_page(bag.name, runs, verdicts, words))


def _session(bag: Path, arguments: argparse.Namespace) -> Write:
    from pam_orthosis.report.pages.session import page
    from pam_orthosis.report.pages.session import shown as read

    earlier = arguments.earlier and read(arguments.earlier.resolve())
    return as_text(page(read(bag), earlier))


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
