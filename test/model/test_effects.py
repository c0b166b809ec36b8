# SPDX-License-Identifier: Apache-2.0
"""Every effect of the catalogue: it acts, it can be neutral, it keeps its bounds, it documents itself."""

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
import yaml

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model import integrate
from pam_orthosis.model.assembly import assemble
from pam_orthosis.model.components import pneumatics
from pam_orthosis.model.effects import pade, valves
from pam_orthosis.model.effects.base import STAGES
from pam_orthosis.model.effects.muscles import WHOLE_PRESSURE
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load, scenario_names
from pam_orthosis.model.plant import Plant, true_hardware
from pam_orthosis.model.rows import Section

PERIOD, SUBSTEPS, PERIODS = 2.0e-3, 20, 150
NONE = {f"plant.effects.{name}.enabled": False for name in KNEE.catalogue}
UNITS = {
    "-", "N m", "N m s/rad", "rad/s", "N", "m", "N s/m", "N/m", "s", "N m/rad", "rad", "kg", "Hz", "V",
    "kg/(s Pa)", "Pa s/kg", "m^3", "K", "Pa", "1/rad^2",
}  # fmt: skip
every = pytest.mark.parametrize("effect", KNEE.catalogue.values(), ids=KNEE.catalogue.keys())


def simulate(settings):
    """Swing the knee by opposed valve voltages; returns (periods, 3) noise-free measurements."""
    parameters = load({**NONE, "scenario.start_angle": 0.6, **settings})
    assembly = assemble(true_hardware(parameters))
    steps = integrate.steps_map("swing", assembly.function("rates"), SUBSTEPS)
    time = np.arange(PERIODS) * PERIOD
    swing = 0.8 * np.sin(2 * np.pi * 5 * time)
    torque = np.zeros(PERIODS)
    u = np.array([5 + swing + 0.25, 5 - swing + 0.2, torque, time])
    start = np.zeros(len(assembly.states))
    start[:4] = 0.6, 0.0, 3.9e5, 3.3e5
    x = np.array(steps.mapaccum(PERIODS)(start, np.tile(u, (SUBSTEPS, 1)), PERIOD / SUBSTEPS))
    measured = ca.Function("measured", [assembly.x, assembly.u], [assembly.measured])
    return np.array(measured.map(PERIODS)(x, u)).T


@pytest.fixture(scope="module")
def plain():
    return simulate({})


def switched_on(effect, **values):
    keys = {"enabled": True, **values}
    return {f"plant.effects.{effect.name}.{key}": value for key, value in keys.items()}


def difference(measured, plain):
    """Return the largest difference in units of the sensors' noise."""
    return float(np.max(np.abs(measured - plain) / [3.5e-4, 500.0, 500.0]))


@every
def test_it_acts_when_on_and_not_when_off(effect, plain):
    acting = simulate(switched_on(effect))
    assert np.isfinite(acting).all()
    assert difference(acting, plain) > 0.2
    off = simulate({f"plant.effects.{effect.name}.{q.name}": q.typical for q in effect.parameters})
    assert np.array_equal(off, plain)


@every
def test_it_vanishes_at_its_neutral_value(effect, plain):
    neutral = {q.name: q.neutral for q in effect.parameters if q.neutral is not None}
    if neutral:
        assert difference(simulate(switched_on(effect, **neutral)), plain) < 1e-6
        return
    # a delay or a lag has no value at which it is gone: it fades towards a bound
    size = effect.parameters[0]
    faint = size.maximum if effect.name == "valve_lag" else size.minimum
    typical = difference(simulate(switched_on(effect)), plain)
    assert difference(simulate(switched_on(effect, **{size.name: faint})), plain) < 0.4 * typical


@every
def test_it_keeps_its_bounds(effect):
    for q in effect.parameters:
        assert q.minimum <= q.typical <= q.maximum
        for beyond in (q.minimum - 1e-3 * abs(q.minimum) - 1e-9, q.maximum * 1.001 + 1e-9):
            with pytest.raises(OrthosisError, match="outside"):
                load({f"effects.{effect.name}.{q.name}": beyond})
    quantities = {q.name: q for q in effect.parameters}
    for start in effect.starts:
        assert all(quantities[name].minimum <= v <= quantities[name].maximum for name, v in start.items())


@every
def test_it_documents_itself(effect):
    assert effect.stage in STAGES
    assert len(effect.physics) > 60
    assert effect.physics.endswith(".")
    assert effect.source
    assert len(effect.states) == len(effect.scales)
    assert effect.fitted, "nothing to estimate"
    assert effect.minimum_effect > 0
    for q in effect.parameters:
        assert q.meaning
        assert q.unit in UNITS
        assert (q.prior is not None) == effect.shape
    assert set(effect.confounded_with) <= set(KNEE.catalogue) - {effect.name}
    assert effect.separated_by
    assert set(effect.separated_by) <= set(scenario_names())


@every
def test_its_coordinate_is_a_signal(effect):
    settings = {**NONE, **switched_on(effect)}
    signals = assemble(true_hardware(load(settings))).signals
    assert effect.coordinate in signals.named("angle", "torque")


@every
@pytest.mark.parametrize("prefix", ["effects", "plant.effects"])
def test_it_survives_a_yaml_file(effect, prefix):
    overrides = {f"{prefix}.{effect.name}.enabled": True}
    overrides |= {f"{prefix}.{effect.name}.{q.name}": q.typical for q in effect.parameters}
    section = load(yaml.safe_load(yaml.safe_dump(overrides)))
    for part in (*prefix.split("."), effect.name):
        section = getattr(section, part)
    assert section.enabled is True
    assert all(getattr(section, q.name) == q.typical for q in effect.parameters)


WANTED = """joint_friction viscous_friction muscle_hysteresis pressure_dependent_damping
    direction_dependent_damping creep parallel_elasticity extra_foot_mass backlash stretch_reflex
    constant_torque periodic_torque extensor_force_scale flexor_force_scale force_map_misfit
    valve_curve_misfit volume_misfit valve_dead_band extensor_valve_gain flexor_valve_gain valve_lag
    valve_delay extensor_leak flexor_leak hose_resistance extensor_dead_volume flexor_dead_volume
    polytropic_exponent supply_sag temperature_drift angle_offset angle_gain angle_delay
    extensor_pressure_offset extensor_pressure_gain extensor_pressure_delay
    flexor_pressure_offset flexor_pressure_gain flexor_pressure_delay"""


def test_the_catalogue_is_the_issues():
    assert " ".join(sorted(KNEE.catalogue)) == " ".join(sorted(WANTED.split()))


def test_all_effects_at_once_still_simulate():
    assert np.isfinite(simulate(dict.fromkeys(NONE, True))).all()


@pytest.mark.parametrize("effect", ["angle_delay", "extensor_pressure_delay"])
def test_a_delay_is_late_by_its_value(effect, plain):
    """Shifting the undelayed measurement by the delay gives the delayed one, once the start is past."""
    delay, column = 2 * PERIOD, 0 if effect == "angle_delay" else 1
    late = simulate({f"plant.effects.{effect}.enabled": True, f"plant.effects.{effect}.delay": delay})[
        :, column
    ]
    whole = np.ptp(plain[:, column])
    assert np.abs(late[12:] - plain[10:-2, column]).max() < 1e-3 * whole
    assert np.abs(late[12:] - plain[12:, column]).max() > 0.02 * whole


def test_a_late_sensor_shows_the_drop_of_its_hose_late_too():
    def measured(**more):
        settings = switched_on(KNEE.catalogue["hose_resistance"], resistance=2e7) | more
        return simulate(settings)[:, 1]

    delay = {"plant.effects.extensor_pressure_delay.delay": 2 * PERIOD}
    late = measured(**{"plant.effects.extensor_pressure_delay.enabled": True, **delay})
    on_time, drop = measured(), measured() - simulate({})[:, 1]
    assert np.ptp(drop[12:]) > 2e4
    assert np.abs(late[12:] - on_time[10:-2]).max() < 0.02 * np.ptp(drop[12:])


@pytest.mark.parametrize("turn", [0.1, 0.5, 1.0, 2.0, 2.5])
def test_the_delays_approximation_has_its_phase(turn):
    """Response of the chain at the frequency where the delay is `turn` radians."""
    states, value, delay = ca.SX.sym("z", 3), ca.SX.sym("v"), 0.004
    rates = ca.vertcat(*pade.chain(ca.vertsplit(states), value, delay))
    output = pade.delayed(ca.vertsplit(states))
    a, b, c = (
        np.array(ca.DM(ca.jacobian(*pair))) for pair in ((rates, states), (rates, value), (output, states))
    )
    response = complex((c @ np.linalg.solve(1j * turn / delay * np.eye(3) - a, b))[0, 0])
    assert np.angle(response) == pytest.approx(-turn, abs=0.01 * turn)
    assert abs(response) == pytest.approx(1.0, abs=0.1)


def test_sensor_effects_reach_the_plants_measurement():
    noise = dict.fromkeys(("angle_noise", "angle_resolution", "pressure_noise", "pressure_resolution"), 0.0)
    settings = {**NONE, **{f"plant.sensor.{name}": value for name, value in noise.items()}}
    settings |= {"plant.effects.angle_offset.enabled": True, "plant.effects.angle_offset.offset": 0.03}
    settings |= {"plant.effects.flexor_pressure_gain.enabled": True}
    plant = Plant(load(settings))
    measured, truth, ambient = plant.measure(), plant.truth(), load().valve.ambient_pressure
    assert measured.angle == pytest.approx(truth.angle + 0.03)
    assert measured.flexor_pressure - ambient == pytest.approx(1.03 * (truth.flexor_pressure - ambient))
    assert measured.extensor_pressure == pytest.approx(truth.extensor_pressure)


def test_shape_corrections_are_bounded():
    """No term of the force map exceeds its coefficient, however far out the muscle is."""
    effect = KNEE.catalogue["force_map_misfit"]
    section = load({**NONE, **switched_on(effect)})
    signals = assemble(true_hardware(section)).signals
    values = {q.name: 0.0 for q in effect.parameters} | {"extensor_c21": 5.0}
    extensor, flexor = signals.actuators.values()
    before = extensor.force, flexor.force
    effect.enter(signals, Section("values", values), ())
    assert ca.is_equal(flexor.force, before[1])
    force = extensor.force - before[0]
    inputs = [signals.coordinate, extensor.pressure]
    function = ca.Function("f", inputs, [force])
    extreme = [abs(float(function(q, p))) for q in (-3.0, 0.2, 0.9, 4.0) for p in (0.0, 2e5, 5e5, 9e5)]
    assert max(extreme) <= 5.0 + 1e-9
    assert max(extreme) > 2.0


def test_the_valves_correction_reaches_from_wide_vent_to_wide_fill():
    openings = np.linspace(-1.0, 1.0, 201)
    ones = [1.0] * (2 * valves.SIDE + 1)
    weight = np.array([float(valves.relative_error(o, ones)) for o in openings])
    assert weight.min() > 0.8 * weight.max()


@pytest.mark.parametrize(("resistance", "turbulent", "off"), [(4e6, 0.0, 5e-4), (1.4e6, 0.3, 3e-3)])
@pytest.mark.parametrize("opening", [-1.0, 0.2, 0.5])
def test_valve_and_hose_agree_upon_a_flow(resistance, turbulent, off, opening):
    """m = flow(p + drop(m)); at 2 g/s the drop is the resistance's, whatever its kind."""
    valve, p = load().valve, ca.SX.sym("p")
    alone = pneumatics.valve_flow(opening, p, valve.supply_pressure, valve)
    air = SimpleNamespace(supply_pressure=valve.supply_pressure)
    signals = SimpleNamespace(opening=ca.SX(opening), pressure=p, valve=valve, air=air, flow=alone)
    section = Section("hose", {"resistance": resistance, "turbulent": turbulent})
    on = KNEE.catalogue["hose_resistance"].expression(signals, section, ()).add
    pressures = np.linspace(1.2e5, valve.supply_pressure - 1e3, 9)
    flow, drop, unhindered = (
        ca.Function("f", [p], [one])(pressures[None]).full()[0]
        for one in (alone + on["flow"], on["line_drop"], alone)
    )
    at_valve = ca.Function("f", [p], [alone])((pressures + drop)[None]).full()[0]
    assert flow == pytest.approx(at_valve, rel=off)
    assert drop == pytest.approx(resistance * flow * (1 - turbulent + turbulent * np.abs(flow) / 2e-3))
    assert np.abs(flow - unhindered).max() > 3 * off * np.abs(flow).max()


def test_a_leak_through_a_hole_passes_what_a_gap_does_at_3_bar_and_chokes_above():
    def lost(pressure, **leak):
        settings = {**NONE, **(switched_on(KNEE.catalogue["extensor_leak"], **leak) if leak else {})}
        assembly = assemble(true_hardware(load(settings)))
        x = np.zeros(len(assembly.states))
        x[:4] = 0.6, 0.0, pressure, 2e5
        rates = ca.Function("rates", [assembly.x, assembly.u], [assembly.rates])
        return -float(rates(x, np.array([5.0, 5.0, 0.0, 0.0]))[2])

    def leaks(gauge):
        pressure = load().valve.ambient_pressure + gauge
        closed = lost(pressure)
        return [lost(pressure, coefficient=1e-9, hole=hole) - closed for hole in (0.0, 1.0)]

    gap, hole = leaks(3e5)
    assert gap > 0
    assert hole == pytest.approx(gap)
    (low_gap, low_hole), (high_gap, high_hole) = leaks(1e5), leaks(5e5)
    assert low_hole > 1.2 * low_gap
    assert high_hole < 0.95 * high_gap


def slid(contraction, lengths):
    """Return the force (n,), of unit half width, of elements that stick over lengths (k,), m."""
    anchors, forces = np.full(len(lengths), contraction[0]), []
    for x in contraction:
        anchors = np.clip(anchors, x - lengths, x + lengths)
        forces.append(np.mean((x - anchors) / lengths))
    return np.array(forces)


def wound(rate, period, distance, far_share):
    """Return the force (n,), of unit half width, that the catalogue has for a rate of contraction (n,)."""
    z, v = ca.SX.sym("z", 2), ca.SX.sym("v")
    values = {"half_width": -1.0, "offset_share": 0.4}
    section = SimpleNamespace(**values, sliding_distance=distance, far_share=far_share)
    signals = SimpleNamespace(rate=v, gauge=WHOLE_PRESSURE)
    made = KNEE.catalogue["muscle_hysteresis"].expression(signals, section, ca.vertsplit(z))
    step = ca.Function("step", [z, v], [z + period * ca.vertcat(*made.rates), made.add["force"]])
    return np.array(step.mapaccum(len(rate))(np.zeros(2), rate[None, :])[1]).ravel()


@pytest.mark.parametrize(
    ("shortest", "longest", "fibres"), [(2e-4, 2.2e-3, 5), (1e-4, 2e-3, 20), (3e-4, 2e-3, 3)]
)
def test_a_hysteresis_comes_near_to_fibres_that_slide_one_after_another(shortest, longest, fibres):
    """What the form of a large one leaves over was named a friction of the joint."""
    time, period = np.arange(0.0, 4.0, 2e-4), 2e-4
    contraction = 5e-3 * np.sin(5.0 * time) + 1e-3 * np.sin(17.0 * time) + 3e-4 * np.sin(41.0 * time)
    rate, wanted = (
        np.gradient(contraction, period),
        slid(contraction, np.geomspace(shortest, longest, fibres)),
    )

    def left(distance, far_share):
        force = wound(rate, period, distance, far_share)
        force *= (force @ wanted) / (force @ force)
        return np.sqrt(np.mean((force - wanted) ** 2) / np.mean(wanted**2))

    one = min(left(distance, 0.0) for distance in np.geomspace(2e-4, 2e-3, 12))
    two = min(left(distance, 0.45) for distance in np.geomspace(2e-4, 2e-3, 12))
    assert two < 0.5 * one
    assert two < 0.08


def driven(name, own, channel, values, step, **settings):
    """Return what an effect with so many states adds, (n,), where a signal has these values."""
    effect, signal = KNEE.catalogue[name], ca.SX.sym("signal")
    section = Section(name, {q.name: q.typical for q in effect.parameters} | settings)
    states = ca.SX.sym("states", own)
    on = effect.expression(SimpleNamespace(**{channel: signal}), section, tuple(ca.vertsplit(states)))
    (added,), x, found = on.add.values(), np.zeros(own), []
    rates = ca.Function("rates", [states, signal], [ca.vertcat(*on.rates)])
    shown = ca.Function("shown", [states, signal], [added])
    for value in values:
        found.append(float(shown(x, value)))
        x = x + step * rates(x, value).full().ravel()
    return np.array(found)


def test_a_reflex_answers_after_a_dead_time_or_with_a_lag():
    step, lag = 1e-4, 0.04
    time = step * np.arange(4000)
    velocity = 1.0 + np.clip(time / 0.1, 0, 1)  # a ramp of 0.1 s to 1 rad/s above the threshold
    lagged, late, both = (
        driven("stretch_reflex", 4, "velocity", velocity, step, gain=2.0, lag=lag, dead=share)
        for share in (0.0, 1.0, 0.25)
    )
    ramp = np.clip((time - lag) / 0.1, 0, 1)
    assert late == pytest.approx(-2.0 * ramp, abs=0.06)  # 3 %, at the kinks of the ramp
    assert np.abs(lagged + 2.0 * ramp).max() > 0.25
    assert lagged[600] == pytest.approx(-2.0 * (0.6 - 0.4 * (1 - np.exp(-1.5))), abs=0.01)
    assert both == pytest.approx(0.75 * lagged + 0.25 * late)
    flexing, stretching = (
        driven("stretch_reflex", 4, "velocity", sign * velocity, step, gain=2.0, lag=lag, one_sided=1.0)
        for sign in (1, -1)
    )
    assert flexing == pytest.approx(2 * lagged)
    assert not stretching.any()


def test_a_spring_hardens_and_may_pull_on_one_side_alone():
    def pulls(angle, **settings):
        p = Section(
            "spring", {"stiffness": 2.0, "rest_angle": 0.5, "hardening": 0.0, "one_sided": 0.0} | settings
        )
        on = KNEE.catalogue["parallel_elasticity"].expression(SimpleNamespace(coordinate=angle), p, ())
        return float(on.add["effort"])

    assert pulls(0.9) == pytest.approx(-0.8)
    assert pulls(0.1, hardening=5.0) == pytest.approx(0.8 * 1.8)
    assert pulls(0.9, one_sided=1.0) == pytest.approx(-1.6)
    assert pulls(0.1, one_sided=1.0) == 0.0


def test_a_share_of_a_muscle_creeps_four_times_as_slowly():
    step, time_constant = 1e-3, 0.5
    rate = np.zeros(3000)
    rate[0] = 0.01 / step  # it is stretched by 10 mm at once
    found = driven("creep", 2, "rate", rate, step, stiffness=600.0, time_constant=time_constant, slow=0.3)
    since = step * np.arange(2999)
    fast, slow = np.exp(-since / time_constant), np.exp(-since / (4 * time_constant))
    assert found[1:] == pytest.approx(-6.0 * (0.7 * fast + 0.3 * slow), abs=0.01)
