# SPDX-License-Identifier: Apache-2.0
"""What is tried together, taken in one round, or in place of something else."""

from collections import defaultdict
from types import SimpleNamespace

import numpy as np
import pytest

from pam_orthosis.discrepancy.answer import judgement
from pam_orthosis.discrepancy.answer.judgement import WIDE
from pam_orthosis.discrepancy.fitting.candidates import Candidate, Trial
from pam_orthosis.discrepancy.fitting.free import nuisance, with_scales
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.search import confirmation, elimination, screening, second_chance, select
from pam_orthosis.discrepancy.systems.knee import knee
from pam_orthosis.model.parameters import load

KNOWN_LATE = {"valve.delay": 9.9e-3}


def system_of(**changed):
    return knee(load({"valve.dead_band": 0.0, **changed}))


def trial_of(system, effects=(), name="valve_lag"):
    problem = SimpleNamespace(system=system, replay=Replay(system))
    return Trial(SimpleNamespace(problem=problem, base=SimpleNamespace(effects=effects, values={})), name)


def test_a_nominal_dead_time_may_stand_for_a_lag_and_moves_with_it():
    late = system_of(**KNOWN_LATE)
    trial = trial_of(late)
    assert trial.added == ("valve_delay", "valve_lag")
    for start in trial.starts():
        delay, frequency = start * trial.scale
        assert delay == pytest.approx(-0.8 / (np.pi * frequency))
    assert trial_of(late, ("valve_delay",)).added == ("valve_lag",)
    assert trial_of(system_of(**{"valve.delay": 0.0})).added == ("valve_lag",)


def test_where_the_dead_time_is_free_the_sensors_of_both_muscles_are_late_together():
    system = system_of(**KNOWN_LATE)
    trial = trial_of(system, ("valve_delay",), "flexor_pressure_delay")
    assert trial.added == ("extensor_pressure_delay", "flexor_pressure_delay")
    assert all(np.ptp(start) == 0.0 for start in trial.starts())
    for known in ((), ("extensor_pressure_delay", "valve_delay")):
        assert trial_of(system, known, "flexor_pressure_delay").added == ("flexor_pressure_delay",)
    assert trial_of(system, ("valve_delay",), "angle_delay").added == ("angle_delay",)


def test_the_level_of_a_shape_that_has_a_name_is_no_other(monkeypatch):
    system, asked = system_of(), []

    def touching(names, progress):
        asked.append(set(names))
        return []

    def several(*_):
        return []

    replay = SimpleNamespace(touching=touching, touched=lambda _: (), workers=SimpleNamespace(forked=several))
    problem = SimpleNamespace(system=system, replay=replay, weights={"gas": 1.0})
    monkeypatch.setattr(screening, "Projection", lambda *_: None)
    monkeypatch.setattr(screening, "widened_shape", lambda *_: candidate("volume_misfit"))
    monkeypatch.setattr(screening, "is_far", lambda *_: True)
    for effects in ((), ("valve_curve_misfit",)):
        base = SimpleNamespace(effects=effects, free=(), values=defaultdict(float))
        screening.fitted_candidates(problem, base, 8, {}, print)
    levels = {"extensor_valve_gain", "flexor_valve_gain", "valve_conductance"}
    assert asked[0] - asked[1] == levels


def candidate(name):
    return Candidate(name, 0.0, {}, 0.0, {}, (name,))


def test_of_one_round_the_best_of_other_equations_is_taken_too():
    system = system_of()
    problem = SimpleNamespace(system=system, replay=Replay(system), weights={"torque": 1.0, "gas": 1.0})
    model = SimpleNamespace(effects=("joint_friction",))

    def apart(*ranked):
        worth = [candidate(name) for name in ranked]
        found = select._apart(problem, model, worth, [(name, 0.0) for name in ranked])
        return found and found.name

    assert apart("joint_friction", "muscle_hysteresis", "extensor_leak", "flexor_leak") == "extensor_leak"
    # one that is better and changes both might be what both show
    assert apart("joint_friction", "angle_gain", "extensor_leak") is None
    assert apart("joint_friction", "muscle_hysteresis") is None


def test_delays_count_from_the_sensor_that_is_taken_away():
    system = system_of(**KNOWN_LATE)
    sensors = ("extensor_pressure_delay", "flexor_pressure_delay", "angle_delay")
    values = {"extensor_pressure_delay.delay": 3e-3, "flexor_pressure_delay.delay": 4e-3,
              "angle_delay.delay": 1e-3, "valve_delay.delay": -4e-3}  # fmt: skip
    problem = SimpleNamespace(system=system)
    final = SimpleNamespace(effects=("valve_delay", *sensors), values=values)
    counted = elimination._counted_from(problem, final, "angle_delay")
    assert counted["extensor_pressure_delay.delay"] == pytest.approx(2e-3)
    assert counted["flexor_pressure_delay.delay"] == pytest.approx(3e-3)
    assert counted["valve_delay.delay"] == pytest.approx(-3e-3)
    # not where a sensor is on time, no dead time is free, or another effect goes
    assert elimination._counted_from(problem, final, "valve_delay") == values
    fewer = SimpleNamespace(effects=("valve_delay", *sensors[1:]), values=values)
    assert elimination._counted_from(problem, fewer, "angle_delay") == values
    fixed = SimpleNamespace(effects=sensors, values=values)
    assert elimination._counted_from(problem, fixed, "angle_delay") == values


def test_an_effect_is_tried_for_the_details_of_one_that_it_resembles_and_no_other():
    alike = {"joint_friction": {"joint_friction": 1.0, "muscle_hysteresis": 0.9, "viscous_friction": 0.1}}
    alike["joint_friction"]["force_map_misfit"] = 0.95  # a shape correction is no other effect
    alike["joint_friction"]["valve_lag"] = 0.97  # nor what changes another equation
    problem = SimpleNamespace(
        system=SimpleNamespace(shapes=("force_map_misfit",)),
        replay=SimpleNamespace(touched=lambda name: {"gas" if name == "valve_lag" else "torque"}),
    )
    found = SimpleNamespace(alike=alike, final=SimpleNamespace(effects=("joint_friction",)), problem=problem)
    assert second_chance._alike_pairs(found, ["joint_friction"]) == [("joint_friction", "muscle_hysteresis")]
    found.final.effects = ("joint_friction", "muscle_hysteresis")
    assert second_chance._alike_pairs(found, ["joint_friction"]) == []


@pytest.mark.parametrize(("left", "cleaner"), [(0.5, True), (0.7, False)])
def test_what_takes_the_place_of_details_leaves_much_less(left, cleaner):
    problem = SimpleNamespace(weights={"torque": 1.0}, replay=SimpleNamespace(touched=lambda _: {"torque"}))
    assert (
        second_chance._cleaner(problem, SimpleNamespace(weights={"torque": left**-0.5}), "creep") == cleaner
    )


def test_a_shape_correction_is_far_off_beyond_what_it_may_be_once_it_is_named():
    system = system_of()
    free = with_scales(system, nuisance(system), {"force_map_misfit": 0.3})
    one = next(one for one in nuisance(system) if one.name == "force_map_misfit.extensor_c30")
    rest = {each.name: 0.0 for each in free}
    for multiple, far in ((0.9 * WIDE, []), (1.1 * WIDE, [one.name])):
        final = SimpleNamespace(effects=(), free=free, values={**rest, one.name: multiple * one.sd})
        assert judgement._far_off(system, final) == far
        assert judgement._far_off(system, final, judgement.FAR_STRAIN) == [one.name]
    final = SimpleNamespace(effects=(), free=free, values={**rest, "conductance": 5.1 * 0.03})
    assert judgement._far_off(system, final) == ["conductance"]


def test_what_is_called_as_a_strained_parameter_is_fitted_whatever_its_score_says():
    free = nuisance(system_of())
    one = next(one for one in free if one.name == "extensor_pressure_offset")
    for multiple, strained in ((2.9, set()), (3.1, {one.name})):
        values = {each.name: 0.0 for each in free} | {one.name: multiple * one.sd}
        assert screening.strained(SimpleNamespace(free=free, values=values)) == strained


def test_a_model_that_follows_worse_shows_nothing(monkeypatch):
    """Its priors may cost more, and less so than the residuals: the effect removes no visible misfit."""
    row = np.ones(100)
    base = SimpleNamespace(free=(), values={}, blocks={"torque": SimpleNamespace(residual=row)})
    for left, visible in ((107.0, False), (93.0, True)):
        costs = iter([50.0, 60.0])
        monkeypatch.setattr(confirmation, "prior_cost", lambda *_, costs=costs: next(costs))
        problem = SimpleNamespace(total=lambda *_, left=left: left)
        model = SimpleNamespace(effects=(), values={}, free=())
        assert confirmation.is_visible(problem, base, model) == visible
