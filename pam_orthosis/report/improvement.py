# SPDX-License-Identifier: Apache-2.0
"""What learning did to the tracking: table, plots, page."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pam_orthosis.improvement.rounds import Round, Tracking
from pam_orthosis.report.page import BAD, GOOD, Page, Part, listed
from pam_orthosis.report.plots import AFTER, BEFORE, REFERENCE, Plot, bars, line
from pam_orthosis.report.run_data import read_run

HEAD = "| model of the controllers | maximum error | RMS error | voltage variation |\n|---|---|---|---|\n"


def table(rounds: Sequence[Mapping[str, Any]]) -> str:
    """Return the table in Markdown from the rounds of `improve.json` (`Round.as_dict`).

    The worst run of each round's model, the same gains throughout.
    """
    return HEAD + "".join(_row(one) for one in rounds if one["tracking"]) + _end(rounds[-1])


def _row(one: Mapping[str, Any]) -> str:
    dropped = "" if one["kept"] else " (not kept)"
    largest, rms, variation = one["tracking"].values()
    name = _model(one["round"], one["effects"])
    unit = next(iter(one["tracking"])).rpartition("_")[2]
    return f"| {name}{dropped} | {largest:.3f} {unit} | {rms:.3f} {unit} | {variation:.0f} V/s |\n"


def _model(number: int, effects: Sequence[str]) -> str:
    if not number:
        return "nominal model"
    return f"round {number}: + {', '.join(name.replace('_', ' ') for name in effects)}"


def _end(last: Mapping[str, Any]) -> str:
    return "" if last["tracking"] else f"\nRound {last['round']}: {last['reason']}.\n"


def label(one: Round) -> str:
    """Return what the controllers know in a round."""
    return _model(one.number, one.found.effects if one.found else ())


def errors(tracking: Tracking) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return time, s, reference and error of the worst run, from its bag, (n,) each."""
    worst = max(zip(tracking.bags, tracking.verdicts, strict=True), key=lambda p: p[1].max_abs_error)[0]
    run = read_run(worst)
    reference, error = run.panels[0].curves[0], run.panels[1].curves[0]
    return error.time, np.interp(error.time, reference.time, reference.value), error.value


def page(rounds: Sequence[Round], words: str) -> str:
    """Return the page; `words` are what the verb prints."""
    judged = _judged(rounds)
    kept = [tracking for one, tracking in judged if one.kept]
    first, last = kept[0], kept[-1]
    better, unit = len(kept) > 1, first.verdicts[0].unit
    headline = (
        f"The worst run's largest error falls from {first.largest:.2f} to {last.largest:.2f} {unit},"
        f" its RMS error from {first.rms:.3f} to {last.rms:.3f} {unit}."
        if better
        else f"Nothing that was learned makes the machine follow better: {rounds[-1].reason}."
    )
    meaning = [
        "The gains stay as they are: only the controllers' model changes, by effects found in recordings."
    ]
    rows = [
        (label(one), "yes" if one.kept else "no", f"{tracking.largest:.3f}", f"{tracking.rms:.3f}",
         f"{tracking.variation:.0f}", one.reason)
        for one, tracking in judged
    ]  # fmt: skip
    head = ("model of the controllers", "kept", f"maximum / {unit}", f"RMS / {unit}", "valves / V/s", "why")
    by_round, *curves = plots(rounds)
    parts = [
        Part("Round by round", table=listed(head, rows), plots=[by_round]),
        Part("The worst run, before and after", plots=curves),
        Part("All numbers", pre=words, more="as improve prints it"),
    ]
    tone, answer = (GOOD, "better") if better else (BAD, "no better")
    return Page("improve", answer, tone, headline, meaning, parts, "learning missing effects").html()


def plots(rounds: Sequence[Round]) -> list[Plot]:
    """Return the errors of the rounds, then reference and error over time, before and after."""
    judged = _judged(rounds)
    kept = [tracking for one, tracking in judged if one.kept]
    unit = kept[0].verdicts[0].unit
    return [_rounds(judged, unit), *_curves(kept[0], kept[-1], unit)]


def _judged(rounds: Sequence[Round]) -> list[tuple[Round, Tracking]]:
    return [(one, one.tracking) for one in rounds if one.tracking is not None]


def _rounds(judged: Sequence[tuple[Round, Tracking]], unit: str) -> Plot:
    names = [f"round {one.number}" for one, _ in judged]
    largest, rms = ([getattr(tracking, kind) for _, tracking in judged] for kind in ("largest", "rms"))
    alt = ", ".join(
        f"{name}: maximum {one:.2f}, RMS {other:.2f}"
        for name, one, other in zip(names, largest, rms, strict=True)
    )
    data = [bars(names, largest, "maximum", AFTER), bars(names, rms, "RMS", BEFORE, "/")]
    return Plot("Error of the worst run", alt, "", f"error / {unit}", data)


def _curves(first: Tracking, last: Tracking, unit: str) -> list[Plot]:
    drawn = {"before": (first, BEFORE, "dash"), "after": (last, AFTER, "solid")}
    found = {name: (errors(one), colour, dash) for name, (one, colour, dash) in drawn.items()}
    (time, reference, _), _, _ = found["before"]
    data = [line(t, error, name, colour, dash) for name, ((t, _, error), colour, dash) in found.items()]
    largest = [f"{abs(error).max():.2f} {unit} {name}" for name, ((_, _, error), _, _) in found.items()]
    alt = f"error of the worst run over time: at most {', '.join(largest)}"
    return [
        Plot("Reference", f"reference in {unit} over time", "time / s", f"reference / {unit}",
             [line(time, reference, "reference", REFERENCE)], (), "time"),
        Plot("Error: reference less measured", alt, "time / s", f"error / {unit}", data, (), "time"),
    ]  # fmt: skip
