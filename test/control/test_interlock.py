# SPDX-License-Identifier: Apache-2.0
"""A joint that gives way releases the sole of its leg, no other, and takes it along on the way back."""

from pathlib import Path

import numpy as np
import pytest
from coupled_loop import CoupledLoop

from pam_orthosis.control.legs import device_parameters
from pam_orthosis.model.components.spool import VENT, voltage_of
from pam_orthosis.model.device import device_named
from pam_orthosis.model.interlock import Interlock

DEVICE = device_named(Path("device"))
PERIOD = 0.005
BRIEF = {"scenario.start_hold": 0.1, "scenario.start_ramp": 0.5, "control.guard.rise_time": 0.3}
BLOCK = {"start": 2.0, "duration": 1.0, "stiffness": 1000.0, "damping": 20.0}
RELEASED_N, SECONDS = 5.0, 0.3


def given():
    """Return parameters of the left leg, whose knee somebody holds for a second, and of the right shoe."""
    own = device_parameters(DEVICE, BRIEF | {"control.guard.return_speed": 2.0})
    held = {f"plant.person.block.{key}": value for key, value in BLOCK.items()}
    held["plant.person.volition.enabled"] = True
    there = {name: one for name, one in own.items() if name.startswith("left") or name == "right/shoe"}
    return there | {"left/knee": own["left/knee"].changed(held)}


@pytest.fixture(scope="module")
def course():
    """Return the largest force of each sole, N, and whether the knee is vented, over 7 s."""
    parameters = given()
    loop = CoupledLoop(parameters)
    soles = {name: loop.plants.of[name] for name in ("left/shoe", "right/shoe")}
    forces, vents = {name: [] for name in soles}, []
    knee = parameters["left/knee"]
    for _ in range(round(7.0 / PERIOD)):
        run = loop.run(1, len(vents))["left/knee"]
        vents.append(
            all(run[f"{name}_voltage"][0] <= knee.valve.minimum_voltage for name in knee.declared.names)
        )
        for name, plant in soles.items():
            told = plant.signals()
            forces[name].append(max(told[f"{cushion}_tension"] for cushion in ("heel", "forefoot")))
    return {name: np.array(one) for name, one in forces.items()}, np.array(vents)


def test_the_sole_is_released_with_the_joint_and_loaded_again_with_it(course):
    forces, vents = course
    first, last = np.flatnonzero(vents)[[0, -1]]
    assert forces["left/shoe"][:first].max() > 100
    released = forces["left/shoe"][first + round(SECONDS / PERIOD) : last]
    assert len(released) > 20
    assert released.max() < RELEASED_N
    assert forces["left/shoe"][last:].max() > 100


def test_the_other_legs_sole_stays_loaded(course):
    forces, _ = course
    strides = forces["right/shoe"][round(1.0 / PERIOD) :].reshape(-1, round(2.0 / PERIOD))
    assert strides.max(axis=1).min() > 100


def test_a_moment_without_air_releases_nothing_and_a_release_lasts():
    own = device_parameters(DEVICE, {})
    names = [name for name, one in own.items() for _ in one.declared.names]
    interlock, full = Interlock(own), 5.0
    vent = voltage_of(VENT, own["left/ankle"].valve)

    def told(vented, periods):
        for _ in range(periods):
            given = [interlock.allowed(i, vent if name in vented else full) for i, name in enumerate(names)]
            interlock.passed()
        return {name for name, volts in zip(names, given, strict=True) if volts == vent}

    settings = own["left/ankle"].control.guard
    after, least = (round(t / PERIOD) for t in (settings.hold_time, settings.rest_time))
    assert told({"left/ankle"}, after - 1) == {"left/ankle"}
    assert told(set(), 1) == set()
    assert told({"left/ankle"}, after + 1) == {"left/ankle", "left/shoe"}
    assert told(set(), least) == {"left/shoe"}
    assert told(set(), 2) == set()
    assert told({"right/shoe"}, 10 * after) == {"right/shoe"}, "a shoe without air releases no joint"
