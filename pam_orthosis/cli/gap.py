# SPDX-License-Identifier: Apache-2.0
"""Find where recordings and model disagree, name the missing effect, and show how much it explains.

The gap is what remains between recordings and model, above the noise, when parameters are recalibrated within
their tolerances (gap.tolerance.*). Names come from the catalogue of effects.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pam_orthosis.cli.batch import at_least_1
from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import (
    as_text,
    claimed,
    instead_of_out,
    output,
    refuse_existing,
    refuse_used,
    write_files,
    write_text,
)
from pam_orthosis.progress import Progress, shown

if TYPE_CHECKING:
    from pam_orthosis.cli.gap_graph import Emulated
    from pam_orthosis.discrepancy.answer.judgement import Outcome
    from pam_orthosis.discrepancy.preparation.beginning import Beginning
    from pam_orthosis.discrepancy.preparation.identifiability import Identifiability
    from pam_orthosis.discrepancy.request import Recordings

MODEL = "model.yaml"
FILES = "gap.json", MODEL, "gap.html"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument(
        "measured",
        type=Path,
        nargs="+",
        metavar="MEASURED",
        help="recordings to fit: bags of a machine or the test rig; .csv tables of the knee, of --machine or"
        " of --system",
    )
    parser.add_argument(
        "--held-out", type=Path, nargs="+", default=[], metavar="BAG",
        help="recordings that judge and are not fitted (the last quarter of each MEASURED)",
    )  # fmt: skip
    parser.add_argument(
        "--model", type=Path, metavar="FILE",
        help="YAML with parameters of the nominal model that differ from the bag's"
        " (by `gap`, `improve`, `plan` or `identify`)",
    )  # fmt: skip
    parser.add_argument(
        "--machine",
        type=Path,
        metavar="FILE",
        help="tables, or bags that do not say so, are of a machine of your own: its YAML file",
    )
    parser.add_argument(
        "--system", type=Path, metavar="FILE.py",
        help="a system of your own: Python with system(), see pam_orthosis.discrepancy.api; the file is run",
    )  # fmt: skip
    parser.add_argument(
        "--columns", nargs="+", default=[], metavar="SIGNAL=COLUMN",
        help="which columns of tables hold which signals, as angle='knee [deg]', time=t:ms or angle=-q;"
        " units in the columns' names are converted",
    )  # fmt: skip
    parser.add_argument("--out", type=output, metavar="DIR", help="write gap.json, gap.html and model.yaml")
    parser.add_argument(
        "--next", type=output, metavar="FILE.csv|DIR",
        help="the experiment that would help next: write it as a table of positions and mean pressures to"
        " follow; or, for bags of `run`, let the graph record it into DIR and search again with it",
    )  # fmt: skip
    parser.add_argument(
        "--until", choices=("check", "replay", "where"),
        help="stop after this stage: what the data can show; how large the gap is; where it is",
    )  # fmt: skip
    parser.add_argument("--namespace", default="", metavar="NS", help="of the leg in the bags")
    parser.add_argument(
        "--jobs", type=at_least_1, metavar="N",
        help="processes at a time (number of cores); the answer does not depend on it",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print gap.json instead of words")


def execute(arguments: argparse.Namespace) -> int:
    """Run the workflow; return 0 if the gap is explained in full or there is none, 1 if not."""
    # the search has threads of its own; set before numpy is loaded
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    _check_out(arguments)
    if arguments.until:
        with shown("loading the search") as progress:
            case = _begun(arguments, progress)
        print(case.read.heading + _stages(case.start, case.data, arguments.until))
        if arguments.next:
            _write_next(arguments, None, case)
        return 0
    if not arguments.next or _is_table(arguments.next):
        found = _searched(arguments)
        _tell(arguments, found)
        if arguments.next:
            _write_next(arguments, found.outcome, found.case)
        return found.status
    with instead_of_out("--next"), claimed(arguments.next):
        return _with_experiments(arguments)


def _with_experiments(arguments: argparse.Namespace) -> int:
    """Search, and again with each experiment that the graph does on emulated hardware."""
    from pam_orthosis.cli.gap_graph import emulated

    hardware = emulated([*arguments.measured, *arguments.held_out], arguments.namespace)
    found = _searched(arguments)
    try:
        while name := _next_of(found, hardware):
            print(f"so far: {found.words.splitlines()[-1]}", file=sys.stderr, flush=True)
            arguments, hardware = _with_next(arguments, name, hardware)
            found = _searched(arguments)
    finally:  # an experiment that fails must not take with it what was found
        _tell(arguments, found)
    if not arguments.json:
        left = "the graph has done what is known to help beside these recordings"
        none = f"no experiment is known that would show more; {arguments.next} is not written"
        print(f"next: {left if hardware.repeated else none}")
    return found.status


def _tell(arguments: argparse.Namespace, found: Found) -> None:
    """Write and print what was found."""
    try:
        if arguments.out:
            with shown(f"writing {arguments.out}"):
                _write(arguments, found)
    finally:  # a file that cannot be written must not take the verdict with it
        print(json.dumps(found.data, indent=2) if arguments.json else found.words)


class Case(NamedTuple):
    """What was asked: recordings with their nominal model, stages before the search, what they can show."""

    read: Recordings
    start: Beginning
    data: Identifiability


class Found(NamedTuple):
    """What a search found: also as plain data, in words, and as the verb's exit status."""

    case: Case
    outcome: Outcome
    data: dict[str, Any]
    words: str
    status: int


def _searched(arguments: argparse.Namespace) -> Found:
    with shown("loading the search") as progress:
        from pam_orthosis.discrepancy.answer.judgement import GOOD
        from pam_orthosis.discrepancy.answer.verdict import remark_lines
        from pam_orthosis.discrepancy.workflow import search

        case = _begun(arguments, progress)
        if case.start.doubtful:
            progress.note("\n".join(remark_lines(case.start.remarks)))
        outcome = search(case.start, case.read.nominal.parameters.gap, progress)
    return Found(case, outcome, *_described(arguments, case, outcome), int(outcome.verdict not in GOOD))


def _next_of(found: Found, hardware: Emulated) -> str:
    """Return the experiment for the graph to do: once what shows most, then what separates effects."""
    from pam_orthosis.cli.gap_next import next_experiment

    useful = () if hardware.repeated else found.case.data.experiments
    return next_experiment(found.outcome, useful, hardware.experiments)


def _with_next(
    arguments: argparse.Namespace, name: str, hardware: Emulated
) -> tuple[argparse.Namespace, Emulated]:
    """Let the graph do an experiment; return what to search then, and of which hardware."""
    from pam_orthosis.model.parameters import experiments

    # without recordings that judge, the last quarter of each one does
    folder, judged = arguments.next / name, bool(arguments.held_out)
    (first, *rest), hardware = hardware.record(name, folder, judged)
    print(f"next: {experiments()[name]}; recorded in {folder}", file=sys.stderr, flush=True)
    more = {"measured": [*arguments.measured, first], "held_out": [*arguments.held_out, *rest]}
    return argparse.Namespace(**{**vars(arguments), **more}), hardware


def _begun(arguments: argparse.Namespace, progress: Progress) -> Case:
    """Read the recordings and pass the stages before the search."""
    # scipy and CasADi take a second to load
    from pam_orthosis.discrepancy.preparation.beginning import begin
    from pam_orthosis.discrepancy.preparation.identifiability import identifiability
    from pam_orthosis.discrepancy.replay.replay import Replay
    from pam_orthosis.discrepancy.request import Asked, read_recordings
    from pam_orthosis.discrepancy.workers import Workers

    workers = Workers(arguments.jobs)
    asked = Asked(**{name: getattr(arguments, name) for name in Asked._fields})
    read = read_recordings(asked, workers, progress)
    system, gap = read.nominal.system, read.nominal.parameters.gap
    start = begin(system, read.training, read.held_out, gap, progress, Replay(system, workers))
    progress("computing what these data can show")
    data = identifiability(
        start.problem, start.null, gap.evidence.threshold, progress, start.whole, start.missing
    )
    return Case(read, start, data)


def _described(arguments: argparse.Namespace, case: Case, outcome: Outcome) -> tuple[dict[str, Any], str]:
    """Return the outcome as plain data and in words."""
    from pam_orthosis.discrepancy.answer.contract import as_dict, identifiability_as_dict
    from pam_orthosis.discrepancy.answer.verdict import describe, describe_data

    nominal = case.read.nominal
    assumed = [str(path) for path in nominal.assumed]
    recordings = {
        "fitted": [str(path) for path in arguments.measured],
        "held_out": [str(path) for path in arguments.held_out],
    }
    known = {
        "recordings": recordings,
        "apparatus_assumed": assumed,
        "parameters_assumed": dict(nominal.unrecorded),
    }
    data = {**as_dict(outcome), **known, "data": identifiability_as_dict(case.data)}
    return data, f"{case.read.heading}{describe_data(case.data)}\n{describe(outcome)}"


def _stages(start: Beginning, data: Identifiability, last: str) -> str:
    """Return in words what the stages before the search found."""
    from pam_orthosis.discrepancy.answer.verdict import (
        describe_data,
        describe_replay,
        describe_where,
        remark_lines,
    )

    parts = [*remark_lines(start.remarks), describe_data(data)]
    if last != "check":
        parts.append(describe_replay(start))
    if last == "where":
        parts.append(describe_where(start))
    return "\n".join(parts)


def _check_out(arguments: argparse.Namespace) -> None:
    folder = arguments.out
    if arguments.until and (folder or arguments.json):
        raise OrthosisError("--until prints words only: give no --out and no --json")
    if arguments.until and arguments.next and not _is_table(arguments.next):
        raise OrthosisError("--until searches nothing: give --next FILE.csv, not a folder")
    if arguments.system and arguments.next:
        raise OrthosisError("--next knows experiments of machines, none of a --system")
    if arguments.next:
        with instead_of_out("--next"):
            if _is_table(arguments.next):
                refuse_existing([arguments.next])
            else:
                _check_folder(arguments.next, [*arguments.measured, *arguments.held_out])
    if folder:
        refuse_used(folder)


def _check_folder(folder: Path, recordings: list[Path]) -> None:
    refuse_used(folder)
    for one in recordings:
        if one.resolve() in folder.resolve().parents:
            raise OrthosisError(f"{folder} is inside of {one}; choose another --out")


def _is_table(path: Path) -> bool:
    return path.suffix.lower() == ".csv"


def _write(arguments: argparse.Namespace, found: Found) -> None:
    from pam_orthosis.discrepancy.answer import patch
    from pam_orthosis.report.gap import page

    nominal, added = found.case.read.nominal, patch.changes_of(found.outcome)
    added |= {} if arguments.system else patch.limits(nominal.parameters, added)
    texts = (
        json.dumps(found.data, indent=2) + "\n",
        patch.text(patch.kept(nominal.given) | added),
        page(found.outcome, found.words, found.case.data.experiments),
    )
    made = dict(zip(FILES, texts, strict=True))
    if arguments.system and nominal.system.changed is None:  # no --model could take it
        del made[MODEL]
    write_files({arguments.out / name: as_text(text) for name, text in made.items()})


def _write_next(arguments: argparse.Namespace, outcome: Outcome | None, case: Case) -> None:
    from pam_orthosis.cli.gap_next import advice, next_experiment, references

    name, parameters = next_experiment(outcome, case.data.experiments), case.read.nominal.parameters
    if name:
        with instead_of_out("--next"):
            write_text(arguments.next, references(name, parameters))
    if not arguments.json:
        none = f"next: no experiment is known that would show more; {arguments.next} is not written"
        print(advice(name, parameters) if name else none)
