# SPDX-License-Identifier: Apache-2.0
"""One HTML page about a recorded run that needs nothing but itself: no network, no other file."""

from __future__ import annotations

from html import escape

from pam_orthosis import __version__
from pam_orthosis.bag.verdict import Verdict
from pam_orthosis.model.parameters import load
from pam_orthosis.report.html import document, table
from pam_orthosis.report.run_data import MOST_POINTS, RunData
from pam_orthosis.report.run_figure import run_figure

FIGURE_ID = "run"
WIDE = "<style>body {max-width: 80em}</style>"
CONFIG = {"displaylogo": False, "responsive": True}
# plotly rejects the promise of an animation that is paused, with no reason, and nobody takes it
QUIET_PAUSE = (
    "addEventListener('unhandledrejection', e => { if (e.reason === undefined) e.preventDefault() })"
)


def run_page(run: RunData, verdict: Verdict, words: str) -> str:
    """Return the page.

    Args:
        run: what is drawn.
        verdict: on the same bag.
        words: the verdict as text.
    """
    name = run.bag.path.name
    figure = run_figure(run, verdict.bound)
    plots = figure.to_html(
        full_html=False, include_plotlyjs=True, div_id=FIGURE_ID, config=CONFIG, auto_play=False,
        post_script=QUIET_PAUSE,
        default_width="100%", default_height=f"{figure.layout.height}px",
    )  # fmt: skip
    answer = "PASSED" if verdict.passed else "FAILED"
    parts = [
        WIDE,
        f"<h1>{escape(name)}: {answer}</h1><pre>{escape(words)}</pre>",
        f"<h2>Run</h2>{_hint(run)}{plots}",
        _cycles(verdict),
        _metadata(run),
    ]
    return document(name, "".join(parts))


def _hint(run: RunData) -> str:
    words = (
        "<p>Drag to zoom in all plots at once, double click to zoom out. The actuators' colour is"
        " their pressure (dark 1 bar, light 7 bar), their width their diameter.</p>"
    )
    if run.thinned:
        words += (
            f"<p>There are more samples than a page can carry: each curve shows at most {MOST_POINTS} of"
            " them, the smallest and the largest of equal stretches of time. No peak is left out. The verdict"
            " is of all samples.</p>"
        )
    return words


def _cycles(verdict: Verdict) -> str:
    if not verdict.cycles:
        return ""
    rows = [
        (str(c.number or "rest"), f"{c.start_s:.2f}", f"{c.max_abs_error:.3f}", f"{c.rms_error:.3f}")
        for c in verdict.cycles
    ]
    head = ("cycle", "from / s", f"maximum error / {verdict.unit}", f"RMS error / {verdict.unit}")
    return "<h2>Cycle by cycle</h2>" + table(head, rows)


def _metadata(run: RunData) -> str:
    metadata = {key: value for key, value in run.bag.run.items() if key != "parameters"}
    rows = [
        ("bag", run.bag.path.name),
        *sorted(metadata.items()),
        ("page written by", f"pam-orthosis {__version__}"),
    ]
    changed = _changed(run)
    page = "<h2>Recording</h2>" + table(("what", "value"), rows)
    if run.bag.parameters:
        page += "<h2>Parameters that differ from the shipped ones</h2>"
        page += (
            table(("parameter", "value", "shipped", "unit", "meaning"), changed) if changed else "<p>none</p>"
        )
    return page


def _changed(run: RunData) -> list[tuple[str, ...]]:
    shipped = {row.key: row for row in load(machine=run.machine).rows()}
    return [
        (key, str(value), str(shipped[key].value), shipped[key].unit, shipped[key].meaning)
        for key, value in run.bag.parameters.items()
        if key in shipped and value != shipped[key].value
    ]
