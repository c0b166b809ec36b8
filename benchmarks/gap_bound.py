# SPDX-License-Identifier: Apache-2.0
"""How much evidence for a hidden effect do the recordings of a blind case hold at most?

The case and its twin, which hides nothing and is the same otherwise, are recorded without noise. What
recalibration leaves of the one more than of the other, in units of the noise that the search met, less the
price of one parameter, is the evidence that any model can expect. Below `gap.evidence.threshold` what is
hidden is too small to be detected.

    python benchmarks/gap_bound.py RESULTS.jsonl ... adds the bound to each single case that got no name
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from gap_table import names, read

from pam_orthosis.discrepancy.beginning import prepared
from pam_orthosis.discrepancy.data import Recording, from_arrays
from pam_orthosis.discrepancy.knee import knee
from pam_orthosis.discrepancy.problem import Problem, Scored
from pam_orthosis.discrepancy.refit import recalibrated
from pam_orthosis.discrepancy.replay import Replay
from pam_orthosis.discrepancy.run import Run
from pam_orthosis.progress import silent
from pam_orthosis.testing import case as cases
from pam_orthosis.testing import plant

NOISELESS = {
    "ANGLE_NOISE": 0.0, "PRESSURE_NOISE": 0.0,
    "ANGLE_RESOLUTION": 1e-12, "PRESSURE_RESOLUTION": 1e-6, "VOLTAGE_RESOLUTION": 1e-9,
}  # fmt: skip
NOTHING = ""  # of what is drawn, hides


def evidence_at_most(case: Mapping[str, Any], replay: Replay) -> float:
    """Return the evidence that a search can expect at most for what a case with one effect hides."""
    settings = cases.nominal().gap
    noisy = _training(case, replay, None)
    problem, _, _ = prepared(replay, noisy, noisy[:1], settings)
    with patch.multiple(plant, **NOISELESS):
        left = [_left(problem, _training(case, replay, alone)) for alone in (None, NOTHING)]
    samples = sum(one.samples for one in problem.scored) * len(replay.system.channels)
    return float(left[0] - left[1] - math.log(samples))


def _left(problem: Problem, recordings: list[Recording]) -> float:
    """Return the cost that recalibration leaves of recordings, in the noise of others."""
    cutoff = cases.nominal().gap.replay.cross_cutoff
    runs = [Run(problem.system, one, cutoff) for one in recordings]
    scored = [Scored(run, one.whiten, one.warm_up) for run, one in zip(runs, problem.scored, strict=True)]
    return recalibrated(Problem(problem.replay, scored), silent)[1].cost


def _training(case: Mapping[str, Any], replay: Replay, alone: str | None) -> list[Recording]:
    """Return the fitted recordings of a case as `make_case` draws them; `alone` as there."""
    rng, parameters = np.random.default_rng([case["seed"], 4]), cases.nominal()
    secret = cases.draw(rng, parameters, case["class"], case["size"], case["effects"], alone=alone)
    runs = cases.trajectories(rng, parameters)
    return [
        from_arrays(name, replay.system, cases.record(parameters, secret, run, number))
        for number, (name, run) in enumerate(runs.items())
    ]


def main() -> None:
    """Add the bound to single cases without a name, file by file."""
    replay = Replay(knee(cases.nominal()))
    for path in map(Path, sys.argv[1:]):
        results = read(path)
        for one in results:
            if one["set"] in ("clean", "realistic") and "found" in one and not names(one):
                one["at_most"] = round(evidence_at_most(one, replay), 1)
                print(one["set"], one["effects"], one["seed"], one["at_most"], flush=True)
        path.write_text("".join(json.dumps(one) + "\n" for one in results), encoding="utf-8")


if __name__ == "__main__":
    main()
