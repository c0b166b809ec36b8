# SPDX-License-Identifier: Apache-2.0
"""Damping from free decays, Eq. (18), with and without dry friction."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pam_orthosis.bag.rig_record import record_rig
from pam_orthosis.control.rig_loop import DecayRig
from pam_orthosis.errors import OrthosisError
from pam_orthosis.identification import damping
from pam_orthosis.identification import data as reading
from pam_orthosis.identification.data import Decay
from pam_orthosis.identification.measured import table_parts
from pam_orthosis.model import parameters

MASS, STIFFNESS, D = 70.0, 25e3, 150.0


def oscillation(dry=0.0, sliding=1e-3):
    """Return the decay of a linear oscillator with an elastic sliding element, noise-free."""
    time = np.arange(0, 3.0, 0.002)

    def rates(_t, y):
        slide = max(-1.0, min(1.0, y[2]))
        stuck = not (abs(y[2]) >= 1 and y[2] * y[1] > 0)
        return [y[1], (-STIFFNESS * y[0] - D * y[1] - dry * slide) / MASS, y[1] / sliding * stuck]

    y = solve_ivp(rates, (0, 3), [-0.02, 0, 0], t_eval=time, max_step=5e-4, rtol=1e-7, atol=1e-9).y
    force = 500 - STIFFNESS * y[0] - D * y[1] - dry * np.clip(y[2], -1, 1)
    pressure = 3e5 + 1e6 * y[0] + 1e8 * y[0] ** 2
    return Decay(time, 0.05 + y[0], pressure, force, MASS)


def test_the_decrement_of_a_linear_oscillator_is_its_damping():
    """Eq. (18)."""
    value, period = damping.decrement(oscillation())
    assert value == pytest.approx(D, rel=0.03)
    natural = np.sqrt(STIFFNESS / MASS - (D / (2 * MASS)) ** 2)
    assert period == pytest.approx(2 * np.pi / natural, rel=0.01)


def test_dry_friction_counts_as_damping_in_the_decrement_but_not_in_the_viscous_part():
    decay = oscillation(dry=12.0)
    assert damping.decrement(decay)[0] > 1.2 * D
    value, residual = damping.viscous_part(decay)
    assert value == pytest.approx(D, rel=0.05)
    assert residual < 2.0


def test_a_slip_element_sticks_then_slides():
    path = np.concatenate([np.linspace(0, 3e-3, 300), np.linspace(3e-3, 0, 300)])
    state = damping.slip_element(path, 1e-3)
    assert state[99] == pytest.approx(1.0, abs=0.02)
    assert state[299] == pytest.approx(1.0)
    assert state[-1] == pytest.approx(-1.0)
    assert state[400] == pytest.approx(1 - (3e-3 - path[400]) / 1e-3, abs=0.02)


@pytest.mark.parametrize("specimen", ["dmsp_20", "dmsp_10"])
def test_the_emulated_muscles_damping_is_found_within_ten_per_cent(specimen):
    p = parameters.load()
    settings, decays = getattr(p.rig.decay, specimen), []
    for seed, pressure in enumerate(settings.pressures):
        m = [(s.time_ns * 1e-9, *s.measured) for s in DecayRig(p, specimen, seed).run(pressure)]
        time, position, specimen_pressure, _, force = np.array(m).T
        gauge = specimen_pressure - p.valve.ambient_pressure
        decays.append(Decay(time, position, gauge, force, p.rig.carriage_mass + settings.weight))
    found = damping.fit_damping(decays)
    true = getattr(p.plant.rig, specimen).damping
    assert found.value == pytest.approx(true, rel=0.1)
    assert found.decrement > 1.3 * true, "the braid's friction must be there to be told apart"


@pytest.mark.parametrize(
    "wrong",
    [
        lambda d: replace(d, mass=2 * d.mass),
        lambda d: replace(d, mass=0.6 * d.mass),
        lambda d: replace(d, time=1e3 * d.time),
    ],
)
def test_what_swings_has_the_mass_that_is_stated(wrong):
    decay = oscillation(dry=12.0)
    damping.check_mass(decay)
    with pytest.raises(OrthosisError, match=r"by force and acceleration .* kg swing in this decay"):
        damping.fit_damping([wrong(decay)])
    damping.check_mass(replace(wrong(decay), force=None))  # nothing shows it


def test_without_a_force_the_period_shows_the_unit_of_time():
    decay, around = replace(oscillation(), force=None), np.array([0.5, 2.0]) * STIFFNESS
    damping.check_period(decay, around)
    for factor in (1e3, 1e-3):
        with pytest.raises(OrthosisError, match="check the moved mass and the unit of time"):
            damping.check_period(replace(decay, time=factor * decay.time), around)


def test_a_record_without_an_oscillation_is_refused():
    time = np.arange(0, 1, 0.002)
    still = Decay(time, 0.05 + 1e-3 * np.exp(-time), np.full(500, 3e5), np.full(500, 400.0), MASS)
    with pytest.raises(OrthosisError, match="swings"):
        damping.decrement(still)


def held_first(decay, samples):
    """Return a decay whose first sample is held so long before the release, with noise on the position."""
    noise = 1e-5 * np.random.default_rng(3).standard_normal(samples + len(decay.time))
    columns = {
        name: np.concatenate([np.full(samples, getattr(decay, name)[0]), getattr(decay, name)])
        for name in ("position", "pressure", "force")
    }
    columns["position"] += noise
    return Decay(0.002 * np.arange(len(noise)), mass=decay.mass, **columns)


@pytest.mark.parametrize("samples", [0, 50, 200, 700])
def test_a_hold_before_the_release_does_not_count(samples):
    decay = oscillation(dry=12.0)
    late = held_first(decay, samples)
    assert damping.turning_points(late)[0] == pytest.approx(samples, abs=4)
    for found, expected in zip(damping.decrement(late), damping.decrement(decay), strict=True):
        assert found == pytest.approx(expected, rel=0.02)
    assert damping.viscous_part(late)[0] == pytest.approx(D, rel=0.05)


def test_a_decay_at_constant_pressure_needs_no_terms_of_the_pressure():
    decay = oscillation()
    constant = replace(decay, pressure=np.full_like(decay.pressure, 3e5))
    assert damping.viscous_part(constant)[0] == pytest.approx(D, rel=0.02)


def test_a_decay_without_a_force_gives_all_losses_together():
    decay = oscillation(dry=12.0)
    found = damping.fit_damping([replace(decay, force=None)])
    assert (found.value, found.apart) == (found.decrement, False)
    assert found.decrement == damping.fit_damping([decay]).decrement
    assert damping.fit_damping([decay]).apart


@pytest.mark.parametrize("column", ["", ",F_N"])
def test_a_table_of_a_decay_needs_no_force_and_swings_about_any_contraction(tmp_path, column):
    time, mass = 0.002 * np.arange(600), 20.0
    x = 0.048 + 0.008 * np.exp(-3.0 * time) * np.cos(15.0 * time)
    rows = [time, np.full(600, 3e5), 0.3 - x, np.full(600, mass), *([np.full(600, 196.0)] if column else [])]
    path = tmp_path / "decay.csv"
    header = f"t_s,p_Pa_gauge,L_m,m_kg{column}"
    np.savetxt(path, np.column_stack(rows), delimiter=",", header=header, comments="")
    decay = table_parts(path, 0.3, 1.013e5, 0).decay
    assert decay.force is None
    assert damping.fit_damping([decay]).value == pytest.approx(2 * mass * 3.0, rel=0.03)


@pytest.mark.parametrize("samples", [10, 99])
def test_a_decay_of_few_samples_is_refused(samples):
    decay = oscillation()
    columns = ("time", "position", "pressure", "force")
    short = replace(decay, **{name: getattr(decay, name)[:samples] for name in columns})
    with pytest.raises(OrthosisError, match=f"holds {samples} samples; at least 100"):
        damping.fit_damping([short])


def test_a_decay_with_a_gap_is_refused(tmp_path):
    p = parameters.load()
    samples = list(DecayRig(p, "dmsp_20", 1).run(4e5))
    record_rig(tmp_path / "whole", p, "dmsp_20", "decay", samples)
    record_rig(tmp_path / "gap", p, "dmsp_20", "decay", samples[:300] + samples[340:])
    assert len(reading._decay(tmp_path / "whole", "dmsp_20", p).time) == len(samples)
    with pytest.raises(OrthosisError, match=r"not uniform in time, first at 0\.598"):
        reading._decay(tmp_path / "gap", "dmsp_20", p)
