# SPDX-License-Identifier: Apache-2.0
"""Co-contraction sets the joint's stiffness, and the plant has the stiffness that the model says."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from stiffness import measured, modelled

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load, scenario_overrides

ANGLE = 0.6
EXACT = {
    **{f"plant.effects.{name}.enabled": False for name in KNEE.catalogue},
    **{f"plant.deviation.{name}": 1.0 for name, _ in load().plant.deviation.items()},
    "plant.muscle_law": "polynomial",
    "plant.external_torque": 2.0,
    "plant.external_frequency": 0.5,
}


def test_co_contraction_stiffens_the_joint_and_closed_valves_more():
    found = [modelled(load(), ANGLE, mean) for mean in (2.6e5, 3.6e5, 4.6e5)]
    assert found[0].held < found[1].held < found[2].held
    assert all(one.closed > 1.5 * one.held for one in found)


def test_the_plant_has_the_stiffness_of_the_model():
    p = load({**scenario_overrides("diagnostic-stiffness"), **EXACT, "scenario.control_period": 0.005})
    run = ClosedLoop(p, 1).run(1600)
    stiffness = measured(run["time"], run["angle"], run["true_torque"], 0.5, 3.0)
    expected = modelled(p, ANGLE, p.control.position.mean_pressure).closed
    assert stiffness == pytest.approx(expected, rel=0.03)


def test_friction_does_not_count_as_stiffness():
    time = np.arange(0, 10, 0.005)
    angle = 0.05 * np.sin(np.pi * time)
    torque = 40 * angle + 0.8 * np.sign(np.cos(np.pi * time))
    assert measured(time, angle, torque, 0.5, 2.0) == pytest.approx(40, rel=0.01)
    with pytest.raises(ValueError, match="too few"):
        measured(time, angle, torque, 0.5, 8.0)
