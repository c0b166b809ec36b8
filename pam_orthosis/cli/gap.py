# SPDX-License-Identifier: Apache-2.0
"""Find where recordings and model disagree, name the missing effect, and show how much it explains.

The gap is what remains between recordings and model, above the noise, when parameters are recalibrated within
their tolerances (gap.tolerance.*). Names come from the catalogue of effects.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pam_orthosis.cli.batch import at_least_1
from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import (
    as_text,
    instead_of_out,
    output,
    refuse_existing,
    refuse_used,
    write_files,
    write_text,
)
from pam_orthosis.progress import Progress, shown

if TYPE_CHECKING:
    from pam_orthosis.discrepancy.beginning import Beginning
    from pam_orthosis.discrepancy.identifiability import Identifiability
    from pam_orthosis.discrepancy.judgement import Outcome

MODEL = "model.yaml"
FILES = "gap.json", MODEL, "gap.html"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument(
        "measured",
        type=Path,
        nargs="+",
        metavar="MEASURED",
        help="recordings to fit: bags of a machine or the test rig, .csv tables of the knee; or of --system",
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
    parser.add_argument(
        "--out", type=output, metavar="DIR", help="write gap.json, gap.html and, without --system, model.yaml"
    )
    parser.add_argument(
        "--next", type=output, metavar="FILE.csv",
        help="write the experiment that would help next: a table of positions and mean pressures to follow",
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
    with shown("loading the search") as progress:
        _check_apart(arguments.measured, arguments.held_out)
        from pam_orthosis.discrepancy.judgement import GOOD
        from pam_orthosis.discrepancy.workflow import search

        case = _begun(arguments, progress)
        if not arguments.until:
            outcome = search(case.start, case.parameters.gap, progress)
            if case.mistaken and outcome.verdict in GOOD:  # what explains a mistake of the recordings is none
                outcome = replace(outcome, verdict="partial" if outcome.effects else "unexplained")
    if arguments.until:
        print(case.heading + _stages(case.start, case.data, arguments.until))
        if arguments.next:
            _write_next(arguments, None, case)
        return 0
    data, words = _described(case, outcome)
    try:
        if arguments.out:
            with shown(f"writing {arguments.out}"):
                _write(arguments, outcome, data, case, words)
    finally:  # a file that cannot be written must not take the verdict with it
        print(json.dumps(data, indent=2) if arguments.json else words)
    if arguments.next:
        _write_next(arguments, outcome, case)
    return 0 if outcome.verdict in GOOD else 1


class Case(NamedTuple):
    """What was asked: parameters, stages before the search, parameters of --model, what records lack.

    `assumed`: bags without a record; `unrecorded`: rows that the others lack, and the values taken;
    `mistaken`: whether the recordings seem to have a mistake.
    """

    parameters: Any
    start: Beginning
    data: Identifiability
    given: Mapping[str, Any]
    assumed: Sequence[Path]
    unrecorded: Mapping[str, Any]
    heading: str
    mistaken: bool


def _begun(arguments: argparse.Namespace, progress: Progress) -> Case:
    """Read the recordings and pass the stages before the search."""
    # scipy and CasADi take a second to load
    from pam_orthosis.discrepancy import patch
    from pam_orthosis.discrepancy.apparatus import apparatus_of, unrecorded, without_record
    from pam_orthosis.discrepancy.beginning import begin
    from pam_orthosis.discrepancy.columns import read_mapping, with_columns
    from pam_orthosis.discrepancy.data import recording, with_loop_of_table
    from pam_orthosis.discrepancy.identifiability import identifiability
    from pam_orthosis.discrepancy.mistakes import mistake_words
    from pam_orthosis.discrepancy.replay import Replay
    from pam_orthosis.discrepancy.together import Workers
    from pam_orthosis.discrepancy.user_file import load_system
    from pam_orthosis.discrepancy.verdict import assumed_words, unrecorded_words
    from pam_orthosis.model.machines import machine_named
    from pam_orthosis.model.parameters import load
    from pam_orthosis.tables import is_table

    paths, namespace = [*arguments.measured, *arguments.held_out], arguments.namespace
    assumed, rows, read = [], {}, recording
    if arguments.system:
        given = _search_rows(arguments.model)
        parameters, system = load(given), load_system(arguments.system)
    else:
        machine = machine_named(arguments.machine) if arguments.machine else None
        apparatus = apparatus_of(paths, machine, namespace)
        given = patch.read(arguments.model, apparatus.machine) if arguments.model else {}
        parameters = apparatus.nominal(paths, given, namespace, arguments.model)
        read = apparatus.read
        system = apparatus.system(parameters, None)
        assumed = [] if arguments.machine else without_record(paths, namespace)
        rows = unrecorded(paths, parameters, apparatus.keys, given, namespace)
    system = with_columns(system, read_mapping(arguments.columns))
    heading = assumed_words(assumed, len(paths), arguments.model) + unrecorded_words(rows, parameters)
    workers = Workers(arguments.jobs)
    every = workers.together(lambda path: read(path, system, namespace), paths, None, progress, "reading")
    if system.input_period:
        changed, stated = float(parameters.at(system.input_period)), system.input_period in given
        every = [
            with_loop_of_table(one, system, changed, stated) if is_table(path) else one
            for path, one in zip(paths, every, strict=True)
        ]
    training, held_out = every[: len(arguments.measured)], every[len(arguments.measured) :]
    replay = Replay(system, workers)
    start = begin(system, training, held_out, parameters.gap, progress, replay)
    mistaken = mistake_words(start, parameters.gap.replay.cross_cutoff)
    progress("computing what these data can show")
    data = identifiability(start.problem, start.null, parameters.gap.evidence.threshold, progress)
    return Case(parameters, start, data, given, assumed, rows, heading + mistaken, bool(mistaken))


def _search_rows(model: Path | None) -> dict[str, Any]:
    """Return what --model changes of the search for a system of the user's."""
    from pam_orthosis.discrepancy import patch

    given = patch.read(model) if model else {}
    if foreign := [key for key in given if not key.startswith("gap.")]:
        raise OrthosisError(f"{foreign[0]} is of a machine; beside --system, --model takes gap.* alone")
    return given


def _described(case: Case, outcome: Outcome) -> tuple[dict[str, Any], str]:
    """Return the outcome as plain data and in words."""
    from pam_orthosis.discrepancy.contract import as_dict, identifiability_as_dict
    from pam_orthosis.discrepancy.verdict import describe, describe_data

    assumed = [str(path) for path in case.assumed]
    known = {"apparatus_assumed": assumed, "parameters_assumed": dict(case.unrecorded)}
    data = {**as_dict(outcome), **known, "data": identifiability_as_dict(case.data)}
    return data, f"{case.heading}{describe_data(case.data)}\n{describe(outcome)}"


def _stages(start, data, last: str) -> str:
    """Return in words what the stages before the search found."""
    from pam_orthosis.discrepancy.verdict import describe_data, describe_replay, describe_where

    parts = [*(f"remark: {remark}" for remark in start.remarks), describe_data(data)]
    if last != "check":
        parts.append(describe_replay(start))
    if last == "where":
        parts.append(describe_where(start))
    return "\n".join(parts)


def _check_apart(measured: list[Path], held_out: list[Path]) -> None:
    """Check that no recording is given twice, be it as a bag's folder and as the file in it."""
    from pam_orthosis.bag.sources import check_once, data_files

    check_once(measured)
    check_once(held_out)
    fitted = {file for path in measured for file in data_files(path)}
    for path in held_out:
        if data_files(path) & fitted:
            raise OrthosisError(f"{path} is given to fit and to judge by; leave it out of one of the two")


def _check_out(arguments: argparse.Namespace) -> None:
    folder = arguments.out
    if arguments.system and arguments.machine:
        raise OrthosisError("--system and --machine each say what the recordings are of: give one")
    if arguments.until and (folder or arguments.json):
        raise OrthosisError("--until prints words only; leave --out and --json out")
    if arguments.system and arguments.next:
        raise OrthosisError("--next knows experiments of machines, none of a --system")
    if arguments.next:
        with instead_of_out("--next"):
            refuse_existing([arguments.next])
    if folder:
        refuse_used(folder)


def _files(arguments: argparse.Namespace) -> tuple[str, ...]:
    """Return the files to write: a model file is for `--model`, which a system of one's own does not have."""
    return tuple(name for name in FILES if not (arguments.system and name == MODEL))


def _write(arguments: argparse.Namespace, outcome, data, case: Case, words: str) -> None:
    from pam_orthosis.discrepancy import patch
    from pam_orthosis.report.gap import page

    added = patch.changes_of(outcome)
    added |= {} if arguments.system else patch.limits(case.parameters, added)
    texts = (
        json.dumps(data, indent=2) + "\n",
        patch.text(patch.kept(case.given) | added),
        page(outcome, words, case.data.experiments),
    )
    made = dict(zip(FILES, texts, strict=True))
    write_files({arguments.out / name: as_text(made[name]) for name in _files(arguments)})


def _write_next(arguments: argparse.Namespace, outcome, case: Case) -> None:
    from pam_orthosis.cli.gap_next import advice, next_experiment, references

    name = next_experiment(outcome, case.data.experiments)
    if name:
        with instead_of_out("--next"):
            write_text(arguments.next, references(name, case.parameters))
    if not arguments.json:
        none = f"next: no experiment is known that would show more; {arguments.next} is not written"
        print(advice(name, case.parameters) if name else none)
