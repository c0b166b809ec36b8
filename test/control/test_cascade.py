# SPDX-License-Identifier: Apache-2.0
"""Observer and controllers against their own claims."""

import math

import casadi as ca
import numpy as np
import pytest

from pam_orthosis.control import inverse_valve, observer, position, pressure
from pam_orthosis.control.axis import Axis
from pam_orthosis.control.reference import Reference
from pam_orthosis.model import parameters
from pam_orthosis.model.components import muscle as muscle_model
from pam_orthosis.model.components import pneumatics
from pam_orthosis.model.components.actuator import volume_terms

RANDOM = np.random.default_rng(11)
STATES = np.column_stack([
    RANDOM.uniform(0.1, 1.3, 60), RANDOM.uniform(-4, 4, 60), RANDOM.uniform(-8, 8, 60)
])  # fmt: skip
PRESSURES = RANDOM.uniform(2.6e5, 5.5e5, (60, 2))


@pytest.fixture(scope="module")
def nominal():
    return parameters.load().nominal()


def test_observer_poles_lie_where_they_were_placed(nominal):
    """Eigenvalues of A - h c, the Jacobian of Eq. (32) taken by differences, not by CasADi."""
    x, p = ca.SX.sym("x", 3), ca.SX.sym("p", 2)
    f = ca.Function("f", [x, p], [observer.system(x, p, Axis(nominal))])
    polynomial = observer.characteristic(100.0, 0.5)
    h = ca.Function("h", [x, p], [observer.gains(x, p, polynomial, Axis(nominal))])
    for state, held in zip(STATES, PRESSURES, strict=True):
        a = np.column_stack([
            (f(state + d, held).full()[:, 0] - f(state - d, held).full()[:, 0]) / 2e-6
            for d in 1e-6 * np.eye(3)
        ])  # fmt: skip
        error_system = a - h(state, held).full() @ [[1.0, 0.0, 0.0]]
        poles = np.sort_complex(np.linalg.eigvals(error_system))
        pair = 100.0 * np.exp(2j * np.pi / 3)
        assert poles == pytest.approx([-100.0, pair.conjugate(), pair], rel=1e-3)


def test_a_disturbance_is_estimated_late_by_the_sum_of_the_poles_time_constants():
    for damping in (1.0, 0.5):
        _, by_rate, constant = observer.characteristic(110.0, damping)
        assert by_rate / constant == pytest.approx((1 + 2 * damping) / 110.0)
    assert np.roots([1.0, *observer.characteristic(110.0, 1.0)]) == pytest.approx([-110.0] * 3, rel=1e-4)


def test_observer_finds_velocity_and_a_constant_disturbance(nominal):
    """Fed by Eq. (28) under 2 N m, the estimate of Eqs. (29)-(31) must end at the true state."""
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p", 2)
    rate = Axis(nominal).acceleration(x[0], x[1], 2.0, (p[0], p[1]))
    f = ca.Function("f", [x, p], [ca.vertcat(x[1], rate)])
    period, state = nominal.scenario.control_period, ca.DM([0.8, 0.0])
    watch = observer.Observer(nominal)
    held = [3.3e5, 4.0e5]
    for _ in range(200):
        estimate = watch.step(float(state[0]), held)
        for _ in range(10):
            k1 = f(state, held)
            state = state + period / 10 * f(state + period / 20 * k1, held)
    assert estimate.disturbance == pytest.approx(2.0, abs=0.02)
    assert estimate.velocity == pytest.approx(float(state[1]), abs=0.01)


def test_lyapunov_function_of_the_position_loop_decreases(nominal):
    """V2-dot = -c1 e1^2 - c2 e2^2 for the wanted acceleration, Eqs. (33)-(37)."""
    c1, c2 = 31.0, 47.0
    for q, w, _ in STATES:
        reference = RANDOM.uniform([0.1, -4, -40], [1.3, 4, 40])
        acceleration = float(position.desired_acceleration([q, w, 0.0], reference, c1, c2))
        e1, e1_rate = reference[0] - q, reference[1] - w
        e2, e2_rate = e1_rate + c1 * e1, reference[2] - acceleration + c1 * e1_rate
        decrease = e1 * e1_rate + e2 * e2_rate
        assert decrease == pytest.approx(-c1 * e1**2 - c2 * e2**2, rel=1e-9)
        assert decrease < 0


def allocate(nominal, extensor_free=0.0, flexor_free=0.0):
    torque, q, w = (ca.SX.sym(n) for n in ("torque", "q", "w"))
    mean = nominal.control.position.mean_pressure
    asked = position.Demand(torque, q, w, mean, slack_share=(extensor_free, flexor_free))
    found = position.pressures_for_effort(asked, Axis(nominal))
    return ca.Function("allocate", [torque, q, w], [*found.pressures, found.missed])


def torque_of(nominal):
    q, w, extensor, flexor = (ca.SX.sym(n) for n in ("q", "w", "extensor", "flexor"))
    return ca.Function("torque", [q, w, extensor, flexor], [Axis(nominal).effort(q, w, (extensor, flexor))])


def test_the_pressures_give_the_torque_and_keep_their_mean(nominal):
    function, settings = allocate(nominal), nominal.control.position
    ambient = nominal.valve.ambient_pressure
    means = []
    for q, w, torque in STATES:
        extensor, flexor, saturated = (float(v) for v in function(torque, q, w))
        low, high = settings.minimum_pressure - ambient - 1e-6, settings.maximum_pressure - ambient + 1e-6
        assert low <= extensor <= high
        assert low <= flexor <= high
        if not saturated:
            given = float(torque_of(nominal)(q, w, extensor + ambient, flexor + ambient))
            assert given == pytest.approx(torque, abs=1e-6)
            means.append((extensor + flexor) / 2 + ambient)
    assert len(means) > 50
    assert np.isclose(means, settings.mean_pressure).mean() > 0.5


def given(nominal, q, w, extensor, flexor):
    """Return the torque of gauge pressures in the nominal model, N m."""
    ambient = nominal.valve.ambient_pressure
    return float(torque_of(nominal)(q, w, extensor + ambient, flexor + ambient))


def test_at_a_limit_stiffness_gives_way_before_torque(nominal):
    extensor, flexor, saturated = (float(v) for v in allocate(nominal)(20.0, 0.7, 0.0))
    assert not saturated
    mean = (extensor + flexor) / 2 + nominal.valve.ambient_pressure
    assert mean != pytest.approx(nominal.control.position.mean_pressure, rel=1e-3)
    assert given(nominal, 0.7, 0.0, extensor, flexor) == pytest.approx(20.0, abs=1e-6)


@pytest.mark.parametrize(("w", "sign"), [(3.4, 1), (-3.4, -1)])
def test_rid_of_the_other_one_a_muscle_reaches_further(nominal, w, sign):
    """On the way there the torque is at least the asked one; only what one alone cannot give is cut."""
    settings, ambient = nominal.control.position, nominal.valve.ambient_pressure
    slack, high = settings.minimum_pressure - ambient, settings.maximum_pressure - ambient
    reach = []
    for share in (0.0, 0.4, 1.0):
        function = allocate(nominal, *((0.0, share) if sign > 0 else (share, 0.0)))
        pairs = [(asked, *(float(v) for v in function(sign * asked, 0.7, w))) for asked in range(14, 40)]
        kept = [pair for pair in pairs if not pair[3]]
        torque = np.array([sign * given(nominal, 0.7, w, *pair[1:3]) for pair in kept])
        excess = torque - [pair[0] for pair in kept]
        assert (excess > -1e-6).all()
        assert (excess < (4.0 if share == 0.4 else 1e-6)).all()
        cut = [pair[1:3] for pair in pairs if pair[3]]
        assert all(max(pair) == pytest.approx(high) for pair in cut)
        if share == 1.0:
            assert all(min(pair[1:3]) == pytest.approx(slack) for pair in pairs)
        reach.append(kept[-1][0])
    assert reach[0] <= reach[1] < reach[2]


def test_a_muscle_is_slackened_slowly_and_only_when_the_other_one_needs_it():
    """A spike of the demand, as noise makes it, hardly slackens a muscle: it takes time to be taut again."""
    weak = parameters.load({"control.position.maximum_pressure": 4.6e5})
    controller, settings = position.PositionController(weak), weak.control.position
    change = weak.scenario.control_period / settings.slack_time
    easy, hard = Reference(0.7, 0.0, 0.0), Reference(0.7, 0.0, 90.0)

    def step(reference):
        """Return the extensor's pressure for a knee that is where it should be."""
        return controller._law((0.7, 0.0, 0.0), reference, settings.mean_pressure, controller._now, 1)[0][0]

    taut = step(easy)
    assert controller._slack_share == [0.0, 0.0]
    spike = [step(hard) for _ in range(2)]
    assert controller._slack_share == pytest.approx([0.0, 2 * change])
    assert min(spike) > settings.minimum_pressure + 0.5 * (taut - 1.3e5)
    for _ in range(round(2 / change)):
        last = step(hard)
    assert controller._slack_share == [0.0, 1.0]
    assert last == pytest.approx(settings.minimum_pressure)
    for _ in range(round(2 / change)):
        step(easy)
    assert controller._slack_share == [0.0, 0.0]


def test_a_muscle_that_shortens_fast_is_not_asked_for_more_than_it_has(nominal):
    """The torque of both tensions, cut at zero as muscles cut them, is the wanted one up to 8 rad/s."""
    function, ambient = allocate(nominal), nominal.valve.ambient_pressure
    for w in (-8.0, -4.0, 4.0, 8.0):
        extensor, flexor, saturated = (float(v) for v in function(math.copysign(12.0, w), 0.7, w))
        assert not saturated
        given = float(torque_of(nominal)(0.7, w, extensor + ambient, flexor + ambient))
        assert given == pytest.approx(math.copysign(12.0, w), abs=1e-6)


def test_a_torque_out_of_reach_is_cut_and_said(nominal):
    _, flexor, saturated = (float(v) for v in allocate(nominal)(200.0, 0.7, 0.0))
    assert saturated
    assert flexor + nominal.valve.ambient_pressure == pytest.approx(nominal.control.position.maximum_pressure)


def gas_rate(nominal, p, flow, q, w):
    """Return dp/dt of the flexor in the nominal model, by the forward law."""
    section, valve = nominal.muscle.dmsp_20, nominal.valve
    angle, velocity = ca.SX.sym("q"), ca.SX.sym("w")
    (_, contraction), (_, rate) = Axis(nominal).kinematics(angle, velocity)
    volume, by_p, by_x = volume_terms(
        lambda dl, gauge: muscle_model.volume(dl, gauge, section),
        contraction,
        p - valve.ambient_pressure,
    )
    found = pneumatics.pressure_rate(p, flow, rate, volume + valve.hose.volume, by_p, by_x, valve)
    return float(ca.Function("rate", [angle, velocity], [found])(q, w))


def test_pressure_law_gives_the_wanted_rate(nominal):
    flow = pressure.mass_flow_function(nominal, "flexor")
    for (q, w, _), (p, _) in zip(STATES, PRESSURES, strict=True):
        given = float(flow(p, 4e5, q, w, 0.0)[0])
        assert gas_rate(nominal, p, given, q, w) == pytest.approx(4e5, rel=1e-6)


def test_pressure_error_decays_with_the_designed_rate(nominal):
    controller = pressure.PressureController(parameters.load(), "flexor")
    assert controller.step(3e5, 3e5, 0.6, 0.0) == pytest.approx(0.0, abs=1e-12)
    flow = controller.step(2.9e5, 3e5, 0.6, 0.0)
    assert gas_rate(nominal, 2.9e5, flow, 0.6, 0.0) == pytest.approx(
        nominal.control.pressure.gain * 1e4, rel=1e-6
    )


def test_inverse_valve_inverts_the_valve(nominal):
    valve = nominal.valve
    for p in np.linspace(1.5e5, 6.5e5, 11):
        most, least = (float(pneumatics.valve_flow(o, p, valve.supply_pressure, valve)) for o in (1, -1))
        for flow in np.linspace(0.95 * least, 0.95 * most, 9):
            opening = float(inverse_valve.opening_for_flow(flow, p, valve))
            given = float(pneumatics.valve_flow(opening, p, valve.supply_pressure, valve))
            assert given == pytest.approx(flow, rel=1e-6, abs=1e-9)


def test_voltage_stays_in_range_and_lifts_over_the_dead_band():
    p = parameters.load()
    model = inverse_valve.InverseValveModel(p, "flexor")
    assert model.step(0.0, 3e5) == pytest.approx(p.valve.closed_voltage)
    assert model.step(1.0, 3e5) == p.valve.maximum_voltage
    assert model.step(-1.0, 3e5) == p.valve.minimum_voltage
    small = model.step(3e-4, 3e5) - p.valve.closed_voltage
    assert p.valve.dead_band < small < p.valve.dead_band + 1.0
    voltages = [model.step(flow, 3e5) for flow in np.linspace(-5e-3, 5e-3, 101)]
    assert (np.diff(voltages) > 0).all()
