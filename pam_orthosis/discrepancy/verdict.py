# SPDX-License-Identifier: Apache-2.0
"""What the workflow found, as the contract of `gap.json`, and as words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pam_orthosis.discrepancy.beginning import Beginning
from pam_orthosis.discrepancy.findings import Named
from pam_orthosis.discrepancy.judgement import Outcome, beyond
from pam_orthosis.discrepancy.measure import OVERALL, Gap, over_noise
from pam_orthosis.discrepancy.structure import Where, clean
from pam_orthosis.discrepancy.system import Channel, System
from pam_orthosis.discrepancy.telling import Telling
from pam_orthosis.model.parameters import Parameters, experiments, scenario_names

LABEL = 25  # characters of the first column, at least
MOST_NAMED = 3  # parameters in one line
FAR_STRAIN = 5.0  # tolerances: less likely hardware than a wrong zero or unit


def as_dict(outcome: Outcome) -> dict[str, Any]:
    """Return the outcome as JSON-ready values, SI units."""
    return {
        "verdict": outcome.verdict,
        "system": outcome.system.name,
        "effects": [_effect(one) for one in outcome.effects],
        "surrogates": [_effect(one) for one in outcome.surrogates],
        "look_alikes": list(outcome.look_alikes),
        "separated_by": list(outcome.separated_by),
        "runner_up": None
        if outcome.runner_up is None
        else {"name": outcome.runner_up[0], "behind": _number(outcome.runner_up[1])},
        "gap_configured": _gap(outcome, "configured"),
        "gap_before": _gap(outcome, "before"),
        "gap_after": _gap(outcome, "after"),
        "noise_floor": _gap(outcome, "floor"),
        "closure": {name: _number(value) for name, value in outcome.closure.items()},
        "closure_baseline": {
            name: "configured" if name in outcome.from_configured else "before" for name in outcome.closure
        },
        "where": _places(outcome, outcome.where, outcome.before),
        "left": _places(outcome, outcome.left, outcome.after),
        "empty_of_meaning": list(outcome.empty),
        "out_of_tolerance": {name: _number(value) for name, value in outcome.strained.items()},
        "rounds": [
            {"accepted": step.accepted, "reason": step.reason, "held_out_t": _number(step.held_out_t),
             "ranking": [[name, _number(evidence)] for name, evidence in step.ranked]}
            for step in outcome.steps
        ],
        "remarks": list(outcome.remarks),
    }  # fmt: skip


def _effect(one: Named) -> dict[str, Any]:
    parameters = {
        name: {"value": _number(value), "unit": unit, "interval": [_number(lower), _number(upper)]}
        for name, (value, unit, lower, upper) in one.parameters.items()
    }
    return {
        "name": one.name,
        "equation": one.equation,
        "parameters": parameters,
        "evidence": _number(one.evidence),
        "look_alikes": list(one.look_alikes),
        "separated_by": list(one.separated_by),
    }


def _gap(outcome: Outcome, which: str) -> dict[str, Any]:
    gap = getattr(outcome, which)
    units = {
        name: {
            "value": _number(value),
            "unit": outcome.system.channel(name).unit,
            "white": _number(gap.white[name]),
        }
        for name, value in gap.units.items()
    }
    return {**units, OVERALL: {"value": _number(gap.white[OVERALL]), "unit": "times the noise"}}


def _places(outcome: Outcome, places: Sequence[Where], gap: Gap) -> list[dict[str, Any]]:
    kept = over_noise(outcome.system, gap, outcome.floor)
    return [_place(one, kept[one.equation]) for one in places]


def _place(one: Where, kept: float) -> dict[str, Any]:
    told = list(one.coordinates.items())[:4]
    return {
        "equation": one.equation,
        "over_noise": _number(kept),
        "density": _number(one.density),
        "coordinates": {name: _number(share) for name, share in told},
        "largest_where": {name: [_number(end) for end in one.regions[name]] for name, _ in told},
    }


def told_as_dict(told: Telling) -> dict[str, Any]:
    """Return what the recordings can tell as JSON-ready values."""
    return {
        "expected_evidence": {name: _number(value) for name, value in told.evidence.items()},
        "invisible": list(told.invisible),
        "alike": [[a, b, _number(cosine)] for a, b, cosine in told.alike],
        "experiments": list(told.experiments),
    }


def assumed_words(files: Sequence[Path], count: int, model: Path | None) -> str:
    """Return the line on files, of `count` recordings, that do not tell their apparatus; empty if all do."""
    if not files:
        return ""
    more = f" and {len(files) - 1} more" if len(files) > 1 else ""
    taken = "the default knee" if len(files) == count else "the apparatus of the other recordings"
    changed = f" with what {model} changes" if model else ""
    told = f"{files[0]}{more} without a record of parameters, read as {taken}{changed}"
    return f"the apparatus is assumed: {told}\n"


def untold_words(rows: Mapping[str, Any], parameters: Parameters) -> str:
    """Return the line on rows of the apparatus that a record lacks, with the values taken; empty if none."""
    if not rows:
        return ""
    first = [f"{key} = {rows[key]} {parameters.row(key).unit}" for key in list(rows)[:MOST_NAMED]]
    more = f" and {len(rows) - len(first)} more" if len(rows) > len(first) else ""
    taken = f"{', '.join(first)}{more}; give what is right with --model"
    return f"recorded by a version without these parameters; taken: {taken}\n"


def describe_data(told: Telling) -> str:
    """Return in a few lines what the recordings can tell."""
    lines = []
    if told.invisible:
        lines.append(f"these data would not show, at typical size: {', '.join(told.invisible)}")
    for a, b, cosine in told.alike:
        lines.append(f"confounded in these data: {a} and {b} (cosine of their sensitivities {cosine:.2f})")
    if told.experiments:
        lines += _experiment("most useful next experiment", told.experiments[0])
    return "\n".join(lines) or "these data show and separate all effects of the catalogue"


def _experiment(purpose: str, scenario: str) -> list[str]:
    """Return how an experiment is done on an apparatus, and what emulates it, if anything does."""
    if scenario not in scenario_names():
        return [f"{purpose}: {scenario}"]
    emulated = f"pam-orthosis run --scenario {scenario}"
    known = experiments()
    if scenario not in known:
        return [f"{purpose}: {emulated}"]
    return [f"{purpose}: {known[scenario]}", f"  emulated by: {emulated}"]


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
        lines.append(_strain(strained))
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
    unit = "of the cycle" if name == "phase" else system.unit(name) or "(SI)"
    factor, unit = (1.0, unit) if channel is None else (channel.report_factor, channel.report_unit)
    low, high = (factor * end for end in regions[name])
    return f"between {low:.4g} and {high:.4g} {unit}"


def _number(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.6g}")


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
    worst = outcome.where[0]
    if outcome.verdict != "none":
        seen = ", ".join(f"{name} {share:.0%}" for name, share in list(worst.coordinates.items())[:3])
        lines.append(f"gap: {worst.equation} equation; residual explained by {seen}")
    lines += [_told(one) for one in outcome.effects]
    lines += [f"best surrogate, no explanation: {one.name}" for one in outcome.surrogates]
    lines += _others(outcome)
    lines += [f"remark: {remark}" for remark in outcome.remarks]
    lines += _left(outcome)
    lines.append(_answer(outcome))
    return "\n".join(lines)


def _left(outcome: Outcome) -> list[str]:
    """Return what is left although the gap is explained."""
    if outcome.verdict != "explained":
        return []
    kept = over_noise(outcome.system, outcome.after, outcome.floor)
    places = [one.equation for one in outcome.left if not one.clean]
    lines = [f"left in the {name} equation: {kept[name]:.1f} times the noise" for name in places]
    if not places and beyond(outcome.after, outcome.floor):
        white = outcome.after.white[OVERALL] / outcome.floor.white[OVERALL]
        lines.append(f"left in the held-out recordings: a gap of {white:.1f} times the noise")
    return lines


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
    return "-" if value is None else f"{100 * value:.1f} %{mark}"


def _told(one: Named) -> str:
    values = ", ".join(
        f"{name} {value:.4g} {unit} ({lower:.4g} .. {upper:.4g})"
        for name, (value, unit, lower, upper) in one.parameters.items()
    )
    return f"effect: {one.name} ({one.equation}): {values}; evidence {one.evidence:.0f}"


def _others(outcome: Outcome) -> list[str]:
    lines = []
    for one in (*outcome.effects, *outcome.surrogates):
        lines += _alike(one, len(outcome.effects) + len(outcome.surrogates) > 1)
    if not outcome.look_alikes and outcome.runner_up is not None:
        lines.append(f"runner-up: {outcome.runner_up[0]}, {outcome.runner_up[1]:.0f} behind in evidence")
    if outcome.strained:
        lines.append(_strain(outcome.strained))
    return lines


def _alike(one: Named, several: bool) -> list[str]:
    """Return what an effect cannot be told from, and what would part them; nothing if it can."""
    if not one.look_alikes:
        return []
    lines = [f"these data do not separate {one.name if several else 'it'} from: {', '.join(one.look_alikes)}"]
    if one.separated_by:
        lines += _experiment("an experiment that separates them", one.separated_by[0])
    return lines


def _strain(strained: Mapping[str, float]) -> str:
    told = ", ".join(f"{name} {value:+.1f}" for name, value in strained.items())
    said = f"nuisance parameters outside their tolerance (multiples of it): {told}"
    far = max(map(abs, strained.values())) > FAR_STRAIN
    return f"{said}; check units, zeros (absolute pressure?) and calibration first" if far else said


def _refusal(outcome: Outcome) -> str:
    """Return why no effect was added: the reason of the first round, if there was a candidate."""
    step = outcome.steps[0] if outcome.steps else None
    if step is None or step.accepted is not None or not step.ranked:
        return "nothing in the catalogue fits"
    return f"no effect is added (best: {step.ranked[0][0]}): {step.reason}"


def _answer(outcome: Outcome) -> str:
    names = " and ".join(one.name.replace("_", " ") for one in outcome.effects)
    if outcome.verdict == "none":
        return "NONE: recalibrated within its tolerances, the model leaves noise only"
    if outcome.verdict == "explained":
        return f"EXPLAINED by {names}"
    if clean(outcome.left) and beyond(outcome.after, outcome.floor):
        return (
            "UNEXPLAINED: the held-out recordings leave what was fitted (the gap is"
            f" {outcome.after.white[OVERALL]:.1f} times the noise, and no fit knows better there); fit"
            " recordings that reach as far" + (f"; {names} added{_emptied(outcome)}" if names else "")
        )
    kept = over_noise(outcome.system, outcome.after, outcome.floor)
    worst = max(kept, key=lambda name: kept[name])
    left = f"UNEXPLAINED: in the {worst} equation {kept[worst]:.1f} times the noise is left"
    if outcome.surrogates:
        return f"{left}; no model of the catalogue explains half of the gap"
    return left + (f", with {names} added{_emptied(outcome)}" if names else f"; {_refusal(outcome)}")


def _emptied(outcome: Outcome) -> str:
    """Return which parameters make named effects something else than their names say, if any does."""
    if not outcome.empty:
        return ""
    values = outcome.selection.final.values
    told = ", ".join(f"{key} = {values[key]:.4g}" for key in outcome.empty[:MOST_NAMED])
    more = len(outcome.empty) - MOST_NAMED
    return f", not what the name says: {told}" + (f" and {more} more" if more > 0 else "")
