# SPDX-License-Identifier: Apache-2.0
"""The replay engine against the one model, and what made false names before."""

import ast
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import casadi as ca
import numpy as np
import pytest

import pam_orthosis.discrepancy as package
from pam_orthosis.discrepancy.fitting.candidates import Trial, candidate
from pam_orthosis.discrepancy.fitting.fit import _descended, bounded_step, fit_tempered
from pam_orthosis.discrepancy.fitting.free import Free, free_parameters
from pam_orthosis.discrepancy.fitting.linearised import Linearised
from pam_orthosis.discrepancy.fitting.projection import Projection
from pam_orthosis.discrepancy.preparation import beginning
from pam_orthosis.discrepancy.recordings.data import Recording
from pam_orthosis.discrepancy.replay.kernel import Kernel, _key
from pam_orthosis.discrepancy.replay.lanes import Lanes
from pam_orthosis.discrepancy.replay.problem import Block
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.replay.run import Run, Shift
from pam_orthosis.discrepancy.replay.whitening import SEGMENT, minimum_phase, noise_levels
from pam_orthosis.discrepancy.systems import knee as knee_module
from pam_orthosis.discrepancy.systems.cut import cut
from pam_orthosis.model.mechanisms import leg as leg_model

CUTOFF = 40.0


@pytest.fixture(scope="module")
def run(bench):
    return Run(bench.system, bench.recording(1), CUTOFF)


def test_the_fitter_knows_neither_the_plant_nor_what_is_hidden():
    folder = Path(package.__file__).parent
    for file in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            for name in names:
                assert "hidden" not in name, file
                assert not name.endswith(("model.plant", "control.loop")), file


@pytest.mark.parametrize("person", [False, True])
def test_tabulated_mechanics_are_those_of_lagrange(bench, person):
    nominal = bench.parameters.changed({"leg.person.present": person})
    q, velocity = ca.SX.sym("q"), ca.SX.sym("velocity")
    table = knee_module.tabulated_leg(nominal)(0.0, 0.0)
    near, exact = table(q, velocity, None, 0.7), leg_model.mechanics(q, velocity, nominal.leg, 0.7)
    terms = ("inertia", "coriolis", "gravity")
    difference = ca.Function("d", [q, velocity], [getattr(near, t) - getattr(exact, t) for t in terms])
    for angle in np.linspace(-0.2, 1.7, 60):
        assert max(abs(float(value)) for value in difference(angle, 2.0)) < 2e-9


@pytest.mark.parametrize("name", ["joint_friction", "valve_lag"])
def test_an_effect_of_the_model_is_replayed_as_one_that_was_just_found(bench, run, name):
    values = bench.replay.defaults((name,))
    stiff = {"joint_friction.bristles": 0.8, "joint_friction.presliding": 0.002}
    changed = {key: stiff.get(key, value) for key, value in values.items() if key.startswith(f"{name}.")}
    settings = {f"effects.{key}": value for key, value in changed.items()} | {f"effects.{name}.enabled": True}
    known = Replay(knee_module.knee(bench.parameters.changed(settings)))
    assert name not in known.system.candidates
    assert name in known.system.bare().candidates
    for equation in bench.system.equations:
        found = bench.replay.residuals(run, equation, (name,), values | changed)
        own = Run(known.system, run.recording, CUTOFF)
        assert known.residuals(own, equation, (), known.defaults(())) == pytest.approx(found, abs=1e-9)


@pytest.mark.usefixtures("compiler")
def test_compiled_replay_is_that_of_the_virtual_machine(bench, run):
    for equation in bench.system.equations:
        values = bench.replay.defaults(("muscle_hysteresis", "valve_lag"))
        for part in bench.replay.parts(equation, ("muscle_hysteresis", "valve_lag")):
            theta = np.array([values[name] for name in part.parameters])
            late = Shift(inputs=1.4 * run.period)  # inputs change within each period
            rows = Lanes.cut(run.data(part.channels, late)[:60], 60)
            start = run.states(part, rows.starts)
            fast, slow = Kernel(part, part.parameters[:3]), Kernel(part, part.parameters[:3])
            fast.build()
            assert fast.built
            assert not slow.built
            a, b = (one(rows, theta, start, run.period, 4) for one in (fast, slow))
            assert np.abs(a - b).max() <= 1e-9 * max(1.0, np.abs(b).max())


def test_machine_code_is_not_that_of_the_same_functions_with_other_parameters(bench):
    (part, *_) = bench.replay.parts(bench.system.equations[0], ())
    first, second, *rest = part.parameters
    swapped = replace(part, parameters=(second, first, *rest))
    keys = {_key(part, (first,)), _key(part, (second,)), _key(swapped, (first,)), _key(swapped, (second,))}
    assert len(keys) == 4


def test_muscles_that_do_not_feel_each_other_are_replayed_apart_as_together(bench, run):
    (gas,) = (equation for equation in bench.system.equations if equation.name == "gas")
    apart, joined = (bench.replay.parts(gas, effects) for effects in (("valve_lag",), ("supply_sag",)))
    assert [part.channels for part in apart] == [(channel,) for channel in gas.channels]
    assert [part.channels for part in joined] == [gas.channels]
    effects, names = ("valve_lag",), ("extensor_leak", "conductance", "valve_lag.damping_ratio")
    values = bench.replay.defaults(effects)
    whole, static = bench.replay._assembled((*bench.system.shapes, *effects))
    part = cut(bench.system, whole, static, gas)
    wrt = tuple(name for name in names if name in part.parameters)
    assert len(wrt) > 1
    theta = np.array([values[name] for name in part.parameters])
    residuals, slopes, known = bench.replay.sensitivities(run, gas, effects, values, wrt)
    assert known == wrt
    kernel = Kernel(part, wrt)
    kernel.build()
    rows = Lanes.cut(run.data(gas.channels), 1500)
    steps = bench.replay._substeps(run, part, rows, theta)
    together = kernel(rows, theta, run.states(part, rows.starts), run.period, steps)
    assert residuals == pytest.approx(together[:, :, 0], rel=1e-9, abs=1e-6)
    assert np.abs(slopes - together[:, :, 1:]).max() < 1e-9 * np.abs(slopes).max()


def test_sensitivities_are_the_derivatives_of_the_residuals(bench, run):
    values = bench.replay.defaults(())
    for equation in bench.system.equations:
        names = ("muscle_damping", "conductance", "angle_offset", "force_map_misfit.extensor_c10")
        _, slopes, known = bench.replay.sensitivities(run, equation, (), values, names)
        for i, name in enumerate(known):
            step = 1e-4
            ends = [
                bench.replay.residuals(run, equation, (), {**values, name: sign * step}) for sign in (1, -1)
            ]
            difference = (ends[0] - ends[1]) / (2 * step)
            assert np.abs(difference - slopes[:, :, i]).max() < 1e-3 * np.abs(difference).max()


def test_a_nominal_plant_leaves_its_sensors_noise(bench, run):
    values, sensor = bench.replay.defaults(()), bench.parameters.plant.sensor
    residuals = {
        channel: [bench.replay.residuals(run, equation, (), values)[1000:, i]]
        for equation in bench.system.equations
        for i, channel in enumerate(equation.channels)
    }
    found = noise_levels(residuals, [run.period])
    angle = np.hypot(sensor.angle_noise, sensor.angle_resolution / 12**0.5)
    pressure = np.hypot(sensor.pressure_noise, sensor.pressure_resolution / 12**0.5)
    assert found["angle"] == pytest.approx(angle, rel=0.08)
    assert found["flexor_pressure"] == pytest.approx(pressure, rel=0.08)


def test_neighbours_are_smoothed_and_own_samples_are_not(bench, run):
    """Trap 4: raw cross inputs make delays look good, since interpolation averages noise."""
    torque = bench.system.equations[0]
    rows = run.data(torque.channels)
    raw = run.recording.signals["flexor_pressure"]
    jitter = np.std(np.diff(rows[1000:, 2], 2)) / np.std(np.diff(raw[1000:], 2))
    assert jitter < 0.2
    assert np.array_equal(rows[:, -4], run.recording.signals["angle"])  # trap 3: full rate, as recorded


def _with(recording, **changed):
    return Recording(recording.name, recording.period, {**recording.signals, **changed})


# the recorded signals that a delay makes late; voltages are stamped too early instead
LATE = {
    "valve_delay": {"extensor_voltage": -2, "flexor_voltage": -2},
    "angle_delay": {"angle": 2},
    "extensor_pressure_delay": {"extensor_pressure": 2},
}


@pytest.mark.parametrize("name", LATE)
def test_a_delay_of_whole_samples_is_exact(bench, name):
    """Shifted data with the delay in the model leave what the data themselves leave without it."""
    recording, samples, settled = bench.recording(1), 2, 4000
    moved = {key: np.roll(recording.signals[key], count) for key, count in LATE[name].items()}
    plain, late = (Run(bench.system, one, CUTOFF) for one in (recording, _with(recording, **moved)))
    values = {**bench.replay.defaults((name,)), f"{name}.delay": samples * recording.period}
    own = 0 if name == "valve_delay" else samples
    (equation,) = [e for e in bench.system.equations if e.name in bench.replay.touched(name)]
    known = bench.replay.residuals(plain, equation, (), values)[settled:-10, 0]
    found = bench.replay.residuals(late, equation, (name,), values)[settled + own : -10 + own, 0]
    unaware = bench.replay.residuals(late, equation, (), values)[settled + own : -10 + own, 0]
    assert np.abs(found - known).max() < 1e-3 * np.std(known)
    assert np.std(unaware - known) > 0.2 * np.std(known)


def test_a_delay_of_one_muscle_leaves_the_other_alone(bench, run):
    effects = ("extensor_pressure_delay",)
    gas, values = bench.system.equations[1], bench.replay.defaults(effects)
    late, plain = (bench.replay.residuals(run, gas, names, values) for names in (effects, ()))
    assert np.array_equal(late[:, 1], plain[:, 1])
    assert np.std(late[:, 0] - plain[:, 0]) > 0.1 * np.std(plain[:, 0])


def test_sensors_that_feel_each_other_are_late_inside_the_model(bench, run):
    gas, effects = bench.system.equations[1], ("extensor_pressure_delay", "supply_sag")
    assert not bench.replay.shifts(effects[0], gas, effects)
    assert bench.replay.shifts(effects[0], gas, effects[:1])
    (part,) = bench.replay.parts(gas, effects)
    assert "extensor_pressure_delay.delay" in part.parameters


@pytest.mark.parametrize(("often", "seldom", "delay"), [(1e-3, 5e-3, 3e-3), (2.5e-4, 2e-3, 2e-3)])
def test_a_lagging_valve_is_followed_from_where_its_input_changes(bench, often, seldom, delay):
    """Sampled more often, with a delay of whole samples, the replay is the same."""
    rng, times, count = np.random.default_rng(4), round(seldom / often), 400
    first = {name: signal[0] for name, signal in bench.recording(1).signals.items()}
    volts = {name: rng.uniform(4.0, 6.0, count).repeat(times) for name in bench.system.inputs}
    still = {name: np.full(times * count, first[name]) for name in first} | volts
    gas = replace(bench.system.equations[1], gains={})  # nothing is corrected: samples do not matter
    replay, effects = Replay(replace(bench.system, equations=(gas,))), ("valve_lag", "valve_delay")
    values = replay.defaults(effects) | {"valve_delay.delay": delay - bench.system.late}
    found = []
    for period in (often, seldom):
        rows = {key: value[:: round(period / often)] for key, value in still.items()}
        run = Run(bench.system, Recording("held", period, rows), CUTOFF)
        found.append(replay.residuals(run, gas, effects, values))
    assert np.ptp(found[0]) > 5e4
    assert found[1] == pytest.approx(found[0][::times], abs=400.0)


def test_a_delay_between_samples_lies_between_its_neighbours(bench, run):
    values = bench.replay.defaults(("valve_delay",))
    gas = next(e for e in bench.system.equations if e.name in bench.replay.touched("valve_delay"))

    def residual(samples):
        changed = {**values, "valve_delay.delay": samples * run.period}
        return bench.replay.residuals(run, gas, ("valve_delay",), changed)[4000:]

    one, half, two = residual(1.0), residual(1.5), residual(2.0)
    assert np.std(half - 0.5 * (one + two)) < 0.05 * np.std(two - one)


def test_whitening_is_causal_and_white():
    """Trap 3: a two-sided filter would correlate noise with later inputs of the closed loop."""
    rng = np.random.default_rng(0)
    noise = rng.standard_normal(200_000)
    coloured = np.convolve(noise, 0.9 ** np.arange(60))[: len(noise)]
    from scipy.signal import welch

    taps = minimum_phase(welch(coloured, fs=1.0, nperseg=SEGMENT, detrend=False)[1])
    assert taps[0] == pytest.approx(1.0, abs=0.03)
    assert taps[1] == pytest.approx(-0.9, abs=0.03)
    white = np.convolve(coloured, taps)[: len(noise)]
    assert np.mean(white[2000:] * noise[2000:]) > 0.98
    assert np.var(white[2000:]) == pytest.approx(1.0, abs=0.03)


def test_a_bound_is_kept_in_the_prediction():
    """Trap 7: what is pinned at a bound may not help the others."""
    hessian, gradient = np.array([[2.0, 1.9], [1.9, 2.0]]), np.array([3.0, -1.0])
    step = bounded_step(hessian, gradient, np.zeros(2), np.array([-0.1, -9.0]), np.array([9.0, 9.0]))
    assert step[0] == pytest.approx(-0.1)
    assert step[1] == pytest.approx((1.0 + 1.9 * 0.1) / 2.0)


def test_where_the_old_way_leads_up_a_fit_takes_a_damped_step():
    """Friction that sticks is flat for a small step and steep for a larger one."""

    class Sticking:
        def residuals(self, values, _weights):
            return {"torque": np.array([1 - values["x"], 1 + 50 * max(0.0, abs(values["y"]) - 0.02)])}

    free = [Free(name, 1.0, -9.0, 9.0, np.inf) for name in ("x", "y")]
    start = {"x": 0.0, "y": 0.0}
    blocks = {"torque": Block(np.array([1.0, 1.0]), -np.eye(2), ("x", "y"))}
    moved, gained, residuals = _descended(Sticking(), {"torque": 1.0}, start, free, blocks)
    assert gained > 0
    assert 0 < moved["x"] < 0.05
    np.testing.assert_array_equal(residuals["torque"], Sticking().residuals(moved, {})["torque"])


def test_an_equation_that_a_step_hardly_moves_is_not_replayed_and_any_other_is():
    """What is near is near where it was differentiated last, however many steps ago."""

    class Two:
        system = SimpleNamespace(equations=[SimpleNamespace(name=name) for name in ("torque", "gas")])
        replayed: ClassVar[list] = []

        def weighted(self, _weights):
            return self

        def residuals(self, _effects, values, of):
            self.replayed += [one.name for one in of]
            rows = {"torque": [values["x"] ** 2], "gas": [values["bias"] + values["leak.size"]]}
            return {one.name: np.array(rows[one.name]) for one in of}

        def blocks(self, effects, values, _names, of):
            slopes = {"torque": [[2 * values["x"]]], "gas": [[1.0, 1.0]]}
            names = {"torque": ("x",), "gas": ("bias", "leak.size")}
            rows = self.residuals(effects, values, of)
            return {one: Block(row, np.array(slopes[one]), names[one]) for one, row in rows.items()}

    free = [Free(name, 1.0, -9.0, 9.0, np.inf) for name in ("bias", "leak.size", "x")]
    problem, weights = Two(), {"torque": 1.0, "gas": 0.5}
    line, start = Linearised(problem, ("leak",), free), {"bias": 0.0, "leak.size": 0.0, "x": 1.0}
    line.blocks(start, {})

    def replayed(weights=weights, **moved):
        problem.replayed.clear()
        row = line.residuals({**start, **{key.replace("_", "."): v for key, v in moved.items()}}, weights)
        return row["gas"][0], list(problem.replayed)

    assert replayed(x=1.2) == (0.0, ["torque"])
    assert replayed(bias=0.2) == (pytest.approx(0.1), [])
    assert replayed(bias=0.4) == (pytest.approx(0.2), ["gas"])  # too far
    assert replayed(leak_size=0.009) == (pytest.approx(0.0045), [])
    assert replayed(leak_size=0.011) == (pytest.approx(0.0055), ["gas"])  # it might begin to act
    assert replayed({"torque": 1.0, "gas": 5.0}, bias=0.2) == (1.0, ["gas"])  # its squares change by 1
    anew = []
    for bias in (0.2, 0.4, 0.6):
        problem.replayed.clear()
        line.blocks({**start, "bias": bias}, weights)
        anew += problem.replayed
    assert anew == ["gas"]  # at 0.4, and 0.6 is near that


def test_one_kernel_does_whether_details_are_free_or_not(bench, run):
    replay, effects = Replay(bench.system), ("joint_friction",)
    torque = next(equation for equation in bench.system.equations if equation.name == "torque")
    quantities = bench.system.catalogue["joint_friction"].parameters
    fitted, details = (
        [f"joint_friction.{q.name}" for q in quantities if q.fitted is one] for one in (True, False)
    )
    values = replay.defaults(effects)
    _, plain, names = replay.sensitivities(run, torque, effects, values, tuple(fitted))
    _, whole, more = replay.sensitivities(run, torque, effects, values, (*details, *fitted))
    assert (names, more) == (tuple(fitted), (*details, *fitted))
    np.testing.assert_array_equal(plain, whole[:, :, len(details) :])
    assert np.count_nonzero(np.abs(whole).max(axis=(0, 1))) > len(fitted)
    assert len(replay._kernels) == 1


def test_parameters_without_influence_do_not_stop_a_step():
    """Two that act as one: the step is shared, not refused."""
    hessian = 1e9 * np.array([[1.0, 1.0], [1.0, 1.0]])
    step = bounded_step(hessian, np.array([2e9, 2e9]), np.zeros(2), np.full(2, -9.0), np.full(2, 9.0))
    assert step.sum() == pytest.approx(-2.0)


def test_nothing_hidden_gives_no_delay_and_no_backlash(bench):
    """Traps 1, 2, 5, 6: discretisation and noise must not look like a lag of anything."""
    settings = bench.parameters.gap
    training, held_out = [bench.recording(1)], [bench.recording(2)]
    problem, _, _ = beginning.prepared(bench.replay, training, held_out, settings)
    free = free_parameters(bench.system, ())
    problem, base = fit_tempered(problem, (), bench.replay.defaults(()), free)
    projection = Projection(problem, base)
    for name in ("valve_delay", "valve_lag", "angle_delay", "extensor_pressure_delay", "backlash"):
        trial = Trial(projection, name)
        assert candidate(projection, trial, trial.starts()[:1]).evidence < settings.evidence.threshold


def test_a_large_effect_is_found_from_derivatives_far_away(bench):
    """Trap 9: derivatives taken without the effect mislead where it is large; the model is evaluated anew."""
    plant = {"plant__effects__joint_friction__enabled": True, "plant__effects__joint_friction__coulomb": 2.5}
    settings = bench.parameters.gap
    problem, _, _ = beginning.prepared(
        bench.replay, [bench.recording(1, **plant)], [bench.recording(2, **plant)], settings
    )
    free = free_parameters(bench.system, ())
    problem, base = fit_tempered(problem, (), bench.replay.defaults(()), free)
    trial = Trial(Projection(problem, base), "joint_friction")
    found = candidate(trial.projection, trial, trial.starts())
    assert found.evidence > 100
    assert found.values["joint_friction.coulomb"] == pytest.approx(2.5, rel=0.15)


def test_every_fit_lets_the_maps_be_off(bench):
    """Trap 9: without these corrections every realistic recording gives a false name."""
    free = {one.name: one for one in free_parameters(bench.system, ("joint_friction",))}
    for shape in ("force_map_misfit", "valve_curve_misfit", "volume_misfit"):
        own = [one for name, one in free.items() if name.startswith(f"{shape}.")]
        assert len(own) >= 5
        assert all(0 < one.sd < np.inf for one in own)


def test_friction_that_is_stiff_at_standstill_keeps_the_sensitivities_bounded(bench, run):
    """A narrow change of sign is missed by moving samples; too long steps then blow derivatives up."""
    torque, effects = bench.system.equations[0], ("joint_friction",)
    values = {**bench.replay.defaults(effects), "joint_friction.coulomb": 1.6}
    values["joint_friction.transition_velocity"] = 0.001
    wanted = ("moving_mass", "joint_friction.coulomb")
    _, slopes, _ = bench.replay.sensitivities(run, torque, effects, values, wanted)
    assert np.abs(slopes).max() < 10.0


def test_a_trial_may_shift_inputs_to_earlier_places(bench, run):
    gas = bench.system.equations[1]
    late, early = (run.data(gas.channels, Shift(0.0, steps * run.period, {})) for steps in (1.5, -1.5))
    plain = run.data(gas.channels)
    width, first = len(bench.system.inputs), 2 * len(bench.system.channels)
    inputs = slice(first + width, first + 2 * width)
    assert np.array_equal(late[10:20, inputs], plain[9:19, inputs])
    assert np.array_equal(early[10:20, inputs], plain[12:22, inputs])


@pytest.mark.parametrize("name", ["periodic_torque", "temperature_drift"])
def test_a_part_keeps_the_clock_of_its_recording(bench, name):
    """The part that judges must see an effect of time as the part that was fitted does."""
    recording, cut, settled = bench.recording(1), 4123, 1500
    part = recording.part(cut, recording.samples, "end")
    assert part.part(100, 200, "middle").start == pytest.approx((cut + 100) * recording.period)
    values = bench.replay.defaults((name,))
    runs = [Run(bench.system, one, CUTOFF) for one in (recording, part)]
    for equation in bench.system.equations:
        whole, end = (bench.replay.residuals(one, equation, (name,), values) for one in runs)
        plain = bench.replay.residuals(runs[0], equation, (), values)
        difference = np.abs(end[settled:] - whole[cut + settled :]).max(axis=0)
        if equation.name in bench.replay.touched(name):
            assert (difference < 0.02 * np.abs(whole - plain)[cut + settled :].max(axis=0)).all()


def test_a_muscle_that_becomes_slack_lets_no_rate_leap(bench):
    """A leap of the force has no slope: fits stuck beside it, and effects had the credit for getting off."""
    whole = bench.system.assemble(())
    rates = ca.Function("rates", [whole.x, whole.u, whole.time, whole.theta], [whole.rates])
    # the extensor's pressure rises until it is taut, while the joint turns so that it is stretched
    pressures = np.arange(1.0e5, 5.0e5, 10.0)
    states = np.tile(np.array([0.9, 0.0, 2.0e5, 1.0e5])[:, None], len(pressures))
    assert whole.states == ("angle", "velocity", "extensor_pressure", "flexor_pressure")
    states[2] = pressures
    leaps = []
    for velocity in (-1.0, 1.0):
        states[1] = velocity
        found = np.array(rates(states, np.full(2, 5.0), 0.0, np.zeros(len(whole.parameters))))[1]
        assert np.ptp(found) > 10.0, "it becomes taut"
        leaps.append(np.abs(np.diff(found)).max())
    assert max(leaps) < 0.5
