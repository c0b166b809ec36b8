# SPDX-License-Identifier: Apache-2.0
"""Gas and valve."""

import casadi as ca
import numpy as np
import pytest

from pam_orthosis.model import parameters
from pam_orthosis.model.components import muscle, pneumatics
from pam_orthosis.model.components.actuator import volume_terms
from pam_orthosis.model.integrate import runge_kutta_4


@pytest.fixture
def valve():
    return parameters.load().valve


def test_choked_flow_depends_on_the_upstream_pressure_only(valve):
    flows = [float(pneumatics.orifice_flow(2e-8, 6e5, low, valve)) for low in (1e5, 1.5e5)]
    assert flows[0] == pytest.approx(flows[1])
    assert flows[0] == pytest.approx(2e-8 * 1.185 * 6e5)


def test_flow_reverses_and_vanishes_with_the_pressure_difference(valve):
    forward = float(pneumatics.orifice_flow(2e-8, 5e5, 4e5, valve))
    assert forward > 0
    assert float(pneumatics.orifice_flow(2e-8, 4e5, 5e5, valve)) == pytest.approx(-forward)
    assert float(pneumatics.orifice_flow(2e-8, 4e5, 4e5, valve)) == 0


@pytest.mark.parametrize("critical", [0.2, 0.3, 0.45])
def test_flow_function_is_continuous(critical):
    ratio = np.linspace(0, 1, 20001)
    psi = np.array([float(pneumatics.flow_function(r, critical)) for r in ratio])
    assert psi[0] == 1
    assert psi[-1] == 0
    assert np.abs(np.diff(psi)).max() < 2e-3
    assert (np.diff(psi) <= 1e-15).all()


@pytest.mark.parametrize(
    ("ratio", "critical", "share"), [(0.65, 0.3, 0.5), (0.44, 0.3, 0.2), (0.92, 0.2, 0.9)]
)
def test_subsonic_flow_is_a_quarter_of_an_ellipse(ratio, critical, share):
    """ISO 6358: psi^2 + ((r - b) / (1 - b))^2 = 1."""
    psi = float(pneumatics.flow_function(ratio, critical))
    assert psi**2 + share**2 == pytest.approx(1.0, abs=1e-12)


def test_valve_fills_vents_and_closes(valve):
    at = [float(pneumatics.valve_flow(o, 3e5, valve.supply_pressure, valve)) for o in (1.0, -1.0, 0.0)]
    assert at[0] > 0 > at[1]
    assert at[2] == pytest.approx(0, abs=1e-12)
    alone = float(pneumatics.orifice_flow(valve.conductance, valve.supply_pressure, 3e5, valve))
    assert at[0] < alone, "the hose in series must cost flow"


@pytest.mark.parametrize(("voltage", "opening"), [(0, -1), (2.5, -0.5), (5, 0), (10, 1), (12, 1)])
def test_relative_opening(valve, voltage, opening):
    assert float(pneumatics.relative_opening(voltage, valve)) == pytest.approx(opening)


def test_closed_muscle_follows_the_polytropic_law():
    """p V^n of Eq. (3) stays constant while a closed muscle is stretched, by its differential, Eq. (4)."""
    p = parameters.load()
    section, valve = p.muscle.dmsp_20, p.valve
    x = ca.SX.sym("x", 2)  # contraction, pressure
    volume, by_p, by_x = volume_terms(
        lambda dl, gauge: muscle.volume(dl, gauge, section), x[0], x[1] - valve.ambient_pressure
    )
    rate = pneumatics.pressure_rate(x[1], 0.0, 0.1, volume, by_p, by_x, valve)
    rates = ca.Function("rates", [x], [ca.vertcat(0.1, rate), volume])
    step = ca.Function("step", [x], [runge_kutta_4(lambda s: rates(s)[0], x, 1e-4)])
    start = ca.DM([0.02, 3e5])
    end = step.fold(5000)(start)
    volumes = [float(rates(state)[1]) for state in (start, end)]
    expected = 3e5 * (volumes[0] / volumes[1]) ** valve.polytropic_exponent
    assert volumes[1] > 1.2 * volumes[0]
    assert float(end[1]) == pytest.approx(expected, rel=1e-9)


def test_required_flow_inverts_the_pressure_rate(valve):
    """Eq. (6) forwards and backwards."""
    arguments = (-0.15, 2e-4, 3e-11, 2.6e-3, valve)
    flow = pneumatics.required_mass_flow(4e5, 7e5, *arguments)
    assert pneumatics.pressure_rate(4e5, flow, *arguments) == pytest.approx(7e5)


def test_stored_mass_matches_the_flow_of_an_isothermal_fill():
    """By Eq. (5) what flows in is what is there more."""
    valve = parameters.load({"valve.polytropic_exponent": 1.0}).valve
    rate = pneumatics.pressure_rate(3e5, 1e-3, 0.0, 2e-4, 0.0, 0.0, valve)
    gained = rate * 2e-4 / (pneumatics.GAS_CONSTANT * valve.temperature)
    assert gained == pytest.approx(1e-3)
