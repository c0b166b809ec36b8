# SPDX-License-Identifier: Apache-2.0
"""What identification works on: samples of force, of volume and of free decays, from bags and tables.

Only measured channels are read; the truth topic of an emulated rig is never opened.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np

from pam_orthosis.bag.information import METADATA_FILE
from pam_orthosis.bag.read import Bag, aligned, read_bag, recorded_parameters, run_record
from pam_orthosis.bag.sources import check_once
from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.errors import OrthosisError
from pam_orthosis.identification.measured import Parts, numbered_repeats, table_parts
from pam_orthosis.identification.samples import (
    DERIVATIVE_SAMPLES,
    Decay,
    Samples,
    Volumes,
    check_even,
    differentiated,
    joined,
)
from pam_orthosis.model.components.muscle import composed_volume
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.parameters import Parameters, load
from pam_orthosis.model.specimens import SPECIMENS, specimens_of
from pam_orthosis.progress import Progress, counted, silent
from pam_orthosis.tables import is_table

Runs: TypeAlias = Mapping[Path, Mapping[str, str]]  # run metadata of bags


class Bench(NamedTuple):
    """Where it is measured: parameters, which muscles there are, keys that a muscle's own file gave."""

    parameters: Parameters
    specimens: tuple[str, ...] = SPECIMENS
    own: tuple[str, ...] = ()


def bench_of(machine: Machine | None = None) -> Bench:
    """Return the shipped test rig; with a machine, its muscles and what its file says of muscles and valves.

    Raises:
        OrthosisError: it has no muscle.
    """
    if machine is None:
        return Bench(load())
    own = {key: value for key, value in machine.values.items() if key.startswith(("muscle.", "valve."))}
    return Bench(load(own), specimens_of(machine))


@dataclass(frozen=True)
class Data:
    """All data of one muscle.

    Attributes:
        specimen: its section in config/.
        length: its nominal length, m.
        static: from tables, in which samples need not follow each other.
        volume_source: the file, or the first of them, that holds the volumes.
        marked: the tables say where the muscle hangs slack.
        own: keys below its section that a file of its own gave.
        assumed: what was taken because nothing was given, and columns that were not read, for users.
    """

    specimen: str
    parameters: Parameters
    length: float
    samples: Samples
    static: bool
    decays: list[Decay] = field(default_factory=list)
    volumes: Volumes | None = None
    volume_source: str = ""
    marked: bool = False
    own: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()


def read_data(
    paths: Iterable[Path],
    specimen: str | None = None,
    length: float | None = None,
    progress: Progress = silent,
    bench: Bench | None = None,
) -> Data:
    """Read rig bags and tables, or folders of them, of one muscle.

    Args:
        paths: bags, `.csv` tables, or folders that hold some.
        specimen: section of `config/muscle.yaml`; None: as bags or file names say, or the only one.
        length: nominal length of a table's muscle, m; None: that of the specimen's measured map.
        bench: where it was measured (the shipped test rig).

    Raises:
        OrthosisError: nothing usable there, data of several muscles or of another one than `specimen`, the
            same data twice, or unusable numbers.
    """
    bags, tables = _sources(paths)
    runs = {path: run_record(path) for path in bags}
    parameters, specimens, own = bench or bench_of()
    specimen = specimen or _one_specimen(runs, tables, specimens)
    _check_specimen(runs, specimen)
    if specimen not in specimens:
        raise OrthosisError(f"no muscle {specimen} here; there are: {', '.join(specimens)}")
    nominal = _nominal_length(runs, specimen, parameters, length, bool(tables))
    parts, serial = [], len(bags)
    for number, path in enumerate(counted(bags, progress, "reading bags")):
        parts.append(_bag_parts(path, runs[path].get("test", "force"), number, specimen, parameters))
    for path in counted(tables, progress, "reading tables"):
        parts.append(table_parts(path, nominal, parameters.valve.ambient_pressure, serial))
        serial = 1 + int(max([serial, *(one.samples.serial.max() for one in parts if one.samples)]))
    _check_copied(tables, parts[len(bags) :])
    samples = [one.samples for one in parts if one.samples]
    volumes = [one.volumes for one in parts if one.volumes]
    if not samples:
        raise OrthosisError("no force measurement among the data: give bags of `rig` or a table")
    return Data(
        specimen, parameters, nominal, joined(Samples, numbered_repeats(samples)), not bags,
        [one.decay for one in parts if one.decay],
        joined(Volumes, volumes) if volumes else None,
        next((str(path) for path, one in zip([*bags, *tables], parts, strict=True) if one.volumes), ""),
        any(one.marked for one in parts), own,
        (*_assumed(tables, length, specimen, nominal, own), *_unread(parts), *_copies(parts)),
    )  # fmt: skip


def _nominal_length(
    runs: Runs, specimen: str, parameters: Parameters, given: float | None, tables: bool
) -> float:
    """Return the one nominal length of bags and tables, m."""
    key = f"muscle.{specimen}.length"
    lengths = {_recorded(path, run, key, parameters) for path, run in runs.items()}
    lengths |= {given or getattr(parameters.muscle, specimen).geometry.map_length} if tables else set()
    if len(lengths) > 1:
        different = ", ".join(f"{one:g}" for one in sorted(lengths))
        raise OrthosisError(f"muscles of different nominal lengths ({different} m): one at a time")
    return lengths.pop()


def _bag_parts(path: Path, test: str, serial: int, specimen: str, parameters: Parameters) -> Parts:
    """Return what a bag of a test holds, whose run has this number."""
    if test == "decay":
        return Parts(decay=_decay(path, specimen, parameters))
    if test == "volume":
        return Parts(volumes=_volumes(path, specimen, parameters))
    if test == "diagnostic":  # the gap workflow's: moves too fast for static force
        return Parts()
    return Parts(_bag_samples(path, serial, parameters))


def _assumed(
    tables: Sequence[Path], given: float | None, specimen: str, nominal: float, own: Sequence[str]
) -> tuple[str, ...]:
    """Return what was taken because nothing was given."""
    if not tables or given or own:
        return ()
    return (
        f"the nominal length, {nominal:g} m, is that of the {specimen} in config/: give --nominal-length-m",
    )


def _unread(parts: Sequence[Parts]) -> tuple[str, ...]:
    """Return which columns of tables were not read."""
    names = ", ".join(dict.fromkeys(name for one in parts for name in one.unread))
    return (f"columns not read, as their names give no known quantity and unit: {names}",) if names else ()


def _check_copied(tables: Sequence[Path], parts: Sequence[Parts]) -> None:
    """Refuse, by OrthosisError, a table with the samples of another one: a copy is no repeat."""
    known: dict[bytes, Path] = {}
    for path, one in zip(tables, parts, strict=True):
        if one.samples:
            key = one.samples.pressure.tobytes() + one.samples.force.tobytes()
        elif one.decay:
            key = one.decay.pressure.tobytes() + one.decay.position.tobytes()
        else:
            continue
        if key in known:
            raise OrthosisError(
                f"{path} holds the samples of {known[key]}: a copy is no repeat; leave it out"
            )
        known[key] = path


def _copies(parts: Sequence[Parts]) -> tuple[str, ...]:
    """Return how many rows were left out as copies."""
    count = sum(one.copies for one in parts)
    return (f"{count} rows left out: they repeat an earlier one in every column, time included",) * (
        count > 0
    )


def _sources(paths: Iterable[Path]) -> tuple[list[Path], list[Path]]:
    bags, tables = [], []
    for path in map(Path, paths):
        if not path.exists():
            raise OrthosisError(f"no data at {path}")
        inside = [path] if path.is_file() or (path / METADATA_FILE).exists() else sorted(path.iterdir())
        found = [p for p in inside if is_table(p) or _is_bag(p)]
        if not found:
            raise OrthosisError(f"{path} holds neither a bag nor a .csv table")
        tables += [p for p in found if is_table(p)]
        bags += [p for p in found if not is_table(p)]
    check_once([*bags, *tables])
    return bags, tables


def _is_bag(path: Path) -> bool:
    return path.suffix in (".mcap", ".db3") or (path / METADATA_FILE).exists()


def _one_specimen(runs: Runs, tables: Sequence[Path], specimens: Sequence[str]) -> str:
    names = {run["specimen"] for run in runs.values() if "specimen" in run}
    for path in tables:
        plain = path.stem.lower().replace("_", "").replace("-", "")
        names |= {name for name in specimens if name.replace("_", "") in plain}
    if not names and len(specimens) == 1:
        return specimens[0]
    if not names:
        hint = "give --muscle" if tables else "give bags of `pam-orthosis rig`, or tables of a muscle"
        raise OrthosisError(f"the data do not name their muscle: {hint}")
    if len(names) > 1:
        raise OrthosisError(f"data of {', '.join(sorted(names))}: give the data of one muscle at a time")
    return names.pop()


def _check_specimen(runs: Runs, specimen: str) -> None:
    """Check that no bag is of another muscle: its rows would be wrong without a sign of it."""
    for path, run in runs.items():
        if run.get("specimen", specimen) != specimen:
            raise OrthosisError(
                f"{path} is of a {run['specimen']}, not of a {specimen}: leave it out, or give the data of"
                f" the {run['specimen']} alone"
            )


def _recorded(path: Path, run: Mapping[str, str], key: str, parameters: Parameters) -> float:
    """Return a parameter as the bag has it, else as config/ has it."""
    value: float = recorded_parameters(path, run).get(key, parameters.flat()[key])
    return value


def _value(bag: Bag, key: str, parameters: Parameters) -> float:
    value: float = bag.parameters.get(key, parameters.flat()[key])
    return value


def _measured(
    path: Path, names: Sequence[str], parameters: Parameters
) -> tuple[Bag, np.ndarray, list[np.ndarray], float]:
    bag = read_bag(path, [f"rig_{name}" for name in names])
    stamps, values = aligned(*(bag[f"rig_{name}"] for name in names))
    if len(stamps) < DERIVATIVE_SAMPLES:
        raise OrthosisError(f"{path} is too short: {len(stamps)} samples")
    return bag, stamps, values, _value(bag, "valve.ambient_pressure", parameters)


def _bag_samples(path: Path, serial: int, parameters: Parameters) -> Samples:
    names = ("position", "pressure", "force", "pressure_reference")
    _, stamps, (position, pressure, force, reference), ambient = _measured(path, names, parameters)
    level = reference[-1]
    rate = differentiated(position, stamps)
    settled = 1.0e4  # Pa between a pressure and its reference
    taut = 10.0  # N below which a muscle at the rig may hang slack
    kept = (reference == level) & (np.abs(pressure - level) < settled) & (force > taut)
    if not kept.any():
        raise OrthosisError(f"{path}: the muscle hangs slack or its pressure never settles")
    noise = np.std(np.diff(force, 2)) / np.sqrt(6)  # second differences see neither level nor slope
    whole = Samples(
        pressure - ambient, position, rate, force, np.full_like(force, max(noise, 1e-3)),
        np.full_like(force, level - ambient), np.full(len(force), serial),
    )  # fmt: skip
    return whole.where(kept)


def _decay(path: Path, specimen: str, parameters: Parameters) -> Decay:
    bag, stamps, values, ambient = _measured(path, ("position", "pressure", "force"), parameters)
    check_even(path, stamps)
    position, pressure, force = values
    weight = _value(bag, f"rig.decay.{specimen}.weight", parameters)
    mass = _value(bag, "rig.carriage_mass", parameters) + weight
    return Decay((stamps - stamps[0]) / SECOND_NS, position, pressure - ambient, force, mass, str(path))


def _volumes(path: Path, specimen: str, parameters: Parameters) -> Volumes:
    names = ("position", "pressure", "diameter", "cylinder_length")
    bag = read_bag(path, [f"rig_{name}" for name in names])
    _, (position, pressure, diameter, length) = aligned(*(bag[f"rig_{name}"] for name in names))
    nominal = _value(bag, f"muscle.{specimen}.length", parameters)
    frustum = (nominal - position - length) / 2  # what is left of the length on both sides
    end = _value(bag, f"muscle.{specimen}.geometry.diameter", parameters)
    volume = composed_volume(diameter, length, frustum, end)
    return Volumes(pressure - _value(bag, "valve.ambient_pressure", parameters), position, volume)
