# SPDX-License-Identifier: Apache-2.0
"""The shipped leg walks: both joints follow, and what each asks of the other is known beforehand."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from coupled_loop import CoupledLoop

from pam_orthosis.control.coupling import Coupling
from pam_orthosis.control.legs import device_parameters
from pam_orthosis.control.reference import Motion, Reference
from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.device import device_named
from pam_orthosis.model.machines import machine_named
from pam_orthosis.model.parameters import load

ANKLE = machine_named(Path("ankle"))
PERSON = {"leg.person.present": True}
BRIEF = {"scenario.start_hold": 0.2, "scenario.start_ramp": 1.0}


def joints(changes):
    return device_parameters(device_named(Path("leg")), changes)


@pytest.mark.parametrize("present", [False, True])
def test_knee_and_ankle_follow_measured_strides_within_one_degree(present):
    loop = CoupledLoop(joints(BRIEF | {"leg.person.present": present}))
    for name, run in loop.run(760).items():
        error = np.degrees(np.abs(run["reference_angle"] - run["true_angle"])).max()
        assert np.degrees(np.ptp(run["true_angle"])) > 20, "it must walk"
        assert error <= 1.0, (name, error)
        assert loop.loops[name].health()["position"]["vented_samples"] == 0


HOLDS = {"start": 2.4, "duration": 1.5, "stiffness": 150.0, "damping": 1.0}
STIFF = {"volition.enabled": True} | {f"block.{key}": value for key, value in HOLDS.items()}
CLONUS = {
    f"tissue.clonus.{key}": value
    for key, value in {"enabled": True, "amplitude": 4.0, "threshold": 1.0}.items()
}
PERSONS = {
    "pushes": ({"ankle/plant.external_torque": 5.0, "ankle/plant.external_frequency": 0.35}, 0.5, 1.0),
    "stiffens": ({f"ankle/plant.person.{key}": value for key, value in STIFF.items()}, 3.0, 6.0),
    "has clonus": ({f"ankle/plant.person.{key}": value for key, value in CLONUS.items()}, 1.0, 2.0),
}


@pytest.mark.parametrize("what", PERSONS)
def test_an_ankle_holds_or_gives_way_and_comes_back_and_the_knee_walks_on(what):
    changes, least, most = PERSONS[what]
    loop = CoupledLoop(joints(BRIEF | PERSON | changes))
    errors = {
        name: np.degrees(np.abs(run["reference_angle"] - run["true_angle"]))
        for name, run in loop.run(1000).items()
    }
    assert errors["knee"].max() <= 1.0
    assert least <= errors["ankle"].max() <= most
    assert errors["ankle"][-40:].max() <= 1.0
    assert loop.loops["ankle"].health()["position"]["vented_samples"] == 0


def test_at_rest_the_coupling_is_the_ankles_weight_in_the_pose_of_the_moving_knee():
    nominal = joints(PERSON)["ankle"].nominal()
    q, knee, held_at = 0.1, 0.4, nominal.leg.ankle.knee_angle
    found = Coupling(nominal).effort(Reference(q, 0.0, 0.0, beside=Motion(knee, 0.0, 0.0)))
    posed, held = gravity(knee, q), gravity(held_at, q)
    assert abs(posed - held) > 3.0, "a straighter knee stretches the calf"
    assert found == pytest.approx(posed - held, rel=1e-9)


def gravity(knee, q):
    """Return gravity and passive moment of the ankle alone, the knee held."""
    x, v = ca.SX.sym("x"), ca.SX.sym("v")
    mechanism = ANKLE.mechanism(load(PERSON | {"leg.ankle.knee_angle": knee}, ANKLE))
    return float(ca.Function("gravity", [x, v], [mechanism.terms(x, v).gravity])(q, 0.0))


def test_a_motion_of_the_knee_pulls_on_the_ankle_and_the_other_way_round():
    still = Motion(0.5, 0.0, 0.0)
    for nominal in (one.nominal() for one in joints({}).values()):
        coupling = Coupling(nominal)
        rest = coupling.effort(Reference(0.2, 0.0, 0.0, beside=still))
        moved = coupling.effort(Reference(0.2, 0.0, 0.0, beside=still._replace(acceleration=50.0)))
        assert moved != pytest.approx(rest, abs=1e-3)


def test_another_persons_weight_couples_otherwise():
    own = joints(PERSON)["knee"]
    coupling, motion = Coupling(own.nominal()), Reference(0.8, 1.0, 5.0, beside=Motion(0.1, 2.0, 20.0))
    before = coupling.effort(motion)
    coupling.retune(own.changed({"leg.person.mass": 110.0}))
    assert abs(coupling.effort(motion)) > 1.1 * abs(before)


def test_a_machine_that_is_coupled_to_nothing_has_no_such_effort():
    assert Coupling(load().nominal()).effort(Reference(0.5, 0.0, 1.0)) == 0.0


def test_the_reference_of_both_joints_keeps_step_when_it_is_stopped():
    own = joints({})
    knee, ankle = (make_trajectory(own[name]) for name in ("knee", "ankle"))
    for trajectory in (knee, ankle):
        trajectory.stop(round(4e9))
    for time_ns in (0, round(3.3e9), round(4.2e9), round(9e9)):
        assert knee.sample(time_ns).beside == pytest.approx(ankle.sample(time_ns)[:3])
        assert ankle.sample(time_ns).beside == pytest.approx(knee.sample(time_ns)[:3])


def test_coupled_joints_refuse_a_motion_that_is_one_joints_alone():
    with pytest.raises(OrthosisError, match="coupled joints move by gait or hold"):
        make_trajectory(joints({"scenario.trajectory": "sine"})["knee"])
