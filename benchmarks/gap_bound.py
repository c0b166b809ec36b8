# SPDX-License-Identifier: Apache-2.0
"""How much evidence for a hidden effect do the recordings of a blind case hold at most?

The twin of a case has the same seeds, deviations and noise, but hides nothing. What recalibration leaves of
the case's recordings more than of its twin's, less the price of one parameter, is all the evidence that any
model could have. Below `gap.evidence.threshold` what is hidden is too small to be detected.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from pam_orthosis.discrepancy import refit
from pam_orthosis.discrepancy.beginning import begin
from pam_orthosis.discrepancy.data import Recording, from_arrays
from pam_orthosis.discrepancy.fit import Fit, fit, score
from pam_orthosis.discrepancy.problem import Problem, Scored
from pam_orthosis.discrepancy.run import Run
from pam_orthosis.progress import silent
from pam_orthosis.testing.case import Case, make_case


def evidence_at_most(case: Mapping[str, Any], tools: Mapping[str, Any]) -> float:
    """Return the evidence that the search could find at most for what a single case hides."""
    drawn, class_, size = case["effects"], case["class"], case["size"]
    outside, parameters = case["outside"], tools["parameters"]
    made, twin = (make_case(case["seed"], class_, size, drawn, outside, alone) for alone in (None, ""))
    start = begin(tools["system"], *_recordings(made, tools), parameters.gap, replay=tools["replay"])
    cutoff = parameters.gap.replay.cross_cutoff
    runs = [Run(start.system, one, cutoff) for one in _recordings(twin, tools)[0]]
    known = start.problem.scored
    bare = Problem(start.problem.replay, [
        Scored(run, one.whiten, one.warm_up) for run, one in zip(runs, known, strict=True)
    ])  # fmt: skip
    _, none = refit.recalibrated(bare, silent)
    plain = Problem(start.problem.replay, known)
    excess = _score(plain, start.null) - _score(bare, none)
    return float(excess - math.log(start.null.samples))


def _score(plain: Problem, model: Fit) -> float:
    """Return the score of a model that is refitted with all samples at their full weight."""
    return float(score(plain, fit(plain, model.effects, model.values, model.free)))


def _recordings(made: Case, tools: Mapping[str, Any]) -> list[list[Recording]]:
    return [
        [from_arrays(name, tools["system"], arrays) for name, arrays in group.items()]
        for group in (made.training, made.held_out)
    ]
