# SPDX-License-Identifier: Apache-2.0
"""What a person does by will and in a spasm, as the knee feels it."""

import numpy as np
import pytest

from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.model.parameters import load, scenario_overrides
from pam_orthosis.model.person.volition import Volition, needed_effort
from pam_orthosis.model.plant import Plant
from pam_orthosis.model.truth import true_parameters

PERSON = "plant.person"
PERIOD = 0.005


def person(**settings):
    given = {f"{PERSON}.{key}": value for key, value in settings.items()}
    parameters = load({**scenario_overrides("person"), f"{PERSON}.volition.enabled": True, **given})
    return Volition(parameters, parameters.declared.mechanism(true_parameters(parameters)))


def follow(one, seconds=6.0):
    """Return time and effort of a person whose knee is where they want it."""
    time = np.arange(0, seconds, PERIOD)
    return time, np.array([one.effort(t, *one.intended(t)[:2]) for t in time])


def test_the_person_intends_what_the_scenario_asks_for():
    parameters = load(scenario_overrides("person"))
    asked, one = make_trajectory(parameters), person()
    for time in (0.0, 1.5, 4.2, 7.7):
        assert one.intended(time) == pytest.approx(asked.sample(round(time * 1e9))[:3])


def test_shares_are_those_of_the_effort_that_the_motion_takes():
    parameters = load(scenario_overrides("person"))
    needed = needed_effort(parameters.declared.mechanism(true_parameters(parameters)))
    one = person(**{"volition.share": 0.5})
    time, effort = follow(one)
    assert effort == pytest.approx([0.5 * float(needed(*one.intended(t))) for t in time])
    assert np.ptp(effort) > 5.0
    _, against = follow(person(**{"volition.share": -0.5}))
    assert against == pytest.approx(-effort)


def test_will_is_limited_by_strength_and_falls_with_time():
    _, weak = follow(person(**{"volition.share": 1.0, "volition.strength": 3.0}))
    assert np.abs(weak).max() == 3.0
    tired = {"volition.share": 1.0, "volition.fatigue": 0.5, "volition.fatigue_time": 1.0}
    fresh, late = (follow(person(**how))[1][-1] for how in ({"volition.share": 1.0}, tired))
    assert late == pytest.approx(fresh * (1 - 0.5 * (1 - np.exp(-5.995))))


def test_a_block_holds_where_it_began_and_a_spasm_comes_and_goes():
    one = person(**{"block.start": 1.0, "block.duration": 0.5, "block.damping": 0.0})
    assert one.effort(1.0, 0.3, 0.0) == 0.0
    assert one.effort(1.2, 0.4, 0.0) == pytest.approx(-15.0)
    assert one.effort(1.5, 0.4, 0.0) == 0.0
    one = person(**{"spasm.start": 1.0, "spasm.duration": 0.5})
    before, soon, full, after = (one.effort(t, 0.3, 0.0) for t in (0.99, 1.05, 1.49, 1.5))
    assert (before, after) == (0.0, 0.0)
    assert soon == pytest.approx(-25 * (1 - np.exp(-1)))
    assert full == pytest.approx(-25, rel=1e-3)


def test_straps_that_yield_soften_what_the_person_holds():
    def held(**more):
        one = person(**{"block.start": 0.0, "block.damping": 0.0, **more})
        one.effort(0.0, 0.3, 0.0)
        for step in range(1, 200):
            effort = one.effort(step * PERIOD, 0.4, 0.0)
        return effort

    assert held() == pytest.approx(-15.0)
    in_series = 0.1 / (1 / 150 + 1 / 600)
    assert held(**{"strap.enabled": True}) == pytest.approx(-in_series, rel=1e-3)


def test_the_recorded_truth_holds_what_the_person_did():
    parameters = load(scenario_overrides("person-cooperating"))
    plant = Plant(parameters, 1)
    assert plant.truth().torque == pytest.approx(
        person(**{"volition.share": 1.0}).effort(0.0, 0.02777, 0.0), abs=0.1
    )
    plant.retune(parameters.changed({"plant.person.volition.enabled": False}))
    plant.advance(5.0, 5.0)
    assert plant.truth().torque == 0.0
