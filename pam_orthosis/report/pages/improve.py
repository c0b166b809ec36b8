# SPDX-License-Identifier: Apache-2.0
"""The page of learning: what was learned round by round, and tracking before and after."""

from __future__ import annotations

from collections.abc import Sequence

from pam_orthosis.improvement.rounds import Round
from pam_orthosis.report.improvement import errors, label
from pam_orthosis.report.page import BAD, GOOD, Page, Part, listed
from pam_orthosis.report.plots import AFTER, BEFORE, REFERENCE, Plot, bars, line


def page(rounds: Sequence[Round], words: str) -> str:
    """Return the page; `words` are what the verb prints."""
    judged = [one for one in rounds if one.tracking is not None]
    kept = [one for one in judged if one.kept]
    first, last = kept[0].tracking, kept[-1].tracking
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
        (label(one), "yes" if one.kept else "no", f"{one.tracking.largest:.3f}", f"{one.tracking.rms:.3f}",
         f"{one.tracking.variation:.0f}", one.reason)
        for one in judged
    ]  # fmt: skip
    head = ("model of the controllers", "kept", f"maximum / {unit}", f"RMS / {unit}", "valves / V/s", "why")
    parts = [
        Part("Round by round", table=listed(head, rows), plots=[_rounds(judged, unit)]),
        Part("The worst run, before and after", plots=_curves(kept[0], kept[-1], unit)),
        Part("All numbers", pre=words, more="as improve prints it"),
    ]
    tone, answer = (GOOD, "better") if better else (BAD, "no better")
    return Page("improve", answer, tone, headline, meaning, parts, "learning missing effects").html()


def _rounds(judged: Sequence[Round], unit: str) -> Plot:
    names = [f"round {one.number}" for one in judged]
    largest, rms = ([getattr(one.tracking, kind) for one in judged] for kind in ("largest", "rms"))
    alt = ", ".join(
        f"{name}: maximum {one:.2f}, RMS {other:.2f}"
        for name, one, other in zip(names, largest, rms, strict=True)
    )
    data = [bars(names, largest, "maximum", AFTER), bars(names, rms, "RMS", BEFORE, "/")]
    return Plot("Error of the worst run", alt, "", f"error / {unit}", data)


def _curves(first: Round, last: Round, unit: str) -> list[Plot]:
    drawn = {"before": (first, BEFORE, "dash"), "after": (last, AFTER, "solid")}
    found = {name: (errors(one.tracking), colour, dash) for name, (one, colour, dash) in drawn.items()}
    (time, reference, _), _, _ = found["before"]
    data = [line(t, error, name, colour, dash) for name, ((t, _, error), colour, dash) in found.items()]
    largest = [f"{abs(error).max():.2f} {unit} {name}" for name, ((_, _, error), _, _) in found.items()]
    alt = f"error of the worst run over time: at most {', '.join(largest)}"
    return [
        Plot("Reference", f"reference in {unit} over time", "time / s", f"reference / {unit}",
             [line(time, reference, "reference", REFERENCE)], (), "time"),
        Plot("Error: reference less measured", alt, "time / s", f"error / {unit}", data, (), "time"),
    ]  # fmt: skip
