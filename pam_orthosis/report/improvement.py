# SPDX-License-Identifier: Apache-2.0
"""What learning did to the tracking: one table, one figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, BinaryIO

import numpy as np
from matplotlib.figure import Figure

from pam_orthosis.improvement.rounds import Round, Tracking
from pam_orthosis.report.run_data import read_run

DPI = 110
BEFORE, AFTER = "0.6", "tab:red"
HEAD = "| model of the controllers | maximum error | RMS error | voltage variation |\n|---|---|---|---|\n"


def table(rounds: Sequence[Mapping[str, Any]]) -> str:
    """Return the table in Markdown from the rounds of `improve.json` (`Round.as_dict`).

    The worst run of each round's model, the same gains throughout.
    """
    return HEAD + "".join(_row(one) for one in rounds if one["tracking"]) + _end(rounds[-1])


def _row(one: Mapping[str, Any]) -> str:
    dropped = "" if one["kept"] else " (not kept)"
    largest, rms, variation = one["tracking"].values()
    name, unit = _model(one["round"], one["effects"]), next(iter(one["tracking"])).rpartition("_")[2]
    return f"| {name}{dropped} | {largest:.3f} {unit} | {rms:.3f} {unit} | {variation:.0f} V/s |\n"


def _model(number: int, effects: Sequence[str]) -> str:
    if not number:
        return "nominal model"
    return f"round {number}: + {', '.join(name.replace('_', ' ') for name in effects)}"


def _end(last: Mapping[str, Any]) -> str:
    return "" if last["tracking"] else f"\nRound {last['round']}: {last['reason']}.\n"


def draw(rounds: Sequence[Round], stream: BinaryIO) -> None:
    """Draw reference and error over time, before and after, and the figures of each round."""
    judged = [one for one in rounds if one.tracking is not None]
    kept = [one for one in judged if one.kept]
    figure = Figure(figsize=(12, 6), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=(3, 1))
    axes = left.subplots(2, 1, sharex=True)
    for one, colour in ((kept[0], BEFORE), (kept[-1], AFTER)):
        time, reference, error = errors(one.tracking)
        axes[1].plot(time, error, color=colour, lw=0.8, label=label(one))
    axes[0].plot(time, reference, color="k", lw=1)
    unit = kept[0].tracking.verdicts[0].unit
    axes[0].set_ylabel(f"reference / {unit}")
    axes[1].set(ylabel=f"error / {unit}", xlabel="time / s")
    axes[1].legend(loc="lower left", fontsize=8)
    _bars(right.subplots(), judged)
    figure.savefig(stream, dpi=DPI, format="png")


def label(one: Round) -> str:
    """Return what the controllers know in a round."""
    return _model(one.number, one.found.effects if one.found else ())


def _bars(axes, judged: Sequence[Round]) -> None:
    places = np.arange(len(judged))
    axes.bar(places - 0.2, [one.tracking.largest for one in judged], 0.4, label="maximum", color="tab:blue")
    axes.bar(places + 0.2, [one.tracking.rms for one in judged], 0.4, label="RMS", color="tab:orange")
    axes.set_xticks(places, [f"round {one.number}" for one in judged])
    axes.set(ylabel=f"error of the worst run / {judged[0].tracking.verdicts[0].unit}")
    axes.legend()


def errors(tracking: Tracking) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return time, s, reference and error of the worst run, from its bag, (n,) each."""
    worst = max(zip(tracking.bags, tracking.verdicts, strict=True), key=lambda p: p[1].max_abs_error)[0]
    run = read_run(worst)
    reference, error = run.panels[0].curves[0], run.panels[1].curves[0]
    return error.time, np.interp(error.time, reference.time, reference.value), error.value
