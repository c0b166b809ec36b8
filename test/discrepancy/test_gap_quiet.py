# SPDX-License-Identifier: Apache-2.0
"""A small effect beside a large one: seen where the large one is inactive, or not accepted."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pam_orthosis.discrepancy.fitting import candidates, refit
from pam_orthosis.discrepancy.fitting.candidates import COARSE, DIFFERENCE, Trial, candidate
from pam_orthosis.discrepancy.fitting.fit import fit_tempered
from pam_orthosis.discrepancy.fitting.free import free_parameters
from pam_orthosis.discrepancy.fitting.projection import Projection
from pam_orthosis.discrepancy.preparation import beginning
from pam_orthosis.discrepancy.replay.problem import Problem, Scored
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.search import quiet
from pam_orthosis.model.parameters import load

DELAY = {"plant__effects__valve_delay__enabled": True, "plant__effects__valve_delay__delay": 0.004}
OFFSET = {
    "plant__effects__flexor_pressure_offset__enabled": True,
    "plant__effects__flexor_pressure_offset__offset": 8.0e3,
}


def fitted(bench, effects, **plant):
    return _fitted(bench.replay, effects, bench.recording(1, **plant), bench.recording(2, **plant))


def _fitted(replay, effects, training, held_out):
    settings = load().gap
    problem, _, _ = beginning.prepared(replay, [training], [held_out], settings)
    free = free_parameters(replay.system, effects)
    return refit.at_best_level(*fit_tempered(problem, effects, replay.defaults(effects), free))


@pytest.fixture(scope="module")
def delayed(diagnostics):
    """Experiments with a delay and an offset, and the model that knows of the delay."""
    system, training, held_out = diagnostics(62626240018, effects=["flexor_pressure_offset", "valve_delay"])
    return _fitted(Replay(system), ("valve_delay",), training, held_out)


def test_a_problem_shows_the_samples_that_it_is_told_to(delayed):
    problem, model = delayed
    rows = problem.residuals(model.effects, model.values)
    shown = {name: np.arange(len(row)) % 3 == 0 for name, row in rows.items()}
    some = problem.shown(shown).weighted(problem.weights)
    names = tuple(one.name for one in model.free)
    whole = problem.blocks(model.effects, model.values, names)
    for name, block in some.blocks(model.effects, model.values, names).items():
        # of the noise: what stretches of a recording, replayed side by side, may differ by
        np.testing.assert_allclose(block.residual, rows[name][shown[name]], atol=1e-3)
        np.testing.assert_array_equal(block.slopes, whole[name].slopes[shown[name]])


def test_an_offset_shows_where_a_delay_is_silent(delayed):
    problem, model = delayed
    threshold = load().gap.evidence.threshold
    seen = quiet.evidence(problem, model, ["flexor_pressure_offset", "valve_dead_band"], {"valve_delay"})
    assert seen["flexor_pressure_offset"] > threshold
    assert seen["valve_dead_band"] < threshold


def test_a_shape_correction_in_silence_keeps_its_priors(delayed):
    """It is free already: once more, and without a prior, it would have no finite evidence."""
    problem, model = delayed
    with np.errstate(divide="raise"):
        seen = quiet.evidence(problem, model, ["force_map_misfit"], {"valve_delay"})
    assert -np.inf < seen["force_map_misfit"] < 0, "nothing is wrong with it, and its width is paid for"


def test_an_effect_that_is_never_silent_hides_what_is_small(bench):
    """Without rest nothing is seen: no evidence is better than that of a few samples."""
    problem, model = fitted(bench, ("valve_delay",), **DELAY)
    assert quiet.evidence(problem, model, ["flexor_pressure_offset"], {"valve_delay"}) == {}


def test_a_jump_of_the_model_within_a_difference_does_not_hide_an_effect(delayed, monkeypatch):
    problem, base = delayed
    projection = Projection(problem, base)
    trial = Trial(projection, "flexor_pressure_offset")
    near = [start for start in trial.starts() if abs(start[0]) < 2 * DIFFERENCE]
    between = (near[0] + np.array([0.5 * DIFFERENCE, 0.5 * COARSE])) * trial.scale[0]
    residual = problem.residual

    def jumping(equation, effects, values):
        row = residual(equation, effects, values)
        inside = between[0] < values.get("flexor_pressure_offset.offset", 0.0) < between[1]
        return row + inside * np.random.default_rng(0).standard_normal(len(row)) * 0.02

    monkeypatch.setattr(problem, "residual", jumping)
    assert candidate(projection, trial, near).gain < 10
    assert candidate(projection, trial, near, promised=60.0).gain > 30


def test_seconds_of_silence_are_those_of_each_recording(bench):
    """Recordings of one fit may have different rates."""
    slow = bench.recording(1)
    fast = replace(slow, period=slow.period / 4, name="fast")
    runs = [SimpleNamespace(recording=one, period=one.period) for one in (fast, slow)]
    problem = Problem(bench.replay, [Scored(run, None, 0) for run in runs])
    # rows lie recording by recording, channels within
    shown = {e.name: np.repeat([False, True], slow.samples * len(e.channels)) for e in bench.system.equations}
    assert quiet._seconds(problem, shown) == pytest.approx(slow.samples * slow.period)


def test_a_way_down_that_is_not_there_does_not_hide_an_effect(bench, monkeypatch):
    """What the base's fit could not gain must not be lost by a candidate: along that way there is a wall."""
    plant = {"plant__effects__flexor_leak__enabled": True, "plant__effects__flexor_leak__coefficient": 1e-10}
    problem, base = fitted(bench, (), **plant)
    block = base.blocks["gas"]
    slope = block.slopes[:, block.names.index("conductance")]
    sticking = replace(block, residual=block.residual + 0.5 * slope)
    projection = Projection(problem, replace(base, blocks={**base.blocks, "gas": sticking}))
    way = projection.levels[0].solve(projection.stuck(projection.levels[0]))
    point = candidates._point

    def walled(one, trial, own, nuisance):
        found = point(one, trial, own, nuisance)
        along = abs((nuisance - one.position) @ way) / (way @ way)
        return replace(
            found, right=found.right + one.stuck(found.level), cost=np.inf if along > 0.3 else found.cost
        )

    monkeypatch.setattr(candidates, "_point", walled)
    trial = Trial(projection, "flexor_leak")
    start = 4.0 * trial.starts()[0]
    begin = walled(projection, trial, start, projection.position)
    assert candidates.refine(projection, trial, start).cost < begin.cost - 20
