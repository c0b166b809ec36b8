# SPDX-License-Identifier: Apache-2.0
"""What the workflow found, as the contract of `gap.json`."""

from collections.abc import Mapping, Sequence
from typing import Any

from pam_orthosis.discrepancy.answer.judgement import Outcome
from pam_orthosis.discrepancy.answer.patch import DESCRIBED
from pam_orthosis.discrepancy.answer.unknown_words import unknown_as_dict
from pam_orthosis.discrepancy.fitting.measure import OVERALL, Gap, over_noise
from pam_orthosis.discrepancy.fitting.structure import Where
from pam_orthosis.discrepancy.preparation.identifiability import Identifiability
from pam_orthosis.discrepancy.search.findings import Named


def as_dict(outcome: Outcome) -> dict[str, Any]:
    """Return the outcome as JSON-ready values, SI units."""
    return {
        "verdict": outcome.verdict,
        "system": outcome.system.name,
        "effects": [_effect(one, outcome.system.wrong) for one in outcome.effects],
        "surrogates": [_effect(one, outcome.system.wrong) for one in outcome.surrogates],
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
        "unknown": unknown_as_dict(outcome.system, outcome.unknown, outcome.verdict == DESCRIBED),
        "another_machine": outcome.foreign,
        "empty_of_meaning": list(outcome.empty),
        "out_of_tolerance": {name: _number(value) for name, value in outcome.strained.items()},
        "rounds": [
            {"accepted": step.accepted, "reason": step.reason, "held_out_t": _number(step.held_out_t),
             "ranking": [[name, _number(evidence)] for name, evidence in step.ranked]}
            for step in outcome.steps
        ],
        "remarks": list(outcome.remarks),
    }  # fmt: skip


def _effect(one: Named, wrong: Mapping[str, str]) -> dict[str, Any]:
    parameters = {
        name: {"value": _number(value), "unit": unit, "interval": [_number(lower), _number(upper)],
               "at_bound": name in one.at_bound}
        for name, (value, unit, lower, upper) in one.parameters.items()
    }  # fmt: skip
    return {
        "name": one.name,
        "wrong_parameter": wrong.get(one.name),
        "equation": one.equation,
        "parameters": parameters,
        "evidence": _number(one.evidence),
        "look_alikes": list(one.look_alikes),
        "with_both": {
            other: [{"value": _number(value), "unit": unit} for value, unit in sizes]
            for other, sizes in one.both.items()
        },
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
    largest = list(one.coordinates.items())[:4]
    return {
        "equation": one.equation,
        "over_noise": _number(kept),
        "density": _number(one.density),
        "coordinates": {name: _number(share) for name, share in largest},
        "largest_where": {name: [_number(end) for end in one.regions[name]] for name, _ in largest},
    }


def identifiability_as_dict(data: Identifiability) -> dict[str, Any]:
    """Return what the recordings can identify as JSON-ready values."""
    return {
        "expected_evidence": {name: _number(value) for name, value in data.evidence.items()},
        "invisible": list(data.invisible),
        "alike": [[a, b, _number(cosine)] for a, b, cosine in data.alike],
        "experiments": list(data.experiments),
        "together": list(data.together),
        "hidden": list(data.hidden),
        "missing": list(data.missing),
        "astray": {one.name: list(one.equations) for one in data.astray},
    }


def _number(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.6g}")
