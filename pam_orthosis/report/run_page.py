# SPDX-License-Identifier: Apache-2.0
"""The page of a recorded run, of one machine or of several: verdict, moving machine, curves, parameters."""

from collections.abc import Mapping

import numpy as np
from markupsafe import Markup

from pam_orthosis.bag.verdict import Verdict
from pam_orthosis.model.parameters import load
from pam_orthosis.report.page import BAD, GOOD, Moving, Page, Part, listed
from pam_orthosis.report.plots import BELOW, ESTIMATE, MEASURED, OF_ACTUATORS, Plot, Trace, line
from pam_orthosis.report.run_data import DRAWN, MOST_POINTS, Curve, Panel, RunData, rounded, view

# name of a curve -> colour, dash, width
STYLES = {
    "reference": (BELOW, "solid", 6.0),  # wide, below what follows it
    "measured": (MEASURED, "solid", 1.6),
    "estimate": (ESTIMATE, "dot", 1.8),
    "error": (MEASURED, "solid", 1.4),
    "disturbance": (MEASURED, "solid", 1.4),
}
HINT = "Actuators are as thick as they are, and coloured by their absolute pressure: dark 1 bar, light 7 bar."
SHOWS = {
    "error": "reference less measured; the dashed lines are the bound",
    "pressure": "what the sensors measure, and what the controllers ask for (dotted)",
    "valve": "what the valves are given; 5 V keeps one closed",
    "estimated": "effort that the observer ascribes to what the model does not know",
}
MEANS = {
    "maximum error": "of |reference - measured|; the bound is on it",
    "after the first cycle": "when the start is over",
    "RMS error": "root of the mean square: the usual size",
    "steady-state error": "mean size while the reference rests",
    "observer's velocity lag": "below zero the estimate is ahead",
}
WORST_FIRST = ("FAILED", "INCOMPLETE", "PASSED")
HEAD = ("machine", "answer", "largest error", "RMS error", "bound", "load on the sole")


def run_page(run: RunData, verdict: Verdict, words: str) -> str:
    """Return the page of a run; `words` is the verdict as text."""
    unit = verdict.unit
    within = "within" if verdict.max_abs_error <= verdict.bound else "beyond"
    headline = (
        f"The largest error is {verdict.max_abs_error:.3f} {unit}, {within} the bound of {verdict.bound:g}"
        f" {unit} ({verdict.samples} samples in {verdict.duration_s:.1f} s)."
    )
    incomplete = [f"The run is incomplete: {verdict.incomplete}."] if verdict.incomplete else []
    parts = [
        Part("How well it follows", table=_numbers(verdict), pre=words, more="as check prints it"),
        Part("The machine", (HINT,), machine=moving(run)),
        Part("Curves", _thinned(run), plots=[plot(panel, run, verdict.bound) for panel in run.panels]),
        *_cycles(verdict),
        *_recording(run),
    ]
    about = f"recorded run of the {run.machine.name}"
    tone = GOOD if verdict.passed else BAD
    return Page(run.bag.path.name, verdict.answer, tone, headline, incomplete, parts, about).html()


def _numbers(verdict: Verdict) -> Markup:
    told = [
        (what.strip(), f"{value:.3f} {unit}", MEANS.get(what.strip(), "how nervous the valve is"))
        for what, value, unit in verdict.figures()
    ]
    return listed(("what", "value", "meaning"), told)


def _thinned(run: RunData) -> list[str]:
    words = ["Drag over a plot to zoom in all of them at once; double-click to zoom out."]
    if run.thinned:
        words.append(
            f"There are more samples than a page can carry: each curve shows at most {MOST_POINTS} of them,"
            " the smallest and the largest of equal stretches of time, no peak is left out. The verdict"
            " is of all samples."
        )
    return words


def plot(panel: Panel, run: RunData, bound: float) -> Plot:
    """Return the curves of a panel, with the bound where they are errors."""
    what = panel.label.split(" / ")[0]
    means = next(
        (words for name, words in SHOWS.items() if what.startswith(name)), "reference and measurement"
    )
    curves = [_trace(curve, run.machine.names) for curve in panel.curves]
    levels = (bound, -bound) if what == "error" else ()
    ends = [f"{c.name} {c.value.min():.3g} to {c.value.max():.3g}" for c in panel.curves]
    return Plot(
        f"{what}: {means}", f"{panel.label} over the time in s: {', '.join(ends)}", "time / s", panel.label,
        curves, levels, "time",
    )  # fmt: skip


def _trace(curve: Curve, actuators: tuple[str, ...]) -> Trace:
    colours = dict(zip(actuators, OF_ACTUATORS, strict=False))
    own = next((name for name in actuators if curve.name.startswith(f"{name} ")), None)
    if own is None:
        return line(curve.time, curve.value, curve.name, *STYLES[curve.name.split()[0]])
    return line(
        curve.time,
        curve.value,
        curve.name,
        colours[own],
        "dot" if curve.name.endswith("reference") else "solid",
    )


def moving(run: RunData) -> Moving:
    """Return the machine as it moved."""
    per_second, most = 20, 240
    count = min(most, len(run.time), max(2, round(run.time[-1] * per_second)))
    scene = view(run, np.unique(np.linspace(0, len(run.time) - 1, count).round().astype(int)))
    actuators = {
        name: {
            **{end: rounded(getattr(one, end)) for end in ("upper", "lower", "chain", "diameter")},
            "bar": None if (bars := scene.pressures[name]) is None else rounded(bars),
        }
        for name, one in scene.sketch.actuators.items()
    }
    data = {
        "time": rounded(scene.time), "extent": rounded(scene.sketch.extent),
        "body": rounded(scene.sketch.body), "corners": scene.shape.corners, "actuators": actuators,
    }  # fmt: skip
    return Moving(f"the {run.machine.name} in side view, moving as it was recorded", data)


def _cycles(verdict: Verdict) -> list[Part]:
    if not verdict.cycles:
        return []
    rows = [
        (str(c.number or "rest"), f"{c.start_s:.2f}", f"{c.max_abs_error:.3f}", f"{c.rms_error:.3f}")
        for c in verdict.cycles
    ]
    head = ("cycle", "from / s", f"maximum error / {verdict.unit}", f"RMS error / {verdict.unit}")
    return [Part("Cycle by cycle", table=listed(head, rows))]


def _recording(run: RunData) -> list[Part]:
    metadata = {key: value for key, value in run.bag.run.items() if key != "parameters"}
    parts = [
        Part(
            "Recording",
            table=listed(("what", "value"), [("bag", run.bag.path.name), *sorted(metadata.items())]),
        )
    ]
    if run.bag.parameters:
        changed = _changed(run)
        head = ("parameter", "value", "shipped", "unit", "meaning")
        words, shown = ((), listed(head, changed)) if changed else (("none",), None)
        parts.append(Part("Parameters that differ from the shipped ones", words, shown))
    return parts


def _changed(run: RunData) -> list[tuple[str, ...]]:
    shipped = {row.key: row for row in load(machine=run.machine).rows()}
    return [
        (key, str(value), str(shipped[key].value), shipped[key].unit, shipped[key].meaning)
        for key, value in run.bag.parameters.items()
        if key in shipped and value != shipped[key].value
    ]


def device_page(name: str, runs: Mapping[str, RunData], verdicts: Mapping[str, Verdict], words: str) -> str:
    """Return the page of a bag of this name: runs and verdicts by namespace, the latter as text too."""
    answers = {one: verdict.answer for one, verdict in verdicts.items()}
    answer = min(answers.values(), key=WORST_FIRST.index)
    failed = [one for one, own in answers.items() if own == "FAILED"]
    tone = GOOD if answer == "PASSED" else BAD
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
    unit = verdict.unit
    sizes = (verdict.max_abs_error, verdict.rms_error, verdict.bound)
    loads = (f"{which} {one.peak_N:.0f} N of {one.set_peak_N:.0f}" for which, one in verdict.loads.items())
    return name, verdict.answer, *(f"{size:.3f} {unit}" for size in sizes), ", ".join(loads) or "-"


def _parts(name: str, run: RunData, verdict: Verdict) -> tuple[Part, Part]:
    plots = [plot(panel, run, verdict.bound) for panel in run.panels[:DRAWN]]
    return Part(f"{name}: the machine", (HINT,), machine=moving(run)), Part(f"{name}: curves", plots=plots)
