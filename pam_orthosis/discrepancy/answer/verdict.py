# SPDX-License-Identifier: Apache-2.0
"""What the workflow found, as words."""

from collections.abc import Mapping, Sequence
from itertools import chain

from pam_orthosis.discrepancy.answer.curves import curves, in_words
from pam_orthosis.discrepancy.answer.digits import digits, in_short, interval_words, of_unit
from pam_orthosis.discrepancy.answer.judgement import GOOD, Outcome, beyond
from pam_orthosis.discrepancy.answer.last_line import far, last_line, off_words
from pam_orthosis.discrepancy.answer.patch import DESCRIBED, changes_of, overrides
from pam_orthosis.discrepancy.answer.unknown_words import unknown_words
from pam_orthosis.discrepancy.fitting.measure import OVERALL, over_noise
from pam_orthosis.discrepancy.fitting.structure import Where
from pam_orthosis.discrepancy.preparation.beginning import Beginning
from pam_orthosis.discrepancy.preparation.identifiability import Astray, Identifiability
from pam_orthosis.discrepancy.preparation.mistakes import CHECK
from pam_orthosis.discrepancy.search.findings import Named, in_all
from pam_orthosis.discrepancy.systems.system import Channel, System
from pam_orthosis.model.parameters import experiments, scenario_names

LABEL = 25  # characters of the first column, at least
FAR = 1000  # evidence behind the best effect, of which no more is of use
FEWEST_DIGITS = 4  # of a value with its interval
MOST_NAMED, MOST_SHOWN = 3, 8  # parameters in one line: of many, and else


def describe_data(data: Identifiability) -> str:
    """Return in a few lines what the recordings can identify."""
    lines = []
    if data.hidden:
        without = f", without {' and '.join(data.missing)}" if data.missing else ""
        lines.append(f"these data cannot show{without}: {', '.join(data.hidden)}")
    if data.invisible:
        lines.append(f"these data would not show, at typical size: {', '.join(data.invisible)}")
    lines += [_endless(one) for one in data.astray]
    lines += _confounded(data.alike)
    if len(data.together) > 1:
        known = f"{', '.join(data.together[:-1])} and {data.together[-1]}"
        lines.append(f"{known} may change together without a trace in these data: tolerances alone hold them")
    if data.experiments:
        lines += _experiment("most useful next experiment", data.experiments[0])
    return "\n".join(lines) or "these data show and separate all effects of the catalogue"


def _confounded(alike: Sequence[tuple[str, str, float]]) -> list[str]:
    """Return a line on each group of effects that is confounded pair by pair."""
    groups: list[list[str]] = []
    for pair in alike:
        joined = [group for group in groups if {*group} & {*pair[:2]}]
        groups = [group for group in groups if group not in joined]
        groups.append(list(dict.fromkeys([*chain(*joined), *pair[:2]])))
    lines = []
    for group in groups:
        cosines = [f"{cosine:.2f}" for a, _, cosine in alike if a in group]
        least, most = min(cosines), max(cosines)
        said = least if least == most else f"{least} .. {most}"
        names = f"{', '.join(group[:-1])} and {group[-1]}"
        lines.append(f"confounded in these data: {names} (cosine of their sensitivities {said})")
    return lines


def _endless(one: Astray) -> str:
    """Return that an effect gives no finite number, where, and what becomes of it."""
    several = len(one.equations) > 1
    places = f"the {' and '.join(one.equations)} equation{'s' * several} give{'s' * (not several)}"
    told = f"in these data {places} no finite number with {one.name}"
    if one.always:
        return f"{told}: it is no candidate; check its expression"
    return f"{told} at typical size; others are tried"


def _experiment(purpose: str, scenario: str) -> list[str]:
    """Return how an experiment is done on an apparatus, and what emulates it, if anything does."""
    if scenario not in scenario_names():
        return [f"{purpose}: {scenario}"]
    emulated = f"pam-orthosis run --scenario {scenario}"
    known = experiments()
    if scenario not in known:
        return [f"{purpose}: {emulated}"]
    return [f"{purpose}: {known[scenario]}", f"  emulated by: {emulated}"]


def remark_lines(remarks: Sequence[str]) -> list[str]:
    """Return a line for each remark; one on a mistake of the recordings speaks for itself."""
    return [one if one.startswith(CHECK) else f"remark: {one}" for one in remarks]


def describe_replay(start: Beginning) -> str:
    """Return the gaps before any effect is added, and the nuisance parameters that had to move far."""
    width = _width(start.system)
    lines = [f"{'channel':{width}s} {'nominal':>11s} {'recalibrated':>13s} {'noise':>9s}"]
    gaps = (start.configured(), start.recalibrated(), start.floor)
    for name in start.floor.units:
        channel = start.system.channel(name)
        values = [gap.units[name] * channel.report_factor for gap in gaps]
        lines.append(f"{_label(channel):{width}s} {values[0]:11.3f} {values[1]:13.3f} {values[2]:9.3f}")
    values = [gap.white[OVERALL] for gap in gaps]
    lines.append(f"{'times the noise':{width}s} {values[0]:11.2f} {values[1]:13.2f} {values[2]:9.2f}")
    strained = start.strained()
    if strained:
        lines.append(_strain(start.problem.system, strained))
    return "\n".join(lines)


def describe_where(start: Beginning) -> str:
    """Return each equation with what is left in it, and where that is largest."""
    system, lines = start.system, []
    kept = over_noise(system, start.recalibrated(), start.floor)
    for one in start.where():
        kind = "noise" if one.clean else "above the noise"
        lines.append(f"{one.equation} equation: {kept[one.equation]:.1f} times the noise ({kind})")
        for name, share in list(one.coordinates.items())[:3]:
            lines.append(f"  {name} explains {share:.0%} of it; largest {_range(system, name, one.regions)}")
    return "\n".join(lines)


def _range(system: System, name: str, regions: Mapping[str, tuple[float, float]]) -> str:
    channel = next((c for c in system.channels if c.name == name), None)
    unit = "of the cycle" if name == "phase" else system.unit(name)
    factor, unit = (1.0, unit) if channel is None else (channel.report_factor, channel.report_unit)
    low, high = (factor * end for end in regions[name])
    return f"between {low:.4g} and {high:.4g} {unit}".rstrip()


def describe(outcome: Outcome) -> str:
    """Return the outcome as a few lines of text."""
    width = _width(outcome.system)
    lines = [f"{'channel':{width}s} {'nominal':>11s} {'before':>9s} {'after':>9s} {'noise':>9s}  explained"]
    for channel in outcome.system.channels:
        if channel.name in outcome.after.units:
            lines.append(_row(outcome, channel))
    overall = (outcome.configured, outcome.before, outcome.after, outcome.floor)
    numbers = " ".join(f"{gap.white[OVERALL]:9.2f}" for gap in overall)
    lines.append(f"{'times the noise':{width + 2}s} {numbers}  {_share(outcome, OVERALL)}")
    if outcome.from_configured:
        lines.append("* of the nominal model's gap, which recalibration alone explains")
    if outcome.effects and outcome.unknown is not None and outcome.unknown.descriptions:
        lines.append("explained: by what is named alone; below it is said what a curve removes beside it")
    worst, wrong = outcome.where[0], outcome.system.wrong
    if not worst.clean:
        seen = ", ".join(f"{name} {share:.0%}" for name, share in list(worst.coordinates.items())[:3])
        lines.append(f"gap: {worst.equation} equation; residual explained by {seen}")
    for one in outcome.effects:
        lines.append(_wrong(outcome.system, one) if one.name in wrong else f"effect: {_named(outcome, one)}")
    lines += _moved_beside(outcome)
    lines += [f"fits best, but is no explanation: {_named(outcome, one)}" for one in outcome.surrogates]
    lines += _others(outcome)
    lines += remark_lines(outcome.remarks)
    lines += _left(outcome)
    if outcome.unknown is not None:
        places = outcome.left if outcome.effects else outcome.where
        shares = {one.equation: one.coordinates for one in places}.get(outcome.unknown.equation)
        lines += unknown_words(outcome.system, outcome.unknown, shares, outcome.verdict == DESCRIBED)
    lines.append(last_line(outcome))
    return "\n".join(lines)


def _moved_beside(outcome: Outcome) -> list[str]:
    """Return a line on what is named whose values are others beside what is described."""
    if outcome.verdict != DESCRIBED or outcome.system.changed is None:
        return []
    named, changes = [one.name for one in outcome.effects], changes_of(outcome)
    alone = overrides(outcome.system, named, outcome.selection.final.values)
    moved = [f"{key} {changes[key]:.4g}" for key, value in alone.items() if changes[key] != value]
    return [f"beside what is unknown, and so in a model file: {', '.join(moved)}"] if moved else []


def _left(outcome: Outcome) -> list[str]:
    """Return how much is left although effects are named, where, and what it depends on."""
    if outcome.verdict not in ("explained", "partial"):
        return []
    kept = over_noise(outcome.system, outcome.after, outcome.floor)
    places = [one for one in outcome.left if not one.clean]
    lines = [
        f"left in the {one.equation} equation: {kept[one.equation]:.1f} times the noise" for one in places
    ]
    if outcome.verdict == "partial":
        lines = [line + _depending(outcome, one) for line, one in zip(lines, places, strict=True)]
    if not places and beyond(outcome.after, outcome.floor):
        white = outcome.after.white[OVERALL] / outcome.floor.white[OVERALL]
        left = off_words(outcome) or f"a gap of {white:.1f} times the noise"
        lines.append(f"left in the held-out recordings: {left}")
    return lines


def _depending(outcome: Outcome, place: Where) -> str:
    """Return what a residual depends on most, and where it is largest."""
    name, share = next(iter(place.coordinates.items()))
    where = _range(outcome.system, name, place.regions)
    return f"; {name} explains {share:.0%} of it, largest {where}"


def _row(outcome: Outcome, channel: Channel) -> str:
    gaps = (outcome.configured, outcome.before, outcome.after, outcome.floor)
    numbers = " ".join(f"{gap.units[channel.name] * channel.report_factor:9.3f}" for gap in gaps)
    width = _width(outcome.system) + 2
    return f"{_label(channel):{width}s} {numbers}  {_share(outcome, channel.name)}"


def _label(channel: Channel) -> str:
    return f"{channel.name} [{channel.report_unit}]"


def _width(system: System) -> int:
    """Return the width of the first column."""
    return max(LABEL, *(len(_label(channel)) for channel in system.channels))


def _share(outcome: Outcome, name: str) -> str:
    value = outcome.closure[name]
    mark = " *" if name in outcome.from_configured else ""
    return "-" if value is None else f"{round(100 * value, 1) + 0.0:.1f} %{mark}"


def runner_up_words(name: str, behind: float, first: str = "") -> str:
    """Return what is said of the best effect that was not chosen; `behind` is negative if it fits better.

    `first`: the effect that was chosen, if others were after it.
    """
    place = f" in place of {first}" if first else ""
    if behind >= 0:
        how = "far behind" if behind >= FAR else f"with {behind:.0f} less evidence"
        return f"next best{place}: {name}, {how}"
    return f"not accepted{place}, although it fits better: {name}, with {-behind:.0f} more evidence"


def _named(outcome: Outcome, one: Named) -> str:
    if drawn := curves(outcome, one):
        held = f"; {len(one.at_bound)} of {len(one.parameters)} coefficients at a bound" * bool(one.at_bound)
        words = f"{'; '.join(in_words(drawn))} (curves in gap.html){held}"
        return f"{one.name} ({one.equation}): {words}; evidence {one.evidence:.0f}"
    shown = dict(one.parameters)
    if len(shown) > MOST_SHOWN:  # the coefficients of a map: the most certain ones
        order = sorted(shown, key=lambda name: -_certainty(*shown[name]))
        shown = {name: shown[name] for name in order[:MOST_NAMED]}
    values = ", ".join(
        f"{name} {_with_interval(value, unit, lower, upper, ', at its bound' * (name in one.at_bound))}"
        for name, (value, unit, lower, upper) in shown.items()
    )
    more = len(one.parameters) - len(shown)
    rest = f" and {more} more coefficients (gap.json)" if more else in_all(outcome.system, one)
    return f"{one.name} ({one.equation}): {values}{rest}; evidence {one.evidence:.0f}"


def _wrong(system: System, one: Named) -> str:
    """Return what a wrong parameter is, by these recordings, and what the model has."""
    ((value, unit, lower, upper),) = one.parameters.values()
    (quantity,) = system.catalogue[one.name].parameters
    meaning = f": {quantity.meaning}" * (quantity.meaning != system.wrong[one.name])
    return (
        f"wrong parameter: {system.wrong[one.name]} is {_with_interval(value, unit, lower, upper)}, the model"
        f" has {system.nominal_of(one.name):.4g}{meaning}; evidence {one.evidence:.0f}"
    )


def _with_interval(value: float, unit: str, lower: float, upper: float, more: str = "") -> str:
    shown = digits(lower, upper, FEWEST_DIGITS)
    return f"{value:.{shown}g}{of_unit(unit)} ({interval_words(lower, upper, shown, '..')}{more})"


def _certainty(value: float, _unit: str, lower: float, upper: float) -> float:
    """Return the size of a coefficient over the width of its interval."""
    return abs(value) / max(upper - lower, 1e-300)


def _others(outcome: Outcome) -> list[str]:
    lines = []
    for one in (*outcome.effects, *outcome.surrogates):
        lines += _alike(one, len(outcome.effects) + len(outcome.surrogates) > 1)
    if not outcome.look_alikes and outcome.runner_up is not None:
        every = {one.name for one in (*outcome.effects, *outcome.surrogates)}
        first = [str(step.accepted) for step in outcome.steps if step.accepted in every][:1]
        lines.append(runner_up_words(*outcome.runner_up, *first if len(every) > 1 else ()))
    if outcome.strained:
        known = outcome.verdict in GOOD or outcome.skewed
        off = "with stamps that are off, " * outcome.skewed
        lines.append(off + _strain(outcome.system, outcome.strained, known))
    return lines


def _alike(one: Named, several: bool) -> list[str]:
    """Return what an effect is confounded with, and what would part them; nothing if it can."""
    if not one.look_alikes:
        return []
    its, others = one.name if several else "it", ", ".join(one.look_alikes)
    lines = [f"these data do not separate {its} from: {others}; {_holds(one)}"]
    if one.separated_by:
        lines += _experiment("an experiment that separates them", one.separated_by[0])
    return lines


def _holds(one: Named) -> str:
    """Return when the size of an effect holds beside those that resemble it, or what it is with them."""
    together = [
        f"with {other} ({in_short(theirs)}) it is {in_short(own)}, which explains as much"
        for other, (own, theirs) in one.both.items()
    ]
    return ", ".join(together) or "the size holds if nothing of that is there too"


def _strain(system: System, strained: Mapping[str, float], explained: bool = False) -> str:
    listed = ", ".join(f"{name} {value:+.1f}" for name, value in strained.items())
    said = f"nuisance parameters outside their tolerance (multiples of it): {listed}"
    zeros = "zeros (absolute pressure?)" if any(one.unit == "Pa" for one in system.channels) else "zeros"
    return f"{said}; check units, {zeros} and calibration first" if far(strained) and not explained else said
