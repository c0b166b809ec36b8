# SPDX-License-Identifier: Apache-2.0
"""The page of a recorded device: the verdict on each joint and shoe, the moving machines, their curves."""

from __future__ import annotations

from collections.abc import Mapping

from pam_orthosis.bag.verdict import Verdict
from pam_orthosis.report.page import BAD, GOOD, Page, Part, listed
from pam_orthosis.report.run_data import RunData
from pam_orthosis.report.run_page import HINT, moving, plot

DRAWN = 3  # panels of each machine: coordinate, error, pressures
HEAD = ("machine", "answer", "largest error", "RMS error", "bound", "load on the sole")


def device_page(name: str, runs: Mapping[str, RunData], verdicts: Mapping[str, Verdict], words: str) -> str:
    """Return the page.

    Args:
        name: of the bag.
        runs: what is drawn, by namespace.
        verdicts: on the same, by namespace.
        words: the verdicts as text.
    """
    failed = [one for one, verdict in verdicts.items() if not verdict.passed]
    tone, answer = (BAD, "FAILED") if failed else (GOOD, "PASSED")
    within = f"beyond their bounds are {', '.join(failed)}" if failed else "all are within their bounds"
    headline = f"The bag holds {len(verdicts)} machines; {within}."
    incomplete = [f"{one} is incomplete: {v.incomplete}." for one, v in verdicts.items() if v.incomplete]
    table = listed(HEAD, [_row(one, verdict) for one, verdict in verdicts.items()])
    parts = [
        Part("Verdicts", table=table, pre=words, more="as check prints it"),
        *(part for one, run in runs.items() for part in _parts(one, run, verdicts[one])),
    ]
    return Page(name, answer, tone, headline, incomplete, parts, "recorded run of several machines").html()


def _row(name: str, verdict: Verdict) -> tuple[str, ...]:
    unit, answer = verdict.unit, "PASSED" if verdict.passed else "FAILED"
    sizes = (verdict.max_abs_error, verdict.rms_error, verdict.bound)
    loads = (f"{which} {one.peak_N:.0f} N of {one.set_peak_N:.0f}" for which, one in verdict.loads.items())
    return name, answer, *(f"{size:.3f} {unit}" for size in sizes), ", ".join(loads) or "-"


def _parts(name: str, run: RunData, verdict: Verdict) -> tuple[Part, Part]:
    plots = [plot(panel, run, verdict.bound) for panel in run.panels[:DRAWN]]
    return Part(f"{name}: the machine", (HINT,), machine=moving(run)), Part(f"{name}: curves", plots=plots)
