# SPDX-License-Identifier: Apache-2.0
"""How the joint meets a person: as stiff as asked, hardly felt, as helpful as needed."""

import numpy as np
import pytest

from pam_orthosis.control.activity import shares
from pam_orthosis.control.cooperation import CooperativeController
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.control.waiting import Waiting
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import load, scenario_overrides

MODE = "control.cooperation.mode"
FAST = {"control.observer.pole": 105.0, "control.guard.tracking_error": 3.0}
WILL = "plant.person.volition"


def cooperating(scenario, **changes):
    parameters = load(scenario_overrides(scenario) | FAST | changes)
    controller = CooperativeController(parameters)
    return ClosedLoop(parameters, 1, position=controller), controller, parameters


def test_the_mode_position_is_the_position_controller():
    parameters = load(scenario_overrides("person"))
    plain = ClosedLoop(parameters, 1).run(300)
    same = ClosedLoop(parameters, 1, position=CooperativeController(parameters)).run(300)
    assert all(np.array_equal(plain[name], same[name]) for name in plain)


@pytest.mark.parametrize("stiffness", [100.0, 300.0])
def test_a_push_meets_the_stiffness_that_was_asked_for(stiffness):
    loop, *_ = cooperating(
        "person",
        **{
            MODE: "impedance", "control.cooperation.stiffness": stiffness,
            "scenario.trajectory": "hold", "scenario.start_angle": 0.6,
            "plant.external_torque": 12.0, "plant.external_frequency": 0.5,
        },
    )  # fmt: skip
    run = loop.run(1200)
    wave = np.exp(-1j * np.pi * run["time"][-800:])
    answer = np.mean(run["true_torque"][-800:] * wave) / np.mean(run["true_angle"][-800:] * wave)
    inertia = 0.34 * np.pi**2  # of the leg, at this frequency
    assert answer.real + inertia == pytest.approx(stiffness, rel=0.15)
    assert answer.imag > 0  # it takes up energy


def test_a_light_leg_is_held_no_more_stiffly_than_the_loop_can():
    loop, *_ = cooperating(
        "person",
        **{
            MODE: "impedance", "control.cooperation.stiffness": 600.0, "control.cooperation.damping": 20.0,
            "leg.person.mass": 30.0, "leg.person.height": 1.35, "plant.external_torque": 12.0,
            "scenario.trajectory": "hold", "scenario.start_angle": 0.6, "plant.external_frequency": 2.0,
        },
    )  # fmt: skip
    run = loop.run(600)
    assert np.abs(run["true_angle"] - 0.6).max() < np.radians(5)


@pytest.mark.parametrize(("stiffness", "inside"), [(150.0, True), (0.0, False)])
def test_a_soft_joint_stays_inside_the_range_of_motion_by_the_spring_at_its_ends(stiffness, inside):
    loop, *_ = cooperating(
        "person",
        **{
            MODE: "transparent", "scenario.trajectory": "hold", "scenario.start_angle": 0.6,
            "plant.external_torque": 6.0, "plant.external_frequency": 0.3,
            "control.limits.enabled": True, "control.limits.low": 0.3, "control.limits.high": 0.9,
            "control.cooperation.edge_stiffness": stiffness,
        },
    )  # fmt: skip
    angle = loop.run(800)["true_angle"]
    assert (angle.min() > 0.3 and angle.max() < 0.9) == inside
    assert np.ptp(angle) > 0.3  # it is soft between them


def test_a_transparent_orthosis_is_hardly_felt():
    will = {f"{WILL}.enabled": True, f"{WILL}.stiffness": 150.0, f"{WILL}.damping": 6.0}
    loop, *_ = cooperating("sine", **{MODE: "transparent", **will})
    run = loop.run(1800)
    assert np.sqrt(np.mean(run["true_torque"][-800:] ** 2)) < 3.0
    assert np.ptp(run["true_angle"][-800:]) > 0.5


@pytest.fixture(scope="module")
def assisted():
    def of(share):
        loop, controller, parameters = cooperating(
            "person-passive", **{MODE: "assist", f"{WILL}.share": share}
        )
        return loop.run(3400), controller.level, parameters

    return {share: of(share) for share in (0.0, 0.6)}


def test_assistance_falls_as_the_person_does_more(assisted):
    levels = {share: level for share, (_, level, _) in assisted.items()}
    assert levels[0.0] > 0.7
    assert levels[0.6] < 0.5
    for run, *_ in assisted.values():
        error = run["reference_angle"] - run["true_angle"]
        assert np.degrees(np.abs(error[-1600:]).max()) < 5.0


def test_the_share_of_the_person_is_estimated(assisted):
    for share, (run, _, parameters) in assisted.items():
        cycle = round(parameters.scenario.cycle_time / parameters.scenario.control_period)
        count = len(run["time"])
        (last,) = shares(run, parameters, [(count - cycle, count)])
        assert last.share == pytest.approx(share, abs=0.1)
        assert 0.0 < last.error < 0.2


def test_the_mode_changes_while_the_knee_moves():
    loop, controller, parameters = cooperating("person", **{"scenario.start_hold": 0.1})
    loop.run(300)
    controller.retune(parameters.changed({MODE: "transparent"}))
    run = loop.run(200)
    assert np.abs(run["reference_angle"] - run["true_angle"]).max() > np.radians(3)
    with pytest.raises(OrthosisError, match="is not one of position, impedance, assist, transparent"):
        parameters.changed({MODE: "gentle"})


@pytest.fixture
def waiting():
    parameters = load({"scenario.trajectory": "sine", "scenario.start_angle": 0.6})
    return Waiting(make_trajectory(parameters), parameters), make_trajectory(parameters)


def test_a_reference_goes_on_at_full_pace_with_a_person_who_keeps_up(waiting):
    reference, plain = waiting
    for index in range(1200):
        sample = reference.sample(index * 5_000_000)
        reference.heed(sample.position)
    assert sample == plain.sample(1199 * 5_000_000)


def test_a_reference_stands_still_for_a_person_who_does(waiting):
    reference, _ = waiting
    positions = []
    for index in range(2000):
        positions.append(reference.sample(index * 5_000_000).position)
        reference.heed(0.6)
    assert np.ptp(positions[-400:]) < 1e-3
    assert 0.03 < abs(positions[-1] - 0.6) < 0.2
    velocity = np.gradient(positions, 0.005)
    assert np.abs(np.diff(velocity)).max() < 0.1  # no jolt


def test_what_changes_with_time_does_so_alike_where_samples_are_missed():
    def after(count, periods):
        _, controller, parameters = cooperating("person", **{MODE: "assist"})
        start = make_trajectory(parameters).sample(0)
        pressures = (parameters.control.position.mean_pressure,) * 2
        for _ in range(count):
            controller.step(start.position + 0.1, pressures, start, periods)
        return controller

    each, third = after(30, 1), after(10, 3)
    assert third._begun == pytest.approx(each._begun)
    assert 1 - third.level == pytest.approx(1 - each.level, rel=0.2)
    assert each.level < 1
