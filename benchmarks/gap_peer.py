# SPDX-License-Identifier: Apache-2.0
"""PySINDy on the blind cases of `bench_gap.py`, with the same information; resumable, one JSON line a case.

    python benchmarks/gap_peer.py run RESULTS.jsonl --out PEER.jsonl [--limit N]
    python benchmarks/bench_gap.py table RESULTS.jsonl --peer PEER.jsonl

Needs the extra `peer` (PySINDy). It gets what the workflow gets: the recordings, the nominal model with
its nuisance parameters recalibrated within their tolerances, and the catalogue. The target is what the
equations then miss: smoothed accelerations and pressure rates, from training recordings. The library has
one column for each effect of the catalogue: what the effect at its typical size adds to the same rates
along the recording, states of its own, lags and dead times simulated (a library of functions of the
measured signals could not hold these). The periodic torque has a sine and a cosine at the strongest
frequency, a shape correction one column a coefficient. Optimiser and threshold are those that predict
the held-out recordings best; of those within one standard error, the one with the fewest effects.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from gap_table import names, outcome, read, work_off

CASE = ("set", "class", "size", "effects", "seed", "outside")
CUTOFF = 12.0  # Hz, of the zero-phase smoothing before differentiation
SAMPLE_RATE = 50.0  # Hz, to which the smooth rates are thinned
THRESHOLDS = np.geomspace(0.02, 1.0, 18)  # STLSQ, with target and columns scaled to unit rms
RIDGES = (1e-6, 1e-2)  # STLSQ, share of the number of samples
MOST_TERMS = 6  # FROLS
BLOCK = 50  # samples, whose sums of squared errors give the standard error of a score
LEAST_SCORE = 0.05  # share of the held-out variance that a model must predict to name anything


@dataclass(frozen=True)
class Regression:
    """Target (n,) and library (n, k) in multiples of the noise, names of the columns."""

    target: np.ndarray
    library: np.ndarray
    names: tuple[str, ...]

    def scores(self, coefficients: np.ndarray) -> np.ndarray:
        """Return blocks whose mean is the share of the target's variance that coefficients predict."""
        size = len(self.target) // BLOCK * BLOCK
        squares = self.target**2 - (self.target - self.library @ coefficients) ** 2
        return squares[:size].reshape(-1, BLOCK).mean(axis=1) / np.mean(self.target**2)


def solve(case: dict, tools: dict) -> dict:
    """Make a case again, regress what the model misses, and return the names beside what was hidden."""
    from pam_orthosis.discrepancy.preparation.beginning import begin
    from pam_orthosis.discrepancy.recordings.data import from_arrays
    from pam_orthosis.discrepancy.replay.replay import Replay
    from pam_orthosis.discrepancy.systems.knee import knee
    from pam_orthosis.testing.case import make_case, nominal

    if not tools:
        parameters = nominal()
        system = knee(parameters)
        tools.update(parameters=parameters, system=system, replay=Replay(system))
    made = make_case(case["seed"], case["class"], case["size"], case["effects"] or 0, case["outside"])
    training, held_out = (
        [from_arrays(name, tools["system"], arrays) for name, arrays in group.items()]
        for group in (made.training, made.held_out)
    )
    start = time.monotonic()
    begun = begin(tools["system"], training, held_out, tools["parameters"].gap, replay=tools["replay"])
    noise = begun.floor.units
    fitted = regression(begun.problem, begun.null, noise)
    found = named(fitted, regression(begun.held_out, begun.null, noise, begun.problem))
    return {**case, "answer": made.answer, "seconds": round(time.monotonic() - start, 2), "found": found}


def regression(problem, base, noise, columns_of=None) -> Regression:
    """Return the regression problem of some recordings.

    Args:
        problem: the recordings.
        base: the recalibrated model.
        noise: channel -> sd of its residual without a gap, SI.
        columns_of: the problem whose residuals give the frequency of the periodic torque (this one).
    """
    from pam_orthosis.discrepancy.fitting.candidates import Trial
    from pam_orthosis.discrepancy.fitting.projection import Projection

    projection = Projection(columns_of or problem, base)
    nothing = {one.run.serial: _residuals(problem, one, base.effects, base.values) for one in problem.scored}
    target = _rates(problem, nothing, noise)
    names, columns = _shape_columns(problem, base, noise)
    for name in problem.system.candidates:
        for number, values in enumerate(_settings(projection, Trial(projection, name))):
            column = _signature(problem, base, name, values, nothing, noise)
            if np.isfinite(column).all() and np.any(column):
                names.append(f"{name}#{number}")
                columns.append(column)
    return Regression(target, np.column_stack(columns), tuple(names))


def _shape_columns(problem, base, noise) -> tuple[list[str], list[np.ndarray]]:
    """Return a column for each coefficient of the shape corrections: they enter linearly."""
    keys = [
        f"{name}.{q.name}" for name in problem.system.shapes for q in problem.system.catalogue[name].fitted
    ]
    slopes: dict[str, dict] = {key: {one.run.serial: {} for one in problem.scored} for key in keys}
    for one in problem.scored:
        for equation in problem.system.equations:
            given = (one.run, equation, base.effects, base.values, tuple(keys))
            _, by, relevant = problem.replay.sensitivities(*given)
            for i, channel in enumerate(equation.channels):
                for key in keys:
                    place = relevant.index(key) if key in relevant else None
                    row = np.zeros(len(by)) if place is None else -by[:, i, place]
                    slopes[key][one.run.serial][channel] = row
    return [key.replace(".", "#") for key in keys], [_rates(problem, slopes[key], noise) for key in keys]


def _settings(projection, trial) -> Iterator[dict]:
    """Yield the values at which an effect's column is computed: typical ones, for a phase two."""
    effect = projection.problem.system.catalogue[trial.name]
    size = effect.fitted[0].name
    if "phase" not in {q.name for q in effect.fitted}:
        yield trial.values(trial.starts()[0])
        return
    first = {q.name: i for i, q in enumerate(effect.fitted)}
    peaks = trial.starts()[1 + len(effect.starts) :] or trial.starts()[:1]
    for phase in (0.0, 0.5 * np.pi):
        position = peaks[0].copy()
        position[first["phase"]] = phase / trial.scale[first["phase"]]
        position[first[size]] = 1.0
        yield trial.values(position)


def _signature(problem, base, name, values, nothing, noise) -> np.ndarray:
    """Return what an effect at some values adds to the rates."""
    effects = (*base.effects, name)
    with np.errstate(all="ignore"):
        changed = {
            one.run.serial: {
                key: nothing[one.run.serial][key] - row
                for key, row in _residuals(problem, one, effects, values).items()
            }
            for one in problem.scored
        }
        return _rates(problem, changed, noise)


def _residuals(problem, one, effects, values) -> dict[str, np.ndarray]:
    """Return channel -> recorded minus predicted of one run."""
    found = {}
    for equation in problem.system.equations:
        rows = problem.replay.residuals(one.run, equation, effects, values)
        found.update({channel: rows[:, i] for i, channel in enumerate(equation.channels)})
    return found


def _rates(problem, residuals, noise) -> np.ndarray:
    """Return what residuals are in rates and accelerations, thinned, in multiples of the noise."""
    from pam_orthosis.discrepancy.fitting.structure import missing_rate

    pieces = []
    for one in problem.scored:
        thin = slice(one.warm_up, None, max(1, round(1 / (SAMPLE_RATE * one.run.period))))
        for equation in problem.system.equations:
            for channel in equation.channels:
                given = (problem.system, equation, channel)
                row = missing_rate(*given, residuals[one.run.serial][channel], one.run.period, CUTOFF)
                white = noise[channel] * np.random.default_rng(0).standard_normal(len(row))
                spread = np.std(missing_rate(*given, white, one.run.period, CUTOFF))
                pieces.append(row[thin] / spread)
    return np.concatenate(pieces)


def named(training: Regression, held_out: Regression) -> dict:
    """Return the sparse model that predicts held-out rates best, in the form of `gap.json`."""
    known = [name for name in training.names if name in held_out.names]
    train, judge = (_only(one, known) for one in (training, held_out))
    scale = np.sqrt(np.mean(train.library**2, axis=0))
    size = float(np.sqrt(np.mean(train.target**2)))
    found = []
    for label, row in sparse_models(train.library / scale, train.target / size):
        order = [i for i in np.argsort(-np.abs(row)) if row[i]]
        effects = list(dict.fromkeys(known[i].split("#")[0] for i in order))
        found.append((label, effects, judge.scores(row * size / scale)))
    best = max((blocks for _, _, blocks in found), key=np.mean)
    if np.mean(best) < LEAST_SCORE:
        return _answer([], None, float(np.mean(best)), "none")
    enough = np.mean(best) - np.std(best) / np.sqrt(len(best))
    label, effects, blocks = min(
        (one for one in found if np.mean(one[2]) >= enough), key=lambda one: (len(one[1]), -np.mean(one[2]))
    )
    return _answer(effects, label, float(np.mean(blocks)), "explained" if effects else "none")


def _only(one: Regression, names) -> Regression:
    return Regression(one.target, one.library[:, [one.names.index(name) for name in names]], tuple(names))


def _answer(effects, label, score, verdict) -> dict:
    return {
        "verdict": verdict,
        "effects": [{"name": name, "parameters": {}} for name in effects],
        "look_alikes": [],
        "closure": {"overall": round(score, 4)},
        "rounds": [],
        "optimiser": label,
    }


def sparse_models(library: np.ndarray, target: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Return label and coefficients of PySINDy's sparse regressions over thresholds and numbers of terms."""
    import pysindy

    column, found = target[:, None], []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a threshold that drops every term warns
        for ridge in RIDGES:
            for threshold in THRESHOLDS:
                optimiser = pysindy.STLSQ(threshold=threshold, alpha=ridge * len(target), max_iter=20)
                row = np.ravel(optimiser.fit(library, column).coef_)
                found.append((f"STLSQ {threshold:.3g}, ridge {ridge:g}", row))
        for terms in range(1, MOST_TERMS + 1):
            optimiser = pysindy.FROLS(max_iter=terms, alpha=1e-6 * len(target))
            found.append((f"FROLS {terms}", np.ravel(optimiser.fit(library, column).coef_)))
    return [(label, row) for label, row in found if np.isfinite(row).all()]


def run(arguments) -> None:
    """Solve the cases of a results file of `bench_gap.py` that the peer's file does not hold yet."""
    known = read(arguments.out) if arguments.out.exists() else []
    done = {(r["set"], r["seed"]) for r in known}
    cases = [r for r in read(arguments.results) if (r["set"], r["seed"]) not in done]
    todo = [{key: one[key] for key in CASE} for one in cases]
    work_off(todo, arguments.limit, solve, arguments.out, _line)


def _line(result: dict) -> str:
    head = f"{result['set']} {result['size']} {result['effects']} ->"
    if "failed" in result:
        return f"{head} FAILED {result['failed']}"
    found = result["found"]
    return (
        f"{head} {outcome(result)} {names(result)} score {found['closure']['overall']}"
        f" by {found['optimiser']}, {result['seconds']} s"
    )


def main() -> None:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    running = verbs.add_parser("run", help="solve cases that are not in the peer's file")
    running.add_argument("results", type=Path, help="of bench_gap.py: says which cases")
    running.add_argument("--out", type=Path, required=True)
    running.add_argument("--limit", type=int)
    run(parser.parse_args())


if __name__ == "__main__":
    main()
