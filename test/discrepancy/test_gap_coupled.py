# SPDX-License-Identifier: Apache-2.0
"""A joint of a leg is replayed alone, driven by what is recorded of the other joint's motion."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from coupled_loop import CoupledLoop

from pam_orthosis.control.legs import device_parameters
from pam_orthosis.discrepancy.recordings.data import from_arrays
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.replay.run import Run
from pam_orthosis.discrepancy.systems.declared import coupled_joint
from pam_orthosis.discrepancy.systems.soundness import check_system
from pam_orthosis.discrepancy.systems.system import Source
from pam_orthosis.model.device import device_named

STEPS, SETTLED = 700, 300
RIGHT = {
    "plant.muscle_law": "polynomial", "valve.dead_band": 0.0, "valve.delay": 0.0,
    "scenario.start_hold": 0.1, "scenario.start_ramp": 0.5,
    **{f"plant.delay.{part}": 0.0 for part in ("computing", "converter", "valve", "hose_length")},
}  # fmt: skip


def as_nominal(one):
    """Return a joint whose hardware is as its model says."""
    keys = [key for key in one.flat() if key.startswith("plant.")]
    effects = {key: False for key in keys if key.startswith("plant.effects.") and key.endswith(".enabled")}
    return one.changed(effects | {key: 1.0 for key in keys if key.startswith("plant.deviation.")})


@pytest.fixture(scope="module")
def joints():
    return {
        name: as_nominal(one) for name, one in device_parameters(device_named(Path("leg")), RIGHT).items()
    }


@pytest.fixture(scope="module")
def walk(joints):
    return CoupledLoop(joints).run(STEPS)


def recorded(system, own, run, beside):
    """Return a joint's recording with a motion of the other one."""
    time = np.arange(STEPS) * own.scenario.control_period
    arrays = {"time": time, f"{own.declared.neighbour}_angle": beside}
    arrays |= {name: run[name] for name in (*own.declared.channels, *system.inputs)}
    return Run(system, from_arrays("walk", system, arrays), own.gap.replay.cross_cutoff)


@pytest.mark.parametrize("joint", ["knee", "ankle"])
def test_the_other_joints_motion_explains_what_a_joint_does(joints, walk, joint):
    own = joints[joint]
    moved = walk[own.declared.neighbour]["angle"]
    still = moved[0] + 1e-6 * np.arange(STEPS)
    system = coupled_joint(own.declared, Source(), own)
    check_system(system)
    check_system(coupled_joint(own.declared, Source(), own, None, True))
    replay, torque = Replay(system), system.equations[0]
    assert torque.channels == ("angle",), "the other joint's motion is known, not predicted"
    known, held = (
        replay.residuals(recorded(system, own, walk[joint], beside), torque, (), replay.defaults(()))
        for beside in (moved, still)
    )
    left = float(np.std(known[SETTLED:]))
    assert left < 2 * own.plant.sensor.angle_noise
    assert np.std(held[SETTLED:]) > 2.5 * left


@pytest.mark.parametrize("joint", ["knee", "ankle"])
def test_a_joints_terms_are_its_row_of_the_whole_legs(joints, joint):
    machine, random = joints[joint].declared, np.random.default_rng(3)
    whole = machine.coupled_mechanism(joints[joint])
    q, v, beside = ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("beside", 3)
    row, terms = machine.beside(joints[joint], beside).terms(q[0], v[0]), whole.terms(q, v)
    found = ca.Function("found", [q[0], v[0], beside], [row.inertia, row.coriolis + row.gravity])
    both = ca.Function("both", [q, v], [terms.inertia, terms.coriolis + terms.gravity])
    for _ in range(20):
        angles, rates, accelerations = (
            random.uniform(-0.3, 0.3, 2) + 0.5,
            random.uniform(-4, 4, 2),
            random.uniform(-40, 40, 2),
        )
        i, j = machine.joint, 1 - machine.joint
        inertia, rest = found(angles[i], rates[i], [angles[j], rates[j], accelerations[j]])
        matrix, others = both(angles, rates)
        expected = (matrix @ accelerations + others)[i]
        assert float(inertia * accelerations[i] + rest) == pytest.approx(float(expected), rel=1e-12)
