# SPDX-License-Identifier: Apache-2.0
"""The recordings of a search with the nominal model they are compared with: what verb and library read."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pam_orthosis.bag.sources import check_apart
from pam_orthosis.discrepancy.answer import patch
from pam_orthosis.discrepancy.apparatus import apparatus_of, unrecorded, without_record
from pam_orthosis.discrepancy.recordings.columns import holds, read_mapping, with_columns
from pam_orthosis.discrepancy.recordings.data import Recording, recording, with_loop_of_table
from pam_orthosis.discrepancy.systems.system import System
from pam_orthosis.discrepancy.systems.user_file import load_system
from pam_orthosis.discrepancy.workers import Workers
from pam_orthosis.errors import OrthosisError, naming
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.machines import KNEE, machine_named
from pam_orthosis.model.parameters import Parameters, load
from pam_orthosis.model.specimens import BRANCH as MUSCLE
from pam_orthosis.progress import Progress, silent
from pam_orthosis.tables import is_table, names_of

MOST_NAMED = 3  # parameters in one line
TOLERANCE, LEARNED = "gap.tolerance.", "gap.learned."
GAINS = tuple(f"gap.replay.{of}_gain" for of in ("angle", "velocity", "pressure"))
EXTENSOR, FLEXOR = "extensor_", "flexor_"  # of a knee; each actuator of another machine has the extensor's


class Asked(NamedTuple):
    """Recordings to fit and to judge by, and files that say what they are of, as the arguments of `gap`."""

    measured: Sequence[Path]
    held_out: Sequence[Path]
    model: Path | None = None
    machine: Path | Machine | None = None
    system: Path | None = None
    columns: Mapping[str, str] | Sequence[str] = ()
    namespace: str = ""

    @property
    def paths(self) -> list[Path]:
        """All recordings."""
        return [*self.measured, *self.held_out]


class Nominal(NamedTuple):
    """What recordings are compared with.

    `given`: parameters of --model; `assumed`: recordings without a record of their apparatus; `unrecorded`:
    rows of it that the others lack, and the values taken; `optional`: signals that tables may have too.
    """

    parameters: Parameters
    system: System
    read: Callable[[Path, System, str], Recording] = recording
    given: Mapping[str, Any] = {}
    assumed: Sequence[Path] = ()
    unrecorded: Mapping[str, Any] = {}
    optional: Sequence[str] = ()


class Recordings(NamedTuple):
    """Recordings that were read; `heading`: lines on what is assumed of their apparatus."""

    nominal: Nominal
    training: list[Recording]
    held_out: list[Recording]
    heading: str


def read_recordings(asked: Asked, workers: Workers, progress: Progress = silent) -> Recordings:
    """Read the recordings of a search.

    Raises:
        OrthosisError: one is unfit or given twice, they are of different machines, or a file is unusable.
    """
    if asked.system and asked.machine:
        raise OrthosisError("--system and --machine each say what the recordings are of: give one")
    check_apart(asked.measured, asked.held_out)
    mapping = read_mapping(asked.columns)
    if mapping and not any(map(is_table, asked.paths)):
        raise OrthosisError("--columns: only tables have columns, and these are bags; leave it out")
    known = _of_system(asked.system, asked.model) if asked.system else _of_apparatus(asked, mapping)
    known = known._replace(system=with_columns(known.system, mapping, known.optional))
    heading = assumed_words(known.assumed, len(asked.paths), asked.model)
    heading += unrecorded_words(known.unrecorded, known.parameters)
    every = workers.forked(
        lambda path: _read(path, known, asked.namespace), asked.paths, None, progress, "reading"
    )
    fitted = len(asked.measured)
    return Recordings(known, every[:fitted], every[fitted:], heading)


def _of_system(file: Path, model: Path | None) -> Nominal:
    """Return a system of the user's, of whose search and model --model may change what it says."""
    settings, changes = patch.read_of_system(model) if model else ({}, {})
    if tolerances := [key for key in settings if key.startswith((TOLERANCE, LEARNED))]:
        raise OrthosisError(
            f"{model}: {tolerances[0]} is of a machine; {file} has the tolerances of its parameters"
        )
    if gains := [key for key in GAINS if key in settings]:
        raise OrthosisError(f"{model}: {gains[0]} is of a machine; {file} gives its own by Model(gains=...)")
    system = load_system(file)
    if changes:
        if system.changed is None:
            raise OrthosisError(
                f"{model}: beside --system it takes gap.* alone, not {next(iter(changes))}, unless {file}"
                " makes its system by Model(...).system()"
            )
        with naming(model):
            system = system.changed(changes)
    return Nominal(load(settings), system, given=settings | changes)


def _of_apparatus(asked: Asked, mapping: Mapping[str, str]) -> Nominal:
    machine = _of_file(asked.machine) if isinstance(asked.machine, Path) else asked.machine
    paths, namespace = asked.paths, asked.namespace
    apparatus = apparatus_of(paths, machine, namespace)
    given = patch.read(asked.model, apparatus.machine) if asked.model else {}
    _check_meant(asked.model, given, apparatus.machine)
    parameters = apparatus.nominal(paths, given, namespace, asked.model)
    external = apparatus.machine.external if any(map(is_table, paths)) else ""
    return Nominal(
        parameters,
        apparatus.system(parameters, None, _is_recorded(external, paths, mapping)),
        apparatus.read,
        given,
        [] if machine else without_record(paths, namespace),
        unrecorded(paths, parameters, apparatus.keys, given, namespace),
        (external,) if external else (),
    )


def _of_file(file: Path) -> Machine:
    """Return a machine whose values are as usable as its entries: they are not those of a recording."""
    machine = machine_named(file)
    with naming(file):
        load(machine=machine)
    return machine


def _is_recorded(signal: str, paths: Sequence[Path], mapping: Mapping[str, str]) -> bool:
    """Return whether recordings have a signal that they need not have: all of them, or none.

    Raises:
        OrthosisError: some have it, others do not.
    """
    if not signal:
        return False
    found = {one: is_table(one) and holds(str(one), signal, mapping, names_of(one)) for one in paths}
    having, lacking = ([one for one in paths if found[one] is kind] for kind in (True, False))
    if having and lacking:
        raise OrthosisError(
            f"{having[0]} has {signal}, {lacking[0]} does not: give it in all recordings, or in none"
        )
    return bool(having) or signal in mapping


def _check_meant(file: Path | None, given: Mapping[str, Any], machine: Machine) -> None:
    """Refuse, by OrthosisError, a file for a machine that has none of its muscles, or of its actuators."""
    own = tuple(f"{one.parameters}." for one in machine.actuators)
    strange = [key for key in given if key.startswith(MUSCLE) and not key.startswith(own)]
    if machine is not KNEE and strange and len(strange) == len(given):
        raise OrthosisError(f"{file} is of a muscle that the {machine.name} does not have; leave --model out")
    flexors = [key for key in given if key.startswith(f"{TOLERANCE}{FLEXOR}")]
    if flexors and FLEXOR.rstrip("_") not in machine.names:
        each = flexors[0].replace(FLEXOR, EXTENSOR)
        raise OrthosisError(f"{file}: {flexors[0]} is of a knee; each actuator of {machine.name} has {each}")


def _read(path: Path, known: Nominal, namespace: str) -> Recording:
    one, key = known.read(path, known.system, namespace), known.system.input_period
    if not key or not is_table(path):
        return one
    stated = key in {**known.parameters.declared.values, **known.given}
    return with_loop_of_table(one, known.system, float(known.parameters.at(key)), stated)


def assumed_words(files: Sequence[Path], count: int, model: Path | None) -> str:
    """Return the line on files, of `count`, without a record of their apparatus; empty if all do."""
    if not files:
        return ""
    more = f" and {len(files) - 1} more" if len(files) > 1 else ""
    taken = "the default knee" if len(files) == count else "the apparatus of the other recordings"
    changed = f" with what {model} changes" if model else ""
    listed = f"{files[0]}{more} without a record of parameters, read as {taken}{changed}"
    return f"the apparatus is assumed: {listed}\n"


def unrecorded_words(rows: Mapping[str, Any], parameters: Parameters) -> str:
    """Return the line on the apparatus' rows that are missing in a record, with the values taken, or none."""
    if not rows:
        return ""
    first = [f"{key} = {rows[key]} {parameters.row(key).unit}" for key in list(rows)[:MOST_NAMED]]
    more = f" and {len(rows) - len(first)} more" if len(rows) > len(first) else ""
    taken = f"{', '.join(first)}{more}; give what is right with --model"
    return f"recorded by a version without these parameters; taken: {taken}\n"
