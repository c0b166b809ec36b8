# SPDX-License-Identifier: Apache-2.0
"""How much evidence for a hidden effect do the recordings of a blind case hold at most?

The case and its twin, which does not hide the effect and is the same otherwise, are recorded without noise.
What recalibration leaves of the one more than of the other, in units of the noise that the search met, less
the price of one parameter, is the evidence that any model can expect. Below `gap.evidence.threshold` what is
hidden is too small to be detected. Of pairs both hide the other effect, and the model has it.

    python benchmarks/gap_bound.py RESULTS.jsonl ... adds the bound to each single case that got no name
    python benchmarks/gap_bound.py --pairs OUT.jsonl RESULTS.jsonl ... writes that of those missed in pairs
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from gap_table import names, read

from pam_orthosis.discrepancy.fitting.candidates import widened_shape
from pam_orthosis.discrepancy.fitting.fit import Fit, fit
from pam_orthosis.discrepancy.fitting.projection import Projection
from pam_orthosis.discrepancy.fitting.refit import recalibrated, refitted
from pam_orthosis.discrepancy.preparation.beginning import prepared
from pam_orthosis.discrepancy.recordings.data import Recording, from_arrays
from pam_orthosis.discrepancy.replay.problem import Problem, Scored
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.replay.run import Run
from pam_orthosis.discrepancy.search.quiet import beside as fitted_beside
from pam_orthosis.discrepancy.search.second_chance import IN_ANY_FORM
from pam_orthosis.discrepancy.systems.knee import knee
from pam_orthosis.progress import silent
from pam_orthosis.testing import case as cases
from pam_orthosis.testing import plant

NOISELESS = {
    "ANGLE_NOISE": 0.0, "PRESSURE_NOISE": 0.0,
    "ANGLE_RESOLUTION": 1e-12, "PRESSURE_RESOLUTION": 1e-6, "VOLTAGE_RESOLUTION": 1e-9,
}  # fmt: skip
NOTHING = ""  # of what is drawn, hides
STEPS = 3


def evidence_at_most(case: Mapping[str, Any], replay: Replay, beside: str = NOTHING) -> float:
    """Return the evidence that a search can expect at most for what a case hides beside one effect."""
    settings = cases.nominal().gap
    noisy = _training(case, replay, None)
    problem, _, _ = prepared(replay, noisy, noisy[:1], settings)
    with patch.multiple(plant, **NOISELESS):
        fits = [_fitted(problem, _training(case, replay, alone), beside) for alone in (None, beside)]
    # the twin's weights: what a case leaves in the poorer model is to count in full
    weights = {name: max(one.weights[name] for one, _ in fits) for name in problem.weights}
    left = [_cost(one.weighted(weights), model) for one, model in fits]
    samples = sum(one.samples for one in problem.scored) * len(replay.system.channels)
    return float(left[0] - left[1] - math.log(samples))


def _fitted(problem: Problem, recordings: list[Recording], effect: str) -> tuple[Problem, Fit]:
    """Return recordings in the noise of others, and the recalibrated model, perhaps with an effect."""
    cutoff = cases.nominal().gap.replay.cross_cutoff
    runs = [Run(problem.system, one, cutoff) for one in recordings]
    scored = [Scored(run, one.whiten, one.warm_up) for run, one in zip(runs, problem.scored, strict=True)]
    weighted, base = recalibrated(Problem(problem.replay, scored), silent)
    if not effect:
        return weighted, base
    projection = Projection(weighted, base)
    shape = effect in problem.system.shapes
    found = widened_shape(projection, effect) if shape else fitted_beside(projection, effect)
    return refitted(weighted, base, found, silent)


def _cost(problem: Problem, model: Fit) -> float:
    """Return what a model costs after some steps at a problem's weights."""
    return fit(problem, model.effects, model.values, model.free, most=STEPS).cost


def _training(case: Mapping[str, Any], replay: Replay, alone: str | None) -> list[Recording]:
    """Return the fitted recordings of a case as `make_case` draws them; `alone` as there."""
    rng, parameters = np.random.default_rng([case["seed"], 4]), cases.nominal()
    secret = cases.draw(rng, parameters, case["class"], case["size"], case["effects"], alone=alone)
    runs = cases.trajectories(rng, parameters)
    return [
        from_arrays(name, replay.system, cases.record(parameters, secret, run, number))
        for number, (name, run) in enumerate(runs.items())
    ]


def singles(paths: Sequence[Path], replay: Replay) -> None:
    """Add the bound to single cases without a name, file by file."""
    for path in paths:
        results = read(path)
        for one in results:
            if one["set"] in ("clean", "realistic") and "found" in one and not names(one):
                one["at_most"] = round(evidence_at_most(one, replay), 1)
                print(one["set"], one["effects"], one["seed"], one["at_most"], flush=True)
        path.write_text("".join(json.dumps(one) + "\n" for one in results), encoding="utf-8")


def pairs(paths: Sequence[Path], out: Path, replay: Replay) -> None:
    """Write the bound of each effect that was missed in a pair, and what a search asks of it at least."""
    known = {(one["seed"], one["missed"]) for one in (read(out) if out.exists() else [])}
    results = [one for path in paths for one in read(path) if one["set"] == "pairs" and "found" in one]
    for one in results:
        for missed in (name for name in one["effects"] if name not in names(one)):
            if (one["seed"], missed) not in known:
                row = _of_pair(one, missed, replay)
                print(row, flush=True)
                with open(out, "a", encoding="utf-8") as stream:
                    stream.write(json.dumps(row) + "\n")


def _of_pair(one: Mapping[str, Any], missed: str, replay: Replay) -> dict[str, Any]:
    (other,) = (name for name in one["effects"] if name != missed)
    evidence = {effect["name"]: effect["evidence"] for effect in one["found"]["effects"]}
    together = replay.touched(other) & replay.touched(missed)
    settings = cases.nominal().gap.evidence
    by_chance = bool(replay.system.catalogue[other].held)  # what is left beside it may look like anything
    asked = settings.share * evidence.get(other, 0.0) if by_chance else IN_ANY_FORM.sure * settings.threshold
    return {
        "seed": one["seed"], "missed": missed, "beside": other, "named": other in evidence,
        "at_most": round(evidence_at_most(one, replay, other), 1),
        "asked": round(max(settings.threshold, asked if together else 0.0), 1),
    }  # fmt: skip


def main() -> None:
    """Bound single cases, or pairs."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("results", type=Path, nargs="+", help="of bench_gap.py")
    parser.add_argument("--pairs", type=Path, metavar="OUT", help="bound pairs, and write that here")
    arguments = parser.parse_args()
    replay = Replay(knee(cases.nominal()))
    if arguments.pairs:
        pairs(arguments.results, arguments.pairs, replay)
    else:
        singles(arguments.results, replay)


if __name__ == "__main__":
    main()
