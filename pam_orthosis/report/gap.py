# SPDX-License-Identifier: Apache-2.0
"""The page of the gap workflow: what is missing, how sure that is, what it explains, what to measure next."""

from __future__ import annotations

from collections.abc import Sequence

from pam_orthosis.discrepancy.findings import Named
from pam_orthosis.discrepancy.judgement import Outcome
from pam_orthosis.discrepancy.measure import OVERALL
from pam_orthosis.model.parameters import experiments, scenario_names
from pam_orthosis.report import gap_figures
from pam_orthosis.report.gap_figures import spoken
from pam_orthosis.report.page import BAD, GOOD, NEUTRAL, Page, Part, listed

MOST_LISTED = 8  # parameters of an effect; the coefficients of a curve are shown as the curve
TONES = {"none": GOOD, "recalibrated": GOOD, "explained": GOOD, "unexplained": BAD}
MEANINGS = {
    "none": "Recalibrated within its tolerances, the model explains the recordings down to their noise.",
    "recalibrated": "Recalibration alone leaves noise; the effect below is better evidence than that.",
    "explained": "Model and recordings differ by more than noise, and the effect below accounts for it.",
    "partial": "The effects below account for a part of the difference; the rest has no name.",
    "described": "A curve describes the difference; the catalogue has no name for its cause.",
    "unexplained": "Model and recordings differ, and nothing in the catalogue accounts for it.",
}
FOREIGN = "The recordings are of another machine than the model, or their columns, signs or units are wrong."
GAP = (
    "The gap is what remains between recordings and model, above the noise, when parameters are recalibrated"
    " within their tolerances."
)
AT_BOUND = ", at its bound"


def page(outcome: Outcome, words: str, next_experiments: Sequence[str] = ()) -> str:
    """Return the page.

    Args:
        outcome: of the search.
        words: what the verb prints; its last line is the verdict.
        next_experiments: names of experiments that the data call for, the most useful first.
    """
    answer = words.splitlines()[-1]
    parts = [
        *_missing(outcome), *_sure(outcome), _smaller(outcome), _next(outcome, next_experiments),
        Part("Measured and predicted", ("Four seconds of the held-out recordings where the gap is largest.",),
             plots=gap_figures.traces(outcome)),
        Part("All numbers", pre=words, more="as gap prints them"),
    ]  # fmt: skip
    meant = FOREIGN if outcome.foreign else MEANINGS.get(outcome.verdict)
    meaning = [text for text in (meant, GAP) if text]
    tone = TONES.get(outcome.verdict, NEUTRAL)
    return Page(
        "gap",
        answer.split()[0].strip(":"),
        tone,
        _headline(outcome, answer),
        meaning,
        parts,
        f"gap search, {outcome.system.name}",
    ).html()


def _headline(outcome: Outcome, answer: str) -> str:
    share, names = outcome.closure[OVERALL], " and ".join(spoken(one.name) for one in outcome.effects)
    if outcome.verdict != "explained" or share is None:
        return answer
    return f"Missing is {names}: it closes {100 * share:.1f} % of the gap on recordings that were not fitted."


def _missing(outcome: Outcome) -> list[Part]:
    found = [_effect(outcome, one, "") for one in outcome.effects]
    found += [_effect(outcome, one, " (best surrogate, no explanation)") for one in outcome.surrogates]
    if plots := gap_figures.unknown(outcome):
        words = (
            "The unknown, described: a curve over one signal. It is no cause, and `model.yaml` has it not."
        )
        found.append(Part("What nothing explains", (words,), plots=plots))
    if plots := gap_figures.missing(outcome):
        words = "What the equations lack, before and after: a curve that is flat at zero lacks nothing."
        found.append(Part("What the model misses", (words,), plots=plots))
    return found


def _effect(outcome: Outcome, one: Named, remark: str) -> Part:
    effect = outcome.system.catalogue[one.name]
    known = {quantity.name: quantity for quantity in effect.parameters}
    bounds = {free.name: free for free in outcome.selection.final.free}
    rows = []
    for name, (value, unit, low, high) in one.parameters.items():
        free = bounds[f"{one.name}.{name}"]
        near = 1e-6 * (free.upper - free.lower)
        mark = AT_BOUND if min(value - free.lower, free.upper - value) <= near else ""
        told = f"{value:.4g} {unit}".removesuffix(" -") + mark
        rows.append((spoken(name), told, f"{low:.4g} .. {high:.4g}", known[name].meaning))
    words = [effect.physics, f"Source: {effect.source}"]
    if held := sum(row[1].endswith(AT_BOUND) for row in rows):
        words.append(f"{held} of {len(rows)} values lie at a bound; the true ones may be beyond it.")
    head = ("parameter", "value", "95 % interval", "meaning")
    if len(rows) > MOST_LISTED:
        words.append(f"It is a curve of {len(rows)} coefficients, which is drawn below.")
        text = "\n".join("  ".join(row).rstrip() for row in rows)
        return Part(f"Missing: {spoken(one.name)}{remark}", words, pre=text, more=f"{len(rows)} coefficients")
    return Part(f"Missing: {spoken(one.name)}{remark}", words, listed(head, rows))


def _sure(outcome: Outcome) -> list[Part]:
    words = []
    for one in (*outcome.effects, *outcome.surrogates):
        others = ", ".join(map(spoken, one.look_alikes))
        words.append(
            f"These data do not separate {spoken(one.name)} from {others}."
            if others
            else f"Nothing else in the catalogue comes near {spoken(one.name)}."
        )
    if outcome.runner_up and outcome.effects:
        name, behind = outcome.runner_up
        words.append(f"The next best, {spoken(name)}, is {behind:.0f} behind in evidence.")
    if outcome.strained:
        told = ", ".join(f"{spoken(name)} by {value:+.1f}" for name, value in outcome.strained.items())
        words.append(f"Calibration had to leave its tolerance, in multiples of it: {told}.")
    plot = gap_figures.ranking(outcome)
    return [Part("How sure", words, plots=[plot] if plot else [])] if words or plot else []


def _smaller(outcome: Outcome) -> Part:
    share = outcome.closure[OVERALL]
    words = ["There is hardly any gap to close."] if share is None else [
        f"{100 * share:.1f} % of the gap is closed, on recordings that were not fitted."
    ]  # fmt: skip
    rows = []
    for channel in outcome.system.channels:
        if channel.name in outcome.after.units:
            gaps = (outcome.configured, outcome.before, outcome.after, outcome.floor)
            sizes = [f"{gap.units[channel.name] * channel.report_factor:.3g}" for gap in gaps]
            closed = outcome.closure[channel.name]
            rows.append((
                f"{spoken(channel.name)} / {channel.report_unit}", *sizes,
                "-" if closed is None else f"{100 * closed:.1f} %",
            ))  # fmt: skip
    head = ("channel, RMS", "as configured", "recalibrated", "with what was found", "noise", "closed")
    return Part("How much smaller the gap is", words, listed(head, rows), plots=[gap_figures.sizes(outcome)])


def _next(outcome: Outcome, more: Sequence[str]) -> Part:
    ask = [(one, test) for one in outcome.effects for test in one.separated_by[:1]]
    words = [f"To tell {spoken(one.name)} from what resembles it: {_experiment(test)}" for one, test in ask]
    asked = {test for _, test in ask}
    words += [f"To see more of the catalogue: {_experiment(test)}" for test in more[:1] if test not in asked]
    return Part("What to measure next", words or ["Nothing: these data show and separate what was found."])


def _experiment(name: str) -> str:
    done = experiments().get(name, scenario_names().get(name, name))
    return f"{done} (emulated by `run --scenario {name}`)." if name in scenario_names() else f"{done}."
