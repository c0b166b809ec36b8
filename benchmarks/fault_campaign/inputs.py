# SPDX-License-Identifier: Apache-2.0
"""The campaign of bad input: as many mutated inputs as asked for, of all kinds by turns."""

from __future__ import annotations

import itertools
import shutil
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fault_campaign import bag_mutations, text_mutations
from fault_campaign.trial import Result, Trial, attempt

CONSOLE_EVERY = 20  # one input in so many goes to a new interpreter instead of a fork


def trials(work: Path, walk: Path, seed: int) -> Iterator[Trial]:
    """Yield, without end, trials of all kinds by turns; those that are few come once."""
    base = bag_mutations.Bags(work, walk)
    rng = np.random.default_rng(seed)
    finite = [text_mutations.slip_trials(), text_mutations.place_trials(base), text_mutations.option_trials()]
    endless = [
        bag_mutations.byte_trials(base, rng),
        bag_mutations.message_trials(base, rng),
        text_mutations.parameter_trials(rng),
        text_mutations.config_trials(rng),
        text_mutations.model_trials(base, rng),
        text_mutations.table_trials(base, rng),
    ]
    while True:
        for source in (*finite, *endless):
            yield from itertools.islice(source, 1)


def campaign(work: Path, walk: Path, count: int, seed: int) -> list[Result]:
    """Try so many inputs; tell of each that is wrong as it is found."""
    import pam_orthosis.cli.check
    import pam_orthosis.cli.identify
    import pam_orthosis.cli.rig
    import pam_orthosis.cli.run
    import pam_orthosis.discrepancy.workflow
    import pam_orthosis.report.walk  # noqa: F401  loaded once, for all forks

    results = []
    for number, trial in enumerate(itertools.islice(trials(work / "base", walk, seed), count)):
        folder = work / f"{number}"
        folder.mkdir()
        result = attempt(trial, folder, console=number % CONSOLE_EVERY == 0)
        results.append(result)
        for fault in result.faults:
            print(f"{number} {trial.kind}: {trial.what}: {fault} | {result.message}"[:400], file=sys.stderr)
        if not result.faults:
            shutil.rmtree(folder)
    return results


def summary(results: list[Result]) -> dict:
    """Return counts by kind: tried, refused, judged, tracebacks, hangs, other faults, longest s."""
    told = {}
    for kind in dict.fromkeys(result.trial.kind for result in results):
        mine = [result for result in results if result.trial.kind == kind]
        faults = Counter(fault.split(":")[0] for result in mine for fault in result.faults)
        told[kind] = {
            "tried": len(mine),
            "refused": sum(result.status == 2 for result in mine),
            "judged": sum(result.status in (0, 1) for result in mine),
            "tracebacks": faults.pop("traceback", 0),
            "hangs": faults.pop("hangs", 0),
            "other_faults": sum(faults.values()),
            "longest_s": round(max(result.took_s for result in mine), 2),
        }
    return told
