# SPDX-License-Identifier: Apache-2.0
"""Procedures of the rig: reference, pressure control, release, free decay."""

import numpy as np
import pytest

from pam_orthosis.control.rig_loop import DecayRig, Ramp, Rig, force_procedure, volume_procedure
from pam_orthosis.model import parameters


def test_a_ramp_is_smooth_and_stops_where_it_says():
    period, speed = 1e-3, 0.05
    ramp, rows = Ramp(25.0, period, 0.1), []
    for _ in range(1000):
        rows.append(ramp.step(speed))
    distance = ramp.stopping_distance
    start = ramp.reference.position
    rows += [ramp.step(0.0) for _ in range(2000)]
    assert ramp.reference.position - start == pytest.approx(distance, rel=1e-6)
    x, v, a, j = np.array(rows).T
    smooth = np.ones(len(x), dtype=bool)
    smooth[[0, 999, 1000, -1]] = False  # the third derivative jumps where the speed is commanded
    for value, slope in ((x, v), (v, a), (a, j)):
        assert np.abs(np.gradient(value, period) - slope)[smooth].max() < 0.02 * np.abs(slope).max()
    assert v[999] == pytest.approx(speed, rel=1e-6)


@pytest.fixture(scope="module")
def run():
    return list(force_procedure(Rig(parameters.load(), "dmsp_20", seed=3), 4e5))


def test_the_procedure_goes_from_zero_force_to_zero_contraction_and_back(run):
    position = np.array([s.measured.position for s in run])
    force = np.array([s.measured.force for s in run])
    assert position.max() > 0.07
    assert np.abs(position[-1] - position.max()) < 2e-3
    assert force.max() > 800
    assert force[-1] < 50


def test_the_pressure_is_held_to_a_tenth_of_a_bar_while_the_carriage_moves(run):
    settled = [s.measured.specimen_pressure for s in run if s.pressure_reference == 4e5][500:]
    assert np.abs(np.array(settled) - 4e5).max() < 1e4


def test_stamps_are_whole_steps(run):
    stamps = np.array([s.time_ns for s in run])
    assert (np.diff(stamps) == 2_000_000).all()


def test_the_same_seed_gives_the_same_run():
    def first():
        samples = Rig(parameters.load(), "dmsp_20", seed=5).rest(1.013e5, 0.2)
        return np.array([s.measured for s in samples])

    assert (first() == first()).all()


def test_the_calliper_is_put_on_at_each_station():
    rig = Rig(parameters.load({"rig.procedure.volume_stations": 3}), "dmsp_20", seed=1)
    read = [s for s in volume_procedure(rig, 2e5) if s.cylinder]
    assert len(read) == 3
    assert read[0].measured.position > read[1].measured.position > read[2].measured.position


def test_a_decay_swings_about_its_rest_with_closed_valves():
    samples = list(DecayRig(parameters.load(), "dmsp_20", seed=1).run(4e5))
    position = np.array([s.measured.position for s in samples])
    rest = position[-200:].mean()
    assert position[0] < rest - 0.015
    assert position.max() > rest + 0.008
    assert {s.voltages[0] for s in samples} == {5.0}
    assert samples[0].time_ns == 0
