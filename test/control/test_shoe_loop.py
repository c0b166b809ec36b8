# SPDX-License-Identifier: Apache-2.0
"""The shipped Stimulative Shoe loads the sole as set, within its limit, and lets go."""

from pathlib import Path

import numpy as np
import pytest

from pam_orthosis.control.legs import differences
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.model.machines import machine_named
from pam_orthosis.model.parameters import load

SHOE = machine_named(Path("shoe"))
PERIOD, STRIDE = 0.005, 2.0
CUSHIONS = {"heel": -1.0, "forefoot": 1.0}


class Changed:
    """A trajectory whose reference is another from an instant on."""

    def __init__(self, parameters, since, change):
        self._own, self._since, self._change = make_trajectory(parameters), since, change

    def sample(self, time_ns):
        reference = self._own.sample(time_ns)
        return reference if time_ns * 1e-9 < self._since else self._change(reference)


def loads(seconds, since=np.inf, change=None, **changes):
    """Return set and true force of each cushion, N: name -> (samples,), and the loop."""
    parameters = load(changes, SHOE)
    loop = ClosedLoop(parameters, seed=1, trajectory=Changed(parameters, since, change))
    wanted = make_trajectory(parameters)
    stiffness = parameters.machine.mechanism.stiffness
    set_, true = [], []
    for index in range(round(seconds / PERIOD)):
        asked, told = wanted.sample(round(index * PERIOD * 1e9)), loop.plant.signals()
        gauge = asked.mean_pressure - parameters.valve.ambient_pressure
        both = {name: getattr(parameters.machine, name) for name in CUSHIONS}
        set_.append([
            one.area * gauge + sign * 0.5 * stiffness * asked.position / abs(one.transmission.arm)
            for (name, sign), one in zip(CUSHIONS.items(), both.values(), strict=True)
        ])  # fmt: skip
        true.append([told[f"{name}_tension"] for name in CUSHIONS])
        loop.step(index)
    named = [dict(zip(CUSHIONS, np.array(rows).T, strict=True)) for rows in (set_, true)]
    return *named, loop


def crossings(force, level):
    """Return when a force rises and falls through a level, s, sorted."""
    return np.flatnonzero(np.diff(force > level)) * PERIOD


@pytest.fixture(scope="module")
def walk():
    return loads(7.0)


@pytest.mark.parametrize("name", CUSHIONS)
def test_the_force_reaches_its_set_peak_at_its_time(walk, name):
    wanted, true = (each[name][-round(STRIDE / PERIOD) :] for each in walk[:2])
    assert wanted.max() > 150
    assert true.max() == pytest.approx(wanted.max(), rel=0.10)
    level = 0.5 * wanted.max()
    assert crossings(true, level) == pytest.approx(crossings(wanted, level), abs=0.030)
    assert wanted.min() < 0.1 * wanted.max(), "the sole must be unloaded in the swing"
    assert true.min() < 0.1 * wanted.max()


def test_the_set_course_is_that_of_the_ground_reaction_force(walk):
    """Two humps near 15 and 50 % of the stride, nothing in the swing, 0.3 of 75 kg."""
    total = sum(walk[0].values())
    start = round((1.0 + 2.0 + 1.0) / PERIOD)  # hold, ramp, and the half of the ramp that a stride is late
    stride = total[start : start + round(STRIDE / PERIOD)]
    rest = stride.min()
    assert (stride.max() - rest) == pytest.approx(0.3 * 75 * 9.81 * 1.08, rel=0.12)


@pytest.mark.parametrize(("name", "value"), [("share", 0.15), ("body_mass", 50.0)])
def test_the_load_is_a_share_of_the_bodys_weight(walk, name, value):
    """What is asked for beyond rest is as many times the shipped course as the weight is; it is pressed."""
    shipped = load({}, SHOE).machine.mechanism
    wanted, true, _ = loads(7.0, **{f"machine.mechanism.{name}": value})
    last, by = slice(-round(STRIDE / PERIOD), None), value / getattr(shipped, name)
    rest = {cushion: one[0] for cushion, one in walk[0].items()}
    for cushion in CUSHIONS:
        asked = wanted[cushion][last]
        beyond = by * (walk[0][cushion][last] - rest[cushion])
        assert asked - rest[cushion] == pytest.approx(beyond, abs=1e-5)  # N; the rest is rounded in the file
        assert true[cushion][last].max() == pytest.approx(asked.max(), rel=0.10)


def test_the_load_rises_over_the_start(walk):
    first = sum(walk[1].values())[: round(1.0 / PERIOD)]
    assert first.max() < 60
    second = sum(walk[1].values())[: round(2.0 / PERIOD)]
    assert second.max() < 0.6 * sum(walk[1].values()).max()


def test_what_is_asked_beyond_the_limit_is_not_pressed():
    _, true, _ = loads(
        3.0,
        1.0,
        lambda r: r._replace(mean_pressure=5.6e5, position=0.15, planned=r.planned._replace(position=0.15)),
    )
    limit = load({}, SHOE).control.position.maximum_pressure - load({}, SHOE).valve.ambient_pressure
    area = load({}, SHOE).machine.forefoot.area
    assert 0.8 * area * limit < true["forefoot"].max() < 1.1 * area * limit


def vented(loop):
    loop.plant.advance = lambda *_, own=loop.plant.advance: own(0.0, 0.0)


def unsupplied(loop):
    """Close the supply: a valve that fills finds no more pressure than outside."""
    loop.plant.advance = lambda *volts, own=loop.plant.advance: own(*(min(v, 5.0) for v in volts))


@pytest.mark.parametrize("stop", [vented, unsupplied])
def test_who_takes_the_air_releases_the_sole(stop):
    """An emergency stop and the end of a run open all vents; a supply that gives way fills no more."""
    parameters = load({}, SHOE)
    loop = ClosedLoop(parameters, seed=1)
    told = []
    for index in range(round(7.5 / PERIOD)):
        if index == round(5.0 / PERIOD):
            stop(loop)
        told.append([loop.plant.signals()[f"{name}_tension"] for name in CUSHIONS])
        loop.step(index)
    before, after = np.array(told)[round(3.0 / PERIOD) :][:400], np.array(told)[round(7.0 / PERIOD) :]
    assert before.max() > 150
    assert after.max() < (5 if stop is vented else 20)


def test_a_stop_releases_the_sole():
    _, true, loop = loads(
        6.0, 5.0, lambda r: r._replace(position=np.nan, planned=r.planned._replace(position=np.nan))
    )
    assert loop.health()["position"]["vent"]
    before, after = round(5.0 / PERIOD), round(5.6 / PERIOD)
    assert max(one[before - 400 : before].max() for one in true.values()) > 150
    assert max(one[after:].max() for one in true.values()) < 5


def forces_at_rest(parameters, seconds, stop=None):
    """Return the force set on each cushion, N, at an instant; `stop` is when the motion is stopped."""
    trajectory = make_trajectory(parameters)
    if stop is not None:
        trajectory.stop(round(stop * 1e9))
    asked, machine = trajectory.sample(round(seconds * 1e9)), parameters.machine
    gauge = asked.mean_pressure - parameters.valve.ambient_pressure
    torque = machine.mechanism.stiffness * asked.planned.position
    return [machine.heel.area * gauge + sign * 0.5 * torque / 0.1 for sign in CUSHIONS.values()]


def test_a_leg_that_begins_in_the_middle_of_a_stride_is_not_loaded_yet():
    whole = load({"scenario.start_hold": 1.0}, SHOE)
    right = whole.changed(differences(whole)["right"])
    assert max(forces_at_rest(right, 0.0)) < 40
    assert right.at(SHOE.start) == pytest.approx(whole.at(SHOE.start), abs=1e-6)
    _, true, _ = loads(0.9, **differences(whole)["right"])
    assert max(one.max() for one in true.values()) < 40


@pytest.mark.parametrize("stop", [6.2, 6.5, 6.8, 7.1])
def test_a_motion_that_is_stopped_leaves_no_load_wherever_in_the_stride(stop):
    parameters = load({}, SHOE)
    end = stop + parameters.scenario.start_ramp + 0.1
    assert max(forces_at_rest(parameters, end, stop)) < 40
