# SPDX-License-Identifier: Apache-2.0
"""The emulated rig: balance of forces, sensors and the MAS-40."""

import math

import numpy as np
import pytest

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model import parameters, rig
from pam_orthosis.model.assembly import assemble
from pam_orthosis.model.components import muscle
from pam_orthosis.model.mechanisms import carriage
from pam_orthosis.model.mechanisms.base import GRAVITY

QUIET = {
    "plant.sensor.pressure_noise": 0.0,
    "plant.sensor.pressure_resolution": 0.0,
    "plant.rig.sensor.position_noise": 0.0,
    "plant.rig.sensor.position_resolution": 0.0,
}


def settled(overrides=None, volts=(6.0, 9.0), **options):
    plant = rig.RigPlant(parameters.load(overrides), "dmsp_20", **options)
    for _ in range(150):
        plant.advance(*volts)
    for _ in range(1500):
        plant.advance(5.0, 5.0)
    return plant


def test_equations_1_and_2_keep_their_signs():
    """Eqs. (1) and (2)."""
    p = parameters.load()
    assert carriage.carriage_acceleration(300.0, 100.0, 20.0) == 10.0
    assert carriage.positioner_contraction(0.05, p.rig) == pytest.approx(p.rig.position_offset - 0.05)


def test_both_muscles_pull_equally_when_the_carriage_rests():
    """Where the carriage rests the forces of Eq. (7) balance."""
    truth = settled().truth()
    assert abs(truth.velocity) < 1e-4
    assert truth.specimen_force > 50.0, "both muscles must be taut"
    friction = 2.0 + 0.5
    assert truth.specimen_force == pytest.approx(truth.positioner_force, abs=friction)


def test_a_weight_hangs_in_place_of_the_mas_40():
    plant = settled(weight=20.0, volts=(6.0, 5.0))
    assert plant.truth().specimen_force == pytest.approx(20.0 * GRAVITY, abs=3.0)


def test_a_hand_holds_the_carriage_where_it_wants():
    plant = rig.RigPlant(parameters.load(), "dmsp_20", weight=20.0)
    for _ in range(500):
        plant.advance(5.0, 5.0, hand=0.03)
    assert plant.truth().position == pytest.approx(0.03, abs=2e-3)


def test_the_mas_40_is_four_times_a_dmsp_20():
    p = parameters.load()
    small, large = p.muscle.dmsp_20, p.muscle.mas_40
    for relative in (0.02, 0.1, 0.2):
        one = float(muscle.geometric_force(relative * small.length, 4e5, small))
        four = float(muscle.geometric_force(relative * large.length, 4e5, large))
        assert four == pytest.approx(4 * one, rel=1e-9)


@pytest.mark.parametrize("accuracy", [0.0, 5.0, 50.0])
def test_the_load_cell_errs_within_its_class(accuracy):
    plant = settled({"plant.rig.load_cell.accuracy": accuracy}, volts=(7.0, 7.0))
    errors = [plant.measure().force - plant.truth().specimen_force for _ in range(300)]
    assert np.abs(errors).max() <= accuracy + 1e-9
    assert np.std(errors) == pytest.approx(0.04 * accuracy, rel=0.3)


def test_sensors_without_noise_show_the_truth():
    plant = settled(QUIET | {"plant.rig.load_cell.accuracy": 0.0})
    measured, truth = plant.measure(), plant.truth()
    expected = (truth.position, truth.specimen_pressure, truth.positioner_pressure, truth.specimen_force)
    assert measured == pytest.approx(expected, rel=1e-12)


def test_the_calliper_sees_the_braid_swell():
    plant = settled()
    thin = np.mean([plant.calliper().diameter for _ in range(20)])
    nominal = parameters.load().muscle.dmsp_20.geometry.diameter
    assert thin > 1.1 * nominal


def test_carriage_friction_is_an_effect_that_can_be_switched_off():
    def force(enabled):
        overrides = {"plant.rig.effects.carriage_friction.enabled": enabled}
        hardware = rig.true_hardware(parameters.load(overrides), rig.with_specimen("dmsp_20"))
        return assemble(hardware).signals.effort

    assert force(True).n_dep() != force(False).n_dep() or str(force(True)) != str(force(False))


def test_a_voltage_that_is_not_finite_is_refused():
    plant = rig.RigPlant(parameters.load(), "dmsp_10")
    with pytest.raises(OrthosisError, match="not finite"):
        plant.advance(math.nan, 5.0)


def test_composed_volume_of_a_plain_cylinder_and_of_a_cone():
    """Eq. (15) where it is known without it."""
    assert muscle.composed_volume(0.02, 0.3, 0.0, 0.02) == pytest.approx(math.pi * 0.01**2 * 0.3)
    cone = math.pi / 3 * 0.02**2 * 0.1
    assert muscle.composed_volume(0.04, 0.0, 0.1, 0.0) == pytest.approx(2 * cone)
