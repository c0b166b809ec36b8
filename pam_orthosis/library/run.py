# SPDX-License-Identifier: Apache-2.0
"""A run as arrays: simulated, or read from a bag."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pam_orthosis.bag.arrays import write_arrays
from pam_orthosis.bag.examples import BAGS, write_example
from pam_orthosis.bag.read import Bag, Series
from pam_orthosis.bag.record import run_metadata
from pam_orthosis.bag.sampled import sampled, since_first
from pam_orthosis.bag.simulated import recorded_signals
from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import write_files
from pam_orthosis.library import checked_arguments as given
from pam_orthosis.library.options import arguments_named
from pam_orthosis.markup import Shown
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.parameters import Parameters, load

if TYPE_CHECKING:
    from pandas import DataFrame


Array = NDArray[np.float64]


class Picture:
    """A drawn figure; a notebook shows it where it is the last value of a cell.

    Attributes:
        figure: of matplotlib, to change titles and limits.
    """

    def __init__(self, figure: Figure):
        self.figure = figure

    @arguments_named()
    def save(self, path: str | Path) -> None:
        """Write the picture; the ending decides on the format (`.png`, `.svg`, `.pdf`).

        Raises:
            OrthosisError: another ending, or the file cannot be written.
        """
        file, known = given.path(path, "path"), self.figure.canvas.get_supported_filetypes()
        kind = file.suffix.lower().removeprefix(".")
        if kind not in known:
            raise OrthosisError(f"{file}: its ending is none of a picture; give .png, .svg or .pdf")
        write_files({file: lambda stream: self.figure.savefig(stream, format=kind)}, {file})

    def _repr_png_(self) -> bytes:
        stream = io.BytesIO()
        self.figure.savefig(stream, format="png", dpi=90)
        return stream.getvalue()


@dataclass(frozen=True, eq=False, repr=False)
class Run(Shown):
    """Signals of one run, all at the same instants.

    Attributes:
        parameters: of the run; of a bag those that it records.
        scenario: its name.
        stamps_ns: instants (n,), ns.
        signals: name -> values (n,), SI; NaN where a bag has no message of that instant.
    """

    parameters: Parameters
    scenario: str
    stamps_ns: NDArray[np.int64]
    signals: Mapping[str, Array]

    def __getitem__(self, name: str) -> Array:
        """Return a signal, (n,) SI.

        Raises:
            OrthosisError: the run has no such signal.
        """
        if name not in self.signals:
            raise OrthosisError(f"no signal {name}; there are: {', '.join(self.signals)}")
        return self.signals[name]

    @property
    def machine(self) -> Machine:
        """What ran."""
        return self.parameters.declared

    @property
    def time(self) -> Array:
        """Seconds since the first sample, (n,)."""
        return since_first(self.stamps_ns)

    @cached_property
    def error(self) -> Array:
        """Reference - measured coordinate, (n,) rad or m.

        Raises:
            OrthosisError: the run follows no reference: it was driven by given voltages.
        """
        name = self.machine.coordinate.name
        error: Array = self[f"reference_{name}"] - self[name]
        return error

    def between(self, start: float, end: float) -> Run:
        """Return the part from one time to another, s since the first sample.

        Raises:
            OrthosisError: there are no two samples.
        """
        start, end = (given.number(one, "between", -math.inf, math.inf) for one in (start, end))
        part = (self.time >= start) & (self.time <= end)
        if np.count_nonzero(part) < 2:
            raise OrthosisError(f"no two samples between {start:g} and {end:g} s of {self.time[-1]:g} s")
        signals = {name: value[part] for name, value in self.signals.items()}
        return Run(self.parameters, self.scenario, self.stamps_ns[part], signals)

    def to_pandas(self) -> DataFrame:
        """Return a table: a column a signal, indexed by the time, s.

        Raises:
            OrthosisError: there is no pandas.
        """
        if find_spec("pandas") is None:
            raise OrthosisError("pandas is not installed: pip install 'pam_orthosis[pandas]'")
        from pandas import DataFrame, Index

        return DataFrame(dict(self.signals), index=Index(self.time, name="time"))

    @arguments_named()
    def save(self, folder: str | Path) -> Path:
        """Write a bag of what a recorder would see of the run into a new folder; return it.

        Raises:
            OrthosisError: the folder is used.
        """
        path, every = given.path(folder, "folder"), self.parameters.control.position.every
        written = {name: self[name] for name in recorded_signals(self.machine) if name in self.signals}
        write_arrays(path, self.stamps_ns, written, run_metadata(self.parameters, self.scenario), every)
        return path

    @arguments_named()
    def save_mat(self, path: str | Path) -> None:
        """Write a file for MATLAB, `.mat`: `time` and all signals, a column vector each, SI.

        Raises:
            OrthosisError: the file cannot be written.
        """
        from scipy.io import savemat  # takes its time to load

        file, signals = given.path(path, "path"), {"time": self.time, **self.signals}
        file = file if file.suffix == ".mat" else file.with_name(f"{file.name}.mat")
        write_files({file: lambda stream: savemat(stream, signals, oned_as="column")}, {file})

    def plot(self, bound: float = 3.0) -> Picture:
        """Return the picture of `report`: machine, coordinate, error with its bound (deg or mm), pressures.

        Raises:
            OrthosisError: the run follows no reference.
        """
        from pam_orthosis.report.run_data import run_data
        from pam_orthosis.report.walk import drawn

        return Picture(drawn(run_data(self._bag()), given.number(bound, "bound")))

    def _bag(self) -> Bag:
        series = {name: _known(self.stamps_ns, value) for name, value in self.signals.items()}
        values = self.parameters.flat()
        return Bag(Path(self.scenario), series, {"scenario": self.scenario}, values, self.machine)

    def _shown(self) -> tuple[Sequence[str], list[tuple[str, str, str]], str]:
        rows = [(name, f"{np.nanmin(v):.4g}", f"{np.nanmax(v):.4g}") for name, v in self.signals.items()]
        words = f"{self.machine.name}, {self.scenario}: {len(self.time)} samples in {self.time[-1]:.3f} s"
        return ("signal (SI)", "least", "largest"), rows, words


class Runs(Shown, Sequence[Run]):
    """Runs of several cases, all at the same instants: `runs["angle"]` is (cases, n)."""

    def __init__(self, runs: Sequence[Run], cases: Mapping[str, Array]):
        self._runs, self.cases = tuple(runs), dict(cases)

    def __len__(self) -> int:
        return len(self._runs)

    def __iter__(self) -> Iterator[Run]:
        return iter(self._runs)

    def __getitem__(self, which: Any) -> Any:
        """Return one run by its number, or a signal of all of them by its name, (cases, n)."""
        if isinstance(which, str):
            return np.array([run[which] for run in self._runs])
        return self._runs[which]

    @property
    def time(self) -> Array:
        """Seconds since the first sample, (n,)."""
        return self._runs[0].time

    def _shown(self) -> tuple[Sequence[str], list[tuple[str, ...]], str]:
        rows = [tuple(_plain(value) for value in values) for values in zip(*self.cases.values(), strict=True)]
        return tuple(self.cases), rows, f"{len(self)} runs of {self.time[-1]:.3f} s"


@arguments_named()
def read(path: str | Path, namespace: str = "") -> Run:
    """Read a bag: ours, or one that was recorded on the same topics.

    Args:
        path: folder or `.mcap` file.
        namespace: of the leg in the bag.

    Raises:
        OrthosisError: the bag is unusable.
    """
    folder = given.path(path, "path")
    bag, stamps, signals = sampled(folder, given.text(namespace, "namespace"))
    shipped = load(machine=bag.machine)
    known = shipped.flat()
    recorded = {key: value for key, value in bag.parameters.items() if key in known}
    return Run(shipped.changed(recorded), bag.run.get("scenario", folder.name), stamps, signals)


@arguments_named()
def example(name: str, folder: str | Path) -> dict[str, Path]:
    """Write recordings that come with the package into a new folder; return its bags by name.

    Args:
        name: `walk` or `person`, a bag each; `friction`, a case for `gap`.
        folder: a new one.

    Raises:
        OrthosisError: no such example, or the folder cannot be written.
    """
    bags = write_example(given.text(name, "name"), given.path(folder, "folder"))
    return {name: bags[0]} if name in BAGS else {bag.name: bag for bag in bags}


def _plain(value: Any) -> str:
    """Return a case's value as text: a number, or one of several words."""
    return f"{value:g}" if isinstance(value, Real) else str(value)


def _known(stamps_ns: NDArray[np.int64], value: Array) -> Series:
    """Return a signal where it is known."""
    known = ~np.isnan(value)
    return Series(stamps_ns[known], value[known])
