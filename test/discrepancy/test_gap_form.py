# SPDX-License-Identifier: Apache-2.0
"""A small effect beside a large one: seen whatever the large one's form is, or not accepted."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pam_orthosis.discrepancy.fitting import refit
from pam_orthosis.discrepancy.fitting.candidates import Trial, penalty, secant_gain
from pam_orthosis.discrepancy.fitting.fit import fit_tempered
from pam_orthosis.discrepancy.fitting.free import free_parameters
from pam_orthosis.discrepancy.fitting.projection import Projection
from pam_orthosis.discrepancy.preparation import beginning
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.search import form, second_chance
from pam_orthosis.model.parameters import load
from pam_orthosis.progress import silent

HIDDEN = "extensor_pressure_offset"
COMPANIONS = ("angle_offset", "leg_shank_mass")
LARGE = ("joint_friction",)
THRESHOLD = load().gap.evidence.threshold


@pytest.fixture(scope="module")
def rubbing(diagnostics):
    """What hides bristles and a sensor's zero; the model has Coulomb's friction with its details."""
    system, training, held_out = diagnostics(53198340029, effects=[*LARGE, HIDDEN])
    replay, free = Replay(system), free_parameters(system, LARGE)
    problem, _, _ = beginning.prepared(replay, [training], [held_out], load().gap)
    weighted, plain = fit_tempered(problem, LARGE, replay.defaults(LARGE), free)
    return refit.at_best_level(*refit.with_details(weighted, plain, plain, silent))


def plainly(problem, model, names):
    projection = Projection(problem, model)
    trials = [Trial(projection, name) for name in names]
    gains = [max(secant_gain(projection, trial, start) for start in trial.starts()) for trial in trials]
    return [gain - penalty(model, len(trial.free)) for gain, trial in zip(gains, trials, strict=True)]


def test_what_a_form_leaves_over_is_gone_with_the_form_free_and_what_is_there_stays(rubbing):
    seen = form.evidence(*rubbing, [HIDDEN, *COMPANIONS], LARGE)
    assert min(plainly(*rubbing, COMPANIONS)) > THRESHOLD, "else they would tempt nobody"
    assert max(seen[name] for name in COMPANIONS) < THRESHOLD / 2
    assert seen[HIDDEN] > second_chance.IN_ANY_FORM.sure * THRESHOLD


def test_nothing_is_known_beside_what_changes_a_channel_without_a_state(rubbing):
    problem, model = rubbing
    channels = tuple(replace(one, state=None) for one in problem.system.channels)
    stateless = SimpleNamespace(
        system=replace(problem.system, channels=channels), replay=problem.replay, scored=problem.scored
    )
    assert form.evidence(stateless, model, [HIDDEN], LARGE) == {}


def test_what_lags_begins_where_it_begins():
    one = SimpleNamespace(run=SimpleNamespace(period=0.002))
    does = np.concatenate([np.full(10, 3.0), np.full(1000, 5.0)])
    for late, lag in zip(form._later(does, one), form.LAGS, strict=True):
        assert late[:10] == pytest.approx(0.0)
        assert late[10:] == pytest.approx(-2.0 * (lag / (lag + 0.002)) ** np.arange(1, 1001))
