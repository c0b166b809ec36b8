# SPDX-License-Identifier: Apache-2.0
"""What `check` and `gap` answer, for programs and notebooks."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pam_orthosis.bag.verdict import Bound, Verdict, judge
from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import as_text, write_files
from pam_orthosis.library import checked_arguments as given
from pam_orthosis.library.options import arguments_named, in_python
from pam_orthosis.library.run import Run
from pam_orthosis.markup import Shown, table

if TYPE_CHECKING:
    from pam_orthosis.discrepancy.answer.judgement import Outcome
    from pam_orthosis.discrepancy.recordings.data import Recording
    from pam_orthosis.model.machine import Machine
    from pam_orthosis.model.parameters import Parameters

Recorded = Run | str | Path
LISTS = "gap: give lists of runs, bags or tables, such as po.gap([run])"
MOST_JOBS = 10_000


class Check(Shown, Verdict):
    """How well a run follows its reference; errors and bound are in `unit` (deg or mm)."""

    def _shown(self) -> tuple[Sequence[str], list[tuple[str, str]], str]:
        sizes = f"maximum error {self.max_abs_error:.3f} {self.unit}, bound {self.bound:g} {self.unit}"
        head = f"{self.answer.lower()}: {sizes}"
        rows = [
            (name.replace("_", " "), f"{value:.3f}" if isinstance(value, float) else str(value))
            for name, value in self.as_dict().items()
            if isinstance(value, float | int) and name != "passed"
        ]
        return ("what", "value"), rows, head


def check(run: Recorded, bound: float = 3.0, skip_s: float = 0.0, namespace: str = "") -> Check:
    """Judge how a run follows its reference, as the verb `check` does.

    Args:
        run: a run, or a bag.
        bound: on the largest error, deg for what turns, mm for what slides.
        skip_s: seconds at the start that are not judged.
        namespace: of the leg in a bag.

    Raises:
        OrthosisError: the bag is unusable, or there is nothing to judge.
    """
    most, skipped = Bound(given.number(bound, "bound")), given.number(skip_s, "skip_s")
    with _bags() as bags:
        (bag,) = bags.of([run], "run")
        return Check(**vars(judge(bag, most, skipped, given.text(namespace, "namespace"))))


@dataclass(frozen=True, eq=False, repr=False)
class Gap:
    """What a gap search found.

    Attributes:
        outcome: all of it.
        words: what the verb `gap` prints of it, with its options as arguments of Python.
        nominal: parameters of the model that was searched; None of a system of your own.
    """

    outcome: Outcome
    words: str
    nominal: Parameters | None

    @property
    def verdict(self) -> str:
        """`none`, `explained`, `unexplained`, or another word of `gap.json`."""
        return self.outcome.verdict

    @property
    def effects(self) -> dict[str, dict[str, float]]:
        """Effect -> parameter -> value, SI."""
        return {one.name: {k: v[0] for k, v in one.parameters.items()} for one in self.outcome.effects}

    def as_dict(self) -> dict[str, Any]:
        """Return what `gap.json` holds on the search."""
        from pam_orthosis.discrepancy.answer.contract import as_dict

        return as_dict(self.outcome)

    def changes(self) -> dict[str, Any]:
        """Return what was found as changes of the nominal model: a `model` file, or for `simulate`.

        Raises:
            OrthosisError: a system of your own was searched that cannot have other parameters.
        """
        from pam_orthosis.discrepancy.answer import patch

        if self.nominal is None and self.outcome.system.changed is None:
            raise OrthosisError("a system written by hand has no parameters to change; see `effects`")
        changed = patch.changes_of(self.outcome)
        return changed | ({} if self.nominal is None else patch.limits(self.nominal, changed))

    @arguments_named()
    def save_page(self, path: str | Path) -> None:
        """Write the page `gap.html`.

        Raises:
            OrthosisError: the file exists.
        """
        from pam_orthosis.report.gap import page

        write_files({given.path(path, "path"): as_text(page(self.outcome, self.words))})

    def __repr__(self) -> str:
        return self.words

    def _repr_html_(self) -> str:
        rows = [
            (
                one.name.replace("_", " "),
                name.replace("_", " "),
                f"{value:.4g}",
                f"{low:.4g} .. {high:.4g}",
                unit,
            )
            for one in self.outcome.effects
            for name, (value, unit, low, high) in one.parameters.items()
        ]
        return table(("effect", "parameter", "value", "95 %", "unit"), rows, self.words.splitlines()[-1])


def gap(
    training: Iterable[Recorded],
    held_out: Iterable[Recorded] = (),
    model: str | Path | None = None,
    jobs: int | None = None,
    machine: Machine | str | Path | None = None,
    columns: Mapping[str, str] | Sequence[str] = (),
    namespace: str = "",
    system: str | Path | None = None,
) -> Gap:
    """Find which physical effect is missing in the nominal model, as the verb `gap` does.

    Args:
        training: runs, bags or tables to fit.
        held_out: those that judge and are not fitted; if empty, the last quarter of each of `training`.
        model: YAML file with parameters of the nominal model that differ from those recorded.
        jobs: processes at a time (number of cores); the answer does not depend on it.
        machine: tables, or bags that do not say so, are of this machine: its YAML file, or what
            `machine(path)` returned.
        columns: signal -> column of tables, such as `{"angle": "knee [deg]", "time": "t:ms"}`, or a list of
            texts `SIGNAL=COLUMN`; `-COLUMN` counts the other way round.
        namespace: of the leg in the bags.
        system: the recordings are of a system of your own: its Python file with `system()`, which is run.

    Raises:
        OrthosisError: a recording is unfit or given twice, or they are of different machines; no column for
            a signal, or a file is unusable.
    """
    from pam_orthosis.discrepancy.answer.verdict import describe
    from pam_orthosis.discrepancy.replay.replay import Replay
    from pam_orthosis.discrepancy.request import Asked, read_recordings
    from pam_orthosis.discrepancy.workers import Workers
    from pam_orthosis.discrepancy.workflow import find_gap

    fitted, judged = given.several(training, LISTS), given.several(held_out, LISTS)
    if not fitted:
        raise OrthosisError("gap: there is no recording to fit; give one or more in a list")
    workers = Workers(None if jobs is None else given.whole(jobs, "jobs", 1, MOST_JOBS))
    with _bags() as bags:
        asked = Asked(
            bags.of(fitted, "training run"),
            bags.of(judged, "held-out run"),
            given.file(model, "model"),
            given.machine(machine),
            given.file(system, "system"),
            given.columns(columns),
            given.text(namespace, "namespace"),
        )
        read = read_recordings(asked, workers)
        learnt, judging = ([*map(bags.recording, some)] for some in (read.training, read.held_out))
        searched, nominal = read.nominal.system, read.nominal.parameters
        outcome = find_gap(searched, learnt, judging, nominal.gap, replay=Replay(searched, workers))
    words = in_python(read.heading + describe(outcome))
    return Gap(outcome, words, nominal if system is None else None)


class _Bags:
    """Bags of runs; those that are none are written into a folder, and called by what the user gave."""

    def __init__(self, folder: Path):
        self._folder = folder
        self._called: dict[str, str] = {}
        self._written: dict[int, Path] = {}  # by the run's identity: one that is given twice is one bag

    def of(self, runs: Iterable[Recorded], called: str) -> list[Path]:
        """Return the bags of runs, called `called` and their number.

        Raises:
            OrthosisError: one is neither a run nor a path.
        """
        return [self._bag(one, f"{called} {number}") for number, one in enumerate(runs, 1)]

    def _bag(self, one: Recorded, called: str) -> Path:
        if isinstance(one, Run):
            known = self._written.get(id(one))
            return known or self._written.setdefault(id(one), self._save(one, called))
        if isinstance(one, str | Path):
            return Path(one)
        raise OrthosisError(f"{called}: give a run, a bag or a table, not {type(one).__name__}")

    def _save(self, run: Run, called: str) -> Path:
        path = self._folder / f"{len(self._called) + 1:04d}"
        self._called[str(path)] = called
        return run.save(path)

    def said(self, words: str) -> str:
        """Return words for Python, with what the user gave instead of the bags that were written of it."""
        for path, called in self._called.items():
            words = words.replace(path, called)
        return in_python(words)

    def recording(self, one: Recording) -> Recording:
        """Return a recording that is called as the user gave it."""
        return replace(one, name=self.said(one.name), remarks=tuple(map(self.said, one.remarks)))


@contextmanager
def _bags() -> Iterator[_Bags]:
    """Yield what writes bags; what refuses them names what the user gave."""
    with tempfile.TemporaryDirectory(prefix="pam-orthosis-") as folder:
        bags = _Bags(Path(folder))
        try:
            yield bags
        except OrthosisError as error:
            raise type(error)(bags.said(str(error))) from None
