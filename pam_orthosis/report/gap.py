# SPDX-License-Identifier: Apache-2.0
"""The page of the gap workflow: what is missing, how sure that is, what it explains, what to measure next."""

from collections.abc import Sequence

from pam_orthosis.discrepancy.answer.curves import curves
from pam_orthosis.discrepancy.answer.digits import digits, interval_words
from pam_orthosis.discrepancy.answer.judgement import Outcome
from pam_orthosis.discrepancy.answer.unknown_words import resemblance
from pam_orthosis.discrepancy.answer.verdict import runner_up_words
from pam_orthosis.discrepancy.fitting.measure import OVERALL
from pam_orthosis.discrepancy.search.findings import Named
from pam_orthosis.model.parameters import experiments, scenario_names
from pam_orthosis.report import gap_figures
from pam_orthosis.report.gap_figures import spoken
from pam_orthosis.report.page import BAD, GOOD, NEUTRAL, Page, Part, listed

TONES = {"none": GOOD, "recalibrated": GOOD, "explained": GOOD, "unexplained": BAD}
MEANINGS = {
    "none": "Recalibrated within its tolerances, the model explains the recordings down to their noise.",
    "recalibrated": "Recalibration leaves noise, but moves parameters far; no effect is named.",
    "explained": "Model and recordings differ by more than noise, and what is named below accounts for it.",
    "partial": "The effects below account for a part of the difference; the rest has no name.",
    "described": "A curve describes the difference; the catalogue has no name for its cause.",
    "unexplained": "Model and recordings differ, and nothing in the catalogue accounts for it.",
}
NAMED = "Recalibration alone leaves noise; what is named below explains it better."
MISTAKEN = "Something seems mistaken (see below); what makes up for a mistake is no explanation."
FOREIGN = (
    "Something large is missing in the model, or the recordings are of another machine, or their columns,"
    " signs or units are wrong."
)
GAP = (
    "The gap is what remains between recordings and model, above the noise, when parameters are recalibrated"
    " within their tolerances."
)
CURVE = (
    "The curves below show it where these recordings say something of it; dotted lines, or numbers in"
    " brackets, are the 95 % interval."
)
EVIDENCE = (
    "Evidence says how much better the recordings are explained with an effect than without it; parameters"
    " cost. Each 10 more multiply the odds by about 150."
)


def page(outcome: Outcome, words: str, next_experiments: Sequence[str] = ()) -> str:
    """Return the page.

    `words` are what the verb prints, the verdict last; `next_experiments` are names, the most useful first.
    """
    answer = words.splitlines()[-1]
    parts = [
        *_missing(outcome), *_sure(outcome), _smaller(outcome), _next(outcome, next_experiments),
        Part("Measured and predicted", ("Four seconds of the held-out recordings where the gap is largest.",),
             plots=gap_figures.traces(outcome)),
        Part("All numbers", pre=words, more="as gap prints them"),
    ]  # fmt: skip
    tone = TONES.get(outcome.verdict, NEUTRAL)
    return Page(
        "gap",
        answer.split()[0].strip(":"),
        tone,
        _headline(outcome, answer),
        [_verdict(outcome), GAP],
        parts,
        f"gap search, {outcome.system.name}",
    ).html()


def _verdict(outcome: Outcome) -> str:
    """Return what the verdict means."""
    if outcome.foreign or outcome.mistaken or outcome.skewed:
        return FOREIGN if outcome.foreign else MISTAKEN
    named = outcome.verdict == "recalibrated" and outcome.effects
    return NAMED if named else MEANINGS[outcome.verdict]


def _headline(outcome: Outcome, answer: str) -> str:
    share, wrong = outcome.closure[OVERALL], outcome.system.wrong
    if outcome.verdict != "explained" or share is None:
        words = answer.partition(": ")[2] or answer
        return f"{words[0].upper()}{words[1:]}."
    named = {
        "missing is": [spoken(one.name) for one in outcome.effects if one.name not in wrong],
        "wrong is": [_meaning(outcome, one.name) for one in outcome.effects if one.name in wrong],
    }
    first = "; ".join(f"{verb} {' and '.join(names)}" for verb, names in named.items() if names)
    does = "it closes" if len(outcome.effects) == 1 else "together they close"
    much = f"{does} {100 * share:.1f} % of the gap on recordings that were not fitted"
    return f"{first[0].upper()}{first[1:]}: {much}."


def _meaning(outcome: Outcome, name: str) -> str:
    """Return what a parameter is, of a candidate `NAME` that has one or as `EFFECT.PARAMETER`, in words."""
    effect, _, parameter = name.partition(".")
    known = {one.name: one.meaning for one in outcome.system.calibrations}
    if name in known or effect not in outcome.system.catalogue:
        return known.get(name, spoken(name))
    quantities = outcome.system.catalogue[effect].parameters
    if not parameter:
        return quantities[0].meaning
    meaning = next(q.meaning for q in quantities if q.name == parameter)
    return f"{spoken(effect)}, {meaning}"


def _missing(outcome: Outcome) -> list[Part]:
    found = [_effect(outcome, one, "") for one in outcome.effects]
    found += [_effect(outcome, one, " (fits best, but is no explanation)") for one in outcome.surrogates]
    if outcome.unknown and (plots := gap_figures.unknown(outcome)):
        words = "The unknown, described: a curve over one signal. It is no cause."
        shapes = (line for one in outcome.unknown.descriptions for line in resemblance(one))
        found.append(Part("What nothing explains", (words, *shapes), plots=plots))
    if plots := gap_figures.missing(outcome):
        words = "What the equations miss, before and after: a curve that is flat at zero misses nothing."
        found.append(Part("What the model misses", (words,), plots=plots))
    return found


def _effect(outcome: Outcome, one: Named, remark: str) -> Part:
    effect, drawn = outcome.system.catalogue[one.name], curves(outcome, one)
    title = f"{titled(outcome, one.name)}{remark}"
    words = [effect.physics, f"Source: {effect.source}"]
    if one.at_bound:
        held = f"{len(one.at_bound)} of {len(one.parameters)} values lie at a bound"
        words.append(f"{held}; the true ones may be beyond it.")
    if drawn:
        return Part(title, [*words, CURVE], plots=gap_figures.maps(drawn))
    rows, wrong = _values(outcome, one), one.name in outcome.system.wrong
    if len(rows) > 8:  # folded away
        text = "\n".join("  ".join(row).rstrip() for row in rows)
        return Part(title, words, pre=text, more=f"{len(rows)} coefficients")
    head = ("parameter", "value", "95 % interval", *(["the model has"] if wrong else []))
    return Part(title, words, listed(head, rows))


def _values(outcome: Outcome, one: Named) -> list[tuple[str, ...]]:
    """Return the parameters of an effect in words, with values, intervals, and what a wrong model has."""
    known = {quantity.name: quantity for quantity in outcome.system.catalogue[one.name].parameters}
    rows = []
    for name, (value, unit, low, high) in one.parameters.items():
        quantity, of = known[name], "" if unit == "-" else f" {unit}"
        row = quantity.meaning, f"{value:.4g}{of}" + ", at its bound" * (name in one.at_bound)
        wrong = one.name in outcome.system.wrong
        had = [f"{outcome.system.nominal_of(one.name):.4g}{of}"] if wrong else []
        rows.append((*row, interval_words(low, high, digits(low, high, 4), "to", of), *had))
    return rows


def titled(outcome: Outcome, name: str) -> str:
    """Return what was found, in words."""
    if name not in outcome.system.wrong:
        return f"Missing: {spoken(name)}"
    return f"Wrong in the model: {_meaning(outcome, name)}"


def _sure(outcome: Outcome) -> list[Part]:
    plot, words, table = gap_figures.ranking(outcome), [], None
    for one in (*outcome.effects, *outcome.surrogates):
        others = ", ".join(map(spoken, one.look_alikes))
        words.append(
            f"These recordings do not separate {spoken(one.name)} from {others}."
            if others
            else f"Nothing else in the catalogue comes near {spoken(one.name)}."
        )
    if outcome.runner_up and outcome.effects:
        said = runner_up_words(spoken(outcome.runner_up[0]), outcome.runner_up[1])
        words.append(f"{said[0].upper()}{said[1:]}.")
    if plot:
        words.append(EVIDENCE)
    if outcome.strained:
        words.append("Recalibration had to leave the tolerances in which these parameters are known:")
        rows = [(_meaning(outcome, name), f"{value:+.1f}") for name, value in outcome.strained.items()]
        table = listed(("parameter", "off by, in tolerances"), rows)
    return [Part("How sure", words, table, plots=[plot] if plot else [])] if words else []


def _smaller(outcome: Outcome) -> Part:
    share = outcome.closure[OVERALL]
    base = ", counted from the model as configured" * (OVERALL in outcome.from_configured)
    words = ["There is hardly any gap to close."] if share is None else [
        f"{100 * share:.1f} % of the gap is closed, on recordings that were not fitted{base}."
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
