# SPDX-License-Identifier: Apache-2.0
"""The campaign of bad input: as many mutated inputs as asked for, of all kinds by turns."""

from __future__ import annotations

import itertools
import json
import shutil
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fault_campaign import bag_mutations, deep_mutations, text_mutations
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
        deep_mutations.read_trials(base, rng),
        deep_mutations.bag_trials(base, rng),
        deep_mutations.metadata_trials(base, rng),
        deep_mutations.table_trials(base, rng),
    ]
    while True:
        for source in (*finite, *endless):
            yield from itertools.islice(source, 1)


def campaign(work: Path, walk: Path, count: int, seed: int, rows: Path | None = None) -> list[dict]:
    """Try so many inputs; tell of each that is wrong as it is found.

    With a file of `rows` each is kept there, and those that are there already are not done again.
    """
    import pam_orthosis.cli.check
    import pam_orthosis.cli.identify
    import pam_orthosis.cli.rig
    import pam_orthosis.cli.run
    import pam_orthosis.discrepancy.workflow
    import pam_orthosis.report.walk  # noqa: F401  loaded once, for all forks

    told = {"seed": seed, "rows": []}
    if rows and rows.exists():
        told = json.loads(rows.read_text())
        if told["seed"] != seed:
            raise SystemExit(f"{rows} holds rows of --seed {told['seed']}")
    for number, trial in enumerate(itertools.islice(trials(work / "base", walk, seed), count)):
        if number < len(told["rows"]):
            continue
        folder = work / f"{number}"
        folder.mkdir()
        result = attempt(trial, folder, console=number % CONSOLE_EVERY == 0)
        told["rows"].append(_row(result))
        if rows:
            rows.parent.mkdir(parents=True, exist_ok=True)
            rows.write_text(json.dumps(told, indent=1) + "\n")
        for fault in result.faults:
            line = f"{number} {trial.kind}: {trial.what}: {fault} | {result.message}"[:400]
            print(line, file=sys.stderr, flush=True)
        if not result.faults:
            shutil.rmtree(folder)
    return told["rows"][:count]


def _row(result: Result) -> dict:
    return {
        "kind": result.trial.kind, "what": result.trial.what, "verb": result.verb, "status": result.status,
        "work_s": round(result.took_s, 2), "memory_mib": result.memory >> 20, "faults": result.faults,
        "message": result.message[:300],
    }  # fmt: skip


def summary(rows: list[dict], by: str = "kind") -> dict:
    """Return counts by kind, or by verb: tried, refused, judged, tracebacks, hangs, other faults, most."""
    told = {}
    for kind in dict.fromkeys(row[by] for row in rows):
        mine = [row for row in rows if row[by] == kind]
        faults = Counter(fault.split(":")[0] for row in mine for fault in row["faults"])
        told[kind] = {
            "tried": len(mine),
            "refused": sum(row["status"] == 2 for row in mine),
            "judged": sum(row["status"] in (0, 1) for row in mine),
            "tracebacks": faults.pop("traceback", 0),
            "hangs": faults.pop("hangs", 0),
            "other_faults": sum(faults.values()),
            "longest_s": max(row["work_s"] for row in mine),
            "most_mib": max(row["memory_mib"] for row in mine),
        }
    return told


def table(told: dict) -> str:
    """Return a summary as lines of text, all together last."""
    names = ("tried", "refused", "judged", "tracebacks", "hangs", "other_faults")
    lines = [f"{'':16s}" + "".join(f"{name:>13s}" for name in (*names, "longest_s", "most_mib"))]
    for kind, each in told.items():
        counts = "".join(f"{each[name]:13d}" for name in names)
        lines.append(f"{kind:16s}{counts}{each['longest_s']:13.2f}{each['most_mib']:13d}")
    total = ", ".join(f"{sum(each[name] for each in told.values())} {name}" for name in names)
    return "\n".join([*lines, total.replace("_", " ")])
