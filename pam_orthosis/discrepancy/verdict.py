# SPDX-License-Identifier: Apache-2.0
"""What the workflow found, as the contract of `gap.json`, and as words."""

from __future__ import annotations

from typing import Any

from pam_orthosis.discrepancy.measure import OVERALL
from pam_orthosis.discrepancy.workflow import Named, Outcome


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
        "where": [_place(one) for one in outcome.where],
        "left": [_place(one) for one in outcome.left],
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


def _place(one) -> dict[str, Any]:
    return {
        "equation": one.equation,
        "over_noise": _number(one.strength),
        "coordinates": {name: _number(share) for name, share in list(one.coordinates.items())[:4]},
    }


def _number(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.6g}")


def describe(outcome: Outcome) -> str:
    """Return the outcome as a few lines of text."""
    lines = [f"{'channel':20s} {'configured':>11s} {'before':>9s} {'after':>9s} {'noise':>9s}  closed"]
    for channel in outcome.system.channels:
        if channel.name in outcome.after.units:
            lines.append(_row(outcome, channel))
    overall = (outcome.configured, outcome.before, outcome.after, outcome.floor)
    numbers = " ".join(f"{gap.white[OVERALL]:9.2f}" for gap in overall)
    lines.append(f"{'times the noise':20s}   {numbers}  {_share(outcome.closure[OVERALL])}")
    worst = outcome.where[0]
    if outcome.verdict != "none":
        seen = ", ".join(f"{name} {share:.0%}" for name, share in list(worst.coordinates.items())[:3])
        lines.append(f"gap: {worst.equation} equation; residual explained by {seen}")
    lines += [_told(one) for one in outcome.effects]
    lines += [f"best surrogate, no explanation: {one.name}" for one in outcome.surrogates]
    lines += _others(outcome)
    lines += [f"remark: {remark}" for remark in outcome.remarks]
    lines.append(_answer(outcome))
    return "\n".join(lines)


def _row(outcome: Outcome, channel) -> str:
    gaps = (outcome.configured, outcome.before, outcome.after, outcome.floor)
    numbers = " ".join(f"{gap.units[channel.name] * channel.report_factor:9.3f}" for gap in gaps)
    label = f"{channel.name} [{channel.report_unit}]"
    return f"{label:22s} {numbers}  {_share(outcome.closure[channel.name])}"


def _share(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.1f} %"


def _told(one: Named) -> str:
    values = ", ".join(
        f"{name} {value:.4g} {unit} ({lower:.4g} .. {upper:.4g})"
        for name, (value, unit, lower, upper) in one.parameters.items()
    )
    return f"effect: {one.name} ({one.equation}): {values}; evidence {one.evidence:.0f}"


def _others(outcome: Outcome) -> list[str]:
    lines = []
    if outcome.look_alikes:
        lines.append(f"these data cannot tell it from: {', '.join(outcome.look_alikes)}")
        if outcome.separated_by:
            lines.append(f"what would: pam-orthosis run --scenario {outcome.separated_by[0]}")
    elif outcome.runner_up is not None:
        lines.append(f"runner-up: {outcome.runner_up[0]}, {outcome.runner_up[1]:.0f} behind in evidence")
    if outcome.strained:
        told = ", ".join(f"{name} {value:+.1f}" for name, value in outcome.strained.items())
        lines.append(f"ordinary parameters outside their tolerance (multiples of it): {told}")
    return lines


def _answer(outcome: Outcome) -> str:
    names = " and ".join(one.name.replace("_", " ") for one in outcome.effects)
    if outcome.verdict == "none":
        return "NONE: within noise and tolerances the model is right"
    if outcome.verdict == "explained":
        return f"EXPLAINED by {names}"
    place = outcome.left[0]
    return f"UNEXPLAINED: in the {place.equation} equation {place.strength:.1f} times the noise is left" + (
        f", with {names} added" if names else "; nothing in the catalogue fits"
    )
