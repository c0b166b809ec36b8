# SPDX-License-Identifier: Apache-2.0
"""Parameters of the apparatus that are wrong are candidates: the search names them with their values."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.discrepancy import workflow
from pam_orthosis.discrepancy.answer import patch
from pam_orthosis.discrepancy.answer.contract import as_dict
from pam_orthosis.discrepancy.answer.verdict import describe
from pam_orthosis.discrepancy.fitting import refit
from pam_orthosis.discrepancy.fitting.candidates import Candidate
from pam_orthosis.discrepancy.preparation import beginning
from pam_orthosis.discrepancy.recordings.data import from_arrays
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.replay.run import Run
from pam_orthosis.discrepancy.search import screening
from pam_orthosis.discrepancy.search.screening import fitted_candidates, is_far
from pam_orthosis.discrepancy.systems.knee import SUSPECTS, knee
from pam_orthosis.discrepancy.systems.suspects import MASSES, OF_MASSES, name_of
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import load
from pam_orthosis.model.plant import Plant
from pam_orthosis.progress import silent

DIAMETER = "leg.cogwheel_diameter"


@pytest.mark.parametrize(
    ("key", "factor", "equation"),
    [
        (DIAMETER, 1.2, 0),
        ("leg.thigh.length", 1.1, 0),
        ("leg.knee_mass", 1.7, 0),
        ("valve.conductance", 0.7, 1),
        (MASSES, 2.0, 0),
    ],
)
def test_a_candidate_is_the_model_with_that_parameter(bench, key, factor, equation):
    nominal = bench.parameters.flat()
    value = factor * nominal.get(key, 1.0)
    changed = patch.overrides(bench.system, [name_of(key)], {f"{name_of(key)}.value": value})
    assert changed == {one: pytest.approx(factor * nominal[one]) for one in OF_MASSES.get(key, (key,))}
    right = knee(bench.parameters.changed(changed))
    run, name = Run(bench.system, bench.recording(1), 40.0), name_of(key)
    values = {**bench.replay.defaults((name,)), f"{name}.value": value}
    one = bench.replay.residuals(run, bench.system.equations[equation], (name,), values)
    replay = Replay(right)
    other = replay.residuals(run, right.equations[equation], (), replay.defaults(()))
    usual = bench.replay.residuals(run, bench.system.equations[equation], (), bench.replay.defaults(()))
    assert np.std(one - other) < 1e-3 * np.std(usual - other)


def test_every_suspect_changes_an_equation(bench):
    assert set(bench.system.wrong) == {name_of(key) for key in SUSPECTS}
    assert all(bench.replay.touched(name) for name in bench.system.wrong)


def test_a_wrong_sprocket_is_named_with_its_size(bench):
    """Beside the shape corrections, which may not take what is another sprocket's."""
    wrong = bench.parameters.changed({DIAMETER: 0.12})

    def recording(seed, cycle):
        changed = {"scenario.cycle_time": cycle}
        plant = Plant(wrong.changed(changed), seed)
        loop = ClosedLoop(bench.parameters.changed(changed), seed, plant=plant)
        return from_arrays(f"run {seed}", bench.system, loop.run(7000))

    names = (*bench.system.shapes, "parallel_elasticity", *bench.system.wrong)
    few = replace(bench.system, catalogue={name: bench.system.catalogue[name] for name in names})
    training = [recording(1, 2.0), recording(2, 1.4)]
    outcome = workflow.find_gap(few, training, [recording(3, 1.7)], bench.parameters.gap)
    (one,) = outcome.effects
    assert outcome.verdict == "explained"
    assert one.parameters["value"][0] == pytest.approx(0.12, rel=0.02)
    reported = as_dict(outcome)["effects"][0]
    assert reported["wrong_parameter"] == DIAMETER
    lines = describe(outcome).splitlines()
    assert lines[-1] == f"EXPLAINED by a wrong {DIAMETER}"
    assert any(line.startswith(f"wrong parameter: {DIAMETER} is 0.1") for line in lines)
    assert any("the model has 0.1: effective diameter" in line for line in lines)
    changed = patch.overrides(few, [one.name], outcome.selection.final.values)
    assert changed == {DIAMETER: pytest.approx(0.12, rel=0.02)}


HEIGHT = "leg.bearing_height"


@pytest.mark.parametrize(("height", "rivals"), [(0.1, {name_of(HEIGHT)}), (0.0, set())])
def test_a_wrong_parameter_is_the_rival_of_an_effect_that_resembles_it(bench, height, rivals):
    """Where the model is not far off, none is suspected; a mass at the foot is much like a bearing."""
    wrong = bench.parameters.changed({HEIGHT: height})
    loop = ClosedLoop(bench.parameters, 1, plant=Plant(wrong, 1))
    recording = from_arrays("run", bench.system, loop.run(7000))
    names = (*bench.system.shapes, "extra_foot_mass", name_of(HEIGHT))
    few = replace(bench.system, catalogue={name: bench.system.catalogue[name] for name in names})
    settings = bench.parameters.gap
    prepared, *_ = beginning.prepared(Replay(few), [recording], [bench.recording(2)], settings)
    problem, base = refit.recalibrated(prepared, silent)
    thresholds = dict.fromkeys(names, settings.evidence.threshold)
    found, _ = fitted_candidates(problem, base, settings.evidence.screened, thresholds, silent)
    assert not is_far(problem)
    assert {one.name for one in found} & set(few.wrong) == rivals
    assert not rivals or max(found, key=lambda one: one.gain).name in rivals


BENT = {  # name -> gain that a score test promises, and that the fit finds
    "bends": (100.0, 2.0), "bends too": (90.0, -9.0), "is there": (50.0, 400.0), "helps": (45.0, 10.0),
    "rival": (26.0, 300.0), "less": (24.0, 20.0),
}  # fmt: skip
STRAIGHT = {"is there": (100.0, 90.0), "bends": (80.0, 2.0), "rival": (51.0, 60.0), "less": (49.0, 40.0)}


@pytest.mark.parametrize(("gains", "strained"), [(BENT, set()), (BENT, {"less"}), (STRAIGHT, set())])
def test_an_effect_whose_promise_comes_to_nothing_takes_no_place_of_another(monkeypatch, gains, strained):
    """Two places: fits go on while promises come to nothing, then to what promised half of the best one."""

    def fitted(_, one):
        return Candidate(one[1], gains[one[1]][1], {}, 0.0, {}, (one[1],))

    workers = SimpleNamespace(forked=lambda act, ones, *_: [act(one) for one in ones])
    look = object.__new__(screening._Look)
    look.strained, look._most, look._progress = strained, 2, silent
    look._problem = SimpleNamespace(replay=SimpleNamespace(workers=workers))
    monkeypatch.setattr(screening._Look, "_fitted", fitted)
    found = look._fitted_in_order([(promised, name, []) for name, (promised, _) in gains.items()])
    assert {one.name for one in found} == set(gains) - ({"less"} - strained)


def test_a_wrong_valve_is_named_although_recalibration_hides_it(bench):
    """The share of the little gap that recalibration leaves says nothing of it."""
    size = "valve.conductance"
    right = 0.7 * bench.parameters.flat()[size]

    def recording(seed, cycle):
        return bench.recording(seed, cycle, valve__conductance=right, plant__deviation__conductance=1.0)

    few = replace(
        bench.system, catalogue={n: bench.system.catalogue[n] for n in (name_of(size), "valve_lag")}
    )
    outcome = workflow.find_gap(few, [recording(1, 2.0)], [recording(3, 1.7)], bench.parameters.gap)
    (one,) = outcome.effects
    assert outcome.verdict == "recalibrated"
    assert one.parameters["value"][0] == pytest.approx(right, rel=0.03)
    assert "overall" in outcome.from_configured
    assert outcome.closure["overall"] > 0.95


def test_a_model_with_a_low_supply_can_be_run():
    """What was found goes into `run --model`: the highest reference pressure is below the supply there."""
    found = {"valve.supply_pressure": 5.6e5}
    with pytest.raises(OrthosisError, match="maximum_pressure"):
        load(found)
    limits = patch.limits(load(), found)
    assert limits == {"control.position.maximum_pressure": pytest.approx(0.97 * 5.6e5)}
    assert load(found | limits)
    assert not patch.limits(load(), {"valve.supply_pressure": 8e5})
    assert not patch.limits(load(), {"valve.hose.volume": 4e-5})
