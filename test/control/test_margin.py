# SPDX-License-Identifier: Apache-2.0
"""Margins: a known limit is found within the resolution; changes of the hardware are what they say."""

import math
from dataclasses import replace

import pytest

from pam_orthosis.control import margin
from pam_orthosis.control.margin import FINEST, SHARE, limits, maximum_error, perturbations
from pam_orthosis.model.parameters import load, scenario_overrides
from pam_orthosis.model.truth import true_parameters

QUICK = {
    "scenario.duration": 1.5, "scenario.trajectory": "sine", "scenario.start_angle": 0.6,
    "scenario.start_hold": 0.1, "scenario.start_ramp": 0.4, "scenario.cycle_time": 1.0,
}  # fmt: skip


def ladder(direction, nominal=8.0, least=1.0, most=50.0):
    one = perturbations(load())["delay"]
    return replace(one, nominal=nominal, step=1.0, least=least, most=most).ladder(direction)


class Counted:
    """An error that is known: 1 at 8, growing with the distance, infinite beyond a threshold."""

    def __init__(self, per_unit, lost_beyond):
        self.calls = []
        self._per_unit, self._lost = per_unit, lost_beyond

    def __call__(self, value):
        self.calls.append(value)
        distance = abs(value - 8.0)
        return math.inf if distance > self._lost else 1.0 + self._per_unit * distance


@pytest.mark.parametrize(("direction", "sign"), [("more", 1), ("less", -1)])
@pytest.mark.parametrize(("doubled", "lost"), [(0.3, 0.9), (1.7, 5.3), (2.0, 2.1), (4.9, 6.0)])
def test_a_known_limit_is_found_within_the_resolution(direction, sign, doubled, lost):
    error = Counted(1.0 / doubled, lost)
    (twice, gone), known = limits(error, ladder(direction), (2.0, 20.0))
    for limit, at in ((twice, doubled), (gone, lost)):
        kept, reached = sign * (limit.kept - 8.0), sign * (limit.reached - 8.0)
        assert kept <= at <= reached + 1e-9
        assert reached - kept <= max(FINEST, SHARE * reached) + 1e-9
    assert len(error.calls) == len(set(error.calls)) == len(known) <= 14


def test_where_nothing_happens_there_is_no_limit_and_the_whole_range_was_tried():
    error = Counted(0.0, math.inf)
    (twice, gone), _ = limits(error, ladder("more"), (2.0, 20.0))
    assert twice == gone == (50.0, None)
    assert error.calls == [8.0, 9.0, 10.0, 12.0, 16.0, 24.0, 40.0, 50.0]


def test_no_run_beyond_a_lost_knee():
    error = Counted(0.0, 3.0)
    limits(error, ladder("more"), (2.0, 20.0))
    assert max(error.calls) == 12.0


def test_a_value_at_its_bound_has_no_range():
    assert ladder("more", most=8.0) == [8.0]
    assert limits(Counted(1.0, 5.0), [8.0], (2.0, 20.0))[0] == [(8.0, None)] * 2


@pytest.mark.parametrize("scenario", ["default", "person"])
def test_every_value_is_one_of_the_hardware_alone(scenario):
    p = load(scenario_overrides(scenario))
    for one in perturbations(p).values():
        for value in (*one.ladder("more"), *one.ladder("less")):
            overrides = one.overrides(value)
            assert all(key.startswith("plant.") for key in overrides)
            changed = perturbations(p.changed(overrides))  # within bounds and rules
            if one.name in changed:
                assert changed[one.name].nominal == pytest.approx(value, abs=1e-9)


def test_hardware_that_has_a_delay_of_any_size_can_be_given_less():
    long = load({"plant.delay.hose_length": 20.0})
    one = perturbations(long)["delay"]
    assert one.ladder("more") == [one.nominal] == [pytest.approx(1.5 + 58.0 + 3.5)]
    for value in one.ladder("less"):
        assert perturbations(long.changed(one.overrides(value)))["delay"].nominal == pytest.approx(value)


def test_friction_keeps_its_proportion_and_mass_is_that_of_all_parts():
    p = load(scenario_overrides("person"))
    found = perturbations(p)
    tripled = found["friction"].overrides(3 * found["friction"].nominal)
    assert tripled == {
        "plant.effects.joint_friction.coulomb": pytest.approx(2.4),
        "plant.effects.viscous_friction.viscosity": pytest.approx(
            3 * p.plant.effects.viscous_friction.viscosity
        ),
    }
    before, after = (true_parameters(q).leg for q in (p, p.changed(found["mass"].overrides(2 * 1.04 / 1.04))))
    ratio = after.shoe_mass / before.shoe_mass
    assert after.person.mass / before.person.mass == pytest.approx(ratio)
    assert ratio == pytest.approx(2.0 / 1.04)


def test_what_the_hardware_has_not_is_left_out():
    p = load(
        {"plant.effects.joint_friction.enabled": False, "plant.effects.muscle_hysteresis.half_width": 0.0}
    )
    assert set(margin.NAMES) - set(perturbations(p)) == {"friction", "hysteresis"}


def test_a_knee_is_lost_when_a_guard_vents_and_when_it_cannot_be_held():
    assert maximum_error(load(QUICK)) < math.radians(5)
    assert maximum_error(load(QUICK | {"plant.deviation.supply_pressure": 0.5, "leg.person.present": True,
                                       "leg.person.mass": 200.0})) == math.inf  # fmt: skip
    assert maximum_error(load(QUICK | {"plant.delay.valve": 0.05})) == math.inf


def test_a_worse_controller_has_smaller_margins_of_delay():
    """The same gains without the predictor: both limits are below where its own begin."""
    margins = {}
    for name, nominal_delay in {"predictor": {}, "none": {"valve.delay": 0.0}}.items():
        p = load(QUICK | nominal_delay)
        one = perturbations(p)["delay"]

        def error(value, p=p, one=one):
            return maximum_error(p.changed(one.overrides(value)))

        levels = (math.radians(2.5), margin.thresholds(p, 1.0)[1])
        margins[name], _ = limits(error, [one.nominal, one.nominal + 6.0, one.nominal + 18.0], levels)
    for with_it, without in zip(margins["predictor"], margins["none"], strict=True):
        assert without.reached < with_it.kept
