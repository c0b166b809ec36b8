# SPDX-License-Identifier: Apache-2.0
"""The controllers on machines of one axis that a file declares: in closed loop, and their equations."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from pam_orthosis.control import position
from pam_orthosis.control.axis import Axis
from pam_orthosis.control.loop import ClosedLoop, signals
from pam_orthosis.control.margin import maximum_error, perturbations
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model import machine as machine_module
from pam_orthosis.model.machines import KNEE, read_machine
from pam_orthosis.model.parameters import load
from pam_orthosis.model.plant import Plant

SLIDE = """
mechanism: {kind: translation, inertia: 5.0, minimum: 0.0, maximum: 0.3, start: 0.15}
actuators:
  push: {kind: cylinder, area: 8.0e-4, volume: 2.0e-5, length: 0.3, transmission: {arm: 1.0}}
  pull: {kind: cylinder, area: 6.0e-4, volume: 2.0e-5, length: 0.3,
         transmission: {arm: -1.0, contraction: 0.3}}
sensor: {noise: 1.0e-5}
"""
ARM = """
mechanism: {kind: rotation, inertia: 0.15, damping: 0.2, weight: 5.0, minimum: 0.0, maximum: 1.4, start: 0.5}
actuators:
  biceps: {kind: muscle, parameters: muscle.dmsp_20, transmission: {ground: 0.3, lever: 0.04, angle: -2.4}}
  triceps: {kind: muscle, parameters: muscle.dmsp_20, transmission: {arm: -0.025, contraction: 0.04}}
sensor: {noise: 1.0e-4}
"""
SLED = """
mechanism: {kind: translation, inertia: 8.0, damping: 20.0, minimum: 0.0, maximum: 0.06, start: 0.03}
actuators:
  left: {kind: muscle, parameters: muscle.dmsp_20, transmission: {arm: 1.0}}
  right: {kind: muscle, parameters: muscle.dmsp_20, transmission: {arm: -1.0, contraction: 0.06}}
sensor: {noise: 1.0e-5}
"""
CYLINDER = "kind: cylinder, area: 8.0e-4, volume: 2.0e-5, length: 0.3"
CRANK = f"""
mechanism: {{kind: rotation, inertia: 0.2, weight: 5.0, minimum: -0.8, maximum: 0.8, start: 0.0}}
actuators:
  upper: {{{CYLINDER}, transmission: {{ground: 0.25, lever: 0.06, angle: 1.5, contraction: 0.1}}}}
  lower: {{{CYLINDER}, transmission: {{ground: 0.25, lever: 0.06, angle: -1.5, contraction: 0.1}}}}
sensor: {{noise: 1.0e-4}}
"""
# text, where the reference begins and how far it goes, bounds of error and its RMS, push from outside
MACHINES = {
    "slide": (SLIDE, 0.15, 0.1, 0.005, 0.0015, 20.0),
    "arm": (ARM, 0.5, 0.6, 0.02, 0.005, 2.0),
    "sled": (SLED, 0.03, 0.015, 0.003, 0.0015, 30.0),
    "crank": (CRANK, 0.0, 0.6, 0.01, 0.003, 2.0),
}
SLOW = {"control.position.c1": 3.0, "control.position.c2": 3.0}
HELD = {"scenario.trajectory": "hold"}


class Pushed(Plant):
    """A machine that something pushes steadily."""

    push = 0.0

    def _external(self, time):
        return (self.push,)


@pytest.fixture(autouse=True)
def interpreted(monkeypatch):
    monkeypatch.setenv("PAM_ORTHOSIS_NO_COMPILER", "1")


@pytest.fixture
def of(tmp_path):
    """Return a function: text of a machine's file, values -> the parameters."""

    def read(text, **values):
        path = tmp_path / "machine.yaml"
        path.write_text(text, encoding="utf-8")
        return load(values, read_machine(path))

    return read


def moving(shape, start, way):
    if shape == "sine":
        return {"scenario.sine.centre": start, "scenario.sine.amplitude": 0.5 * way}
    return {"scenario.step.low": start, "scenario.step.high": start + way}


def run(parameters, seconds=4.0, push=0.0):
    plant = Pushed(parameters, 1)
    plant.push = push
    loop = ClosedLoop(parameters, 1, plant=plant)
    found = loop.run(round(seconds / parameters.scenario.control_period))
    assert not any(each["vent"] or each["held_samples"] for each in loop.health().values())
    return found


def error_of(parameters):
    found, q = run(parameters), parameters.declared.coordinate.name
    assert np.ptp(found[f"true_{q}"]) > 0.9 * np.ptp(found[f"reference_{q}"])
    return found[f"reference_{q}"] - found[f"true_{q}"]


@pytest.mark.parametrize("shape", ["sine", "steps"])
@pytest.mark.parametrize("name", MACHINES)
def test_a_machine_follows(of, name, shape):
    text, start, way, most, rms, _ = MACHINES[name]
    values = {"scenario.trajectory": shape, **moving(shape, start, way)}
    error = error_of(of(text, **values))
    assert np.abs(error).max() < most
    assert np.sqrt(np.mean(error**2)) < rms
    assert np.abs(error_of(of(text, **values, **SLOW))).max() > 1.2 * most, "the test can fail"


@pytest.mark.parametrize("name", MACHINES)
def test_a_constant_push_is_estimated_and_held(of, name):
    text, *_, most, _, push = MACHINES[name]
    p = of(text, **HELD)
    free, pushed = (run(p, 2.0, each) for each in (0.0, push))
    late = free["time"] > 1.0
    estimated = pushed["disturbance"][late].mean() - free["disturbance"][late].mean()
    assert estimated == pytest.approx(-push, rel=0.05)
    assert (pushed[f"true_{p.declared.coordinate.effort}"][1:] == push).all()
    moved = pushed[f"true_{p.declared.coordinate.name}"][late]
    assert np.abs(moved - p.at(p.declared.start)).max() < 0.25 * most


def test_a_run_reports_by_the_machines_names(of):
    p = of(SLIDE, **HELD)
    assert tuple(run(p, 0.1)) == signals(p.declared)
    assert {"reference_position", "pull_voltage", "true_force"} < set(signals(p.declared))
    assert {"reference_angle", "flexor_voltage", "true_torque"} < set(signals(KNEE))


def given(axis, asked):
    """Return the functions of an effort, coordinate and velocity -> allocation, and effort that it gives."""
    effort, q, v = (ca.SX.sym(name) for name in ("effort", "q", "v"))
    found = asked(position.Demand(effort, q, v, axis.nominal.control.position.mean_pressure), axis)
    absolute = tuple(p + axis.nominal.valve.ambient_pressure for p in found.pressures)
    outputs = axis.effort(q, v, absolute), found.missed, ca.vertcat(*found.slack_share), ca.vertcat(*absolute)
    return ca.Function("given", [effort, q, v], outputs)


@pytest.mark.parametrize("name", MACHINES)
def test_the_pressures_give_the_effort_at_any_lever(of, name):
    axis, rng = Axis(of(MACHINES[name][0]).nominal()), np.random.default_rng(2)
    low, high = axis.mechanism.limits
    function, reached = given(axis, position.pressures_for_effort), 0
    most = {"slide": 100.0, "arm": 8.0, "sled": 150.0, "crank": 6.0}[name]
    for q, v, effort in rng.uniform((low, -0.2, -most), (high, 0.2, most), (60, 3)).tolist():
        found, missed, slack_share, _ = function(effort, q, v)
        if not missed and not float(ca.mmax(slack_share)):
            assert float(found) == pytest.approx(effort, abs=1e-9 * most)
            reached += 1
    assert reached > 30


def test_the_effort_is_the_work_of_the_tensions(of):
    axis, q = Axis(of(ARM).nominal()), ca.SX.sym("q")
    pressures = ca.SX.sym("p", 2)
    contractions, _ = axis.kinematics(q, 0)
    effort = ca.Function("effort", [q, pressures], [axis.effort(q, ca.SX(0), ca.vertsplit(pressures))])
    place = ca.Function("place", [q], list(contractions))
    at, p, step = 0.8, np.array([3.0e5, 2.6e5]), 1e-6
    gauge = p - axis.nominal.valve.ambient_pressure
    forces = [float(one.force(place(at)[i], gauge[i])) for i, one in enumerate(axis.actuators)]
    ways = [float(place(at + step)[i] - place(at - step)[i]) / (2 * step) for i in range(2)]
    assert min(forces) > 50.0
    assert float(effort(at, p)) == pytest.approx(np.dot(forces, ways), rel=1e-6)


def test_what_cannot_slacken_is_not_slackened(of):
    slide, sled = (given(Axis(of(t).nominal()), position.pressures_for_effort) for t in (SLIDE, SLED))
    for function in (slide, sled):
        assert function(1e4, 0.03, 0.0)[1], "out of reach"
    assert float(ca.mmax(slide(1e4, 0.03, 0.0)[2])) == 0.0
    assert float(ca.mmax(sled(1e4, 0.03, 0.0)[2])) == 1.0


def of_another_law(monkeypatch, change):
    cylinder = machine_module.ACTUATORS["cylinder"]
    monkeypatch.setitem(machine_module.ACTUATORS, "cylinder", lambda section: change(cylinder(section)))


def bulging(actuator):
    """A bellows whose area grows with the pressure; the smaller one is stiffer."""
    area = actuator.force(0.0, 1.0)
    return replace(actuator, affine=None, force=lambda dl, p: actuator.force(dl, p) * (0.6 + 4e-3 * area * p))


def test_a_force_that_is_not_affine_in_the_pressure_is_linearised(of, monkeypatch):
    affine = given(Axis(of(SLIDE).nominal()), with_effects)(60.0, 0.1, 0.05)
    of_another_law(monkeypatch, lambda actuator: replace(actuator, affine=None))
    same = given(Axis(of(SLIDE).nominal()), with_effects)(60.0, 0.1, 0.05)
    assert same[3].full() == pytest.approx(affine[3].full())
    of_another_law(monkeypatch, bulging)
    values = {"scenario.trajectory": "sine", **moving("sine", 0.15, 0.1)}
    p = of(SLIDE, **values)
    once, again = (given(Axis(p.nominal()), how) for how in (position.pressures_for_effort, with_effects))
    assert abs(float(once(60.0, 0.1, 0.0)[0]) - 60.0) > 0.1
    assert float(again(60.0, 0.1, 0.0)[0]) == pytest.approx(60.0, abs=1e-4)
    assert np.abs(error_of(p)).max() < MACHINES["slide"][3]


def with_effects(asked, axis):
    return position.pressures_with_effects(asked, None, axis)


BOTH = "transmission: {arm: -1.0, contraction: 0.3}"
THIRD = (
    "  more: {kind: cylinder, area: 8.0e-4, volume: 2.0e-5, length: 0.3, transmission: {arm: 1.0}}\nsensor"
)
ALONE = SLIDE[: SLIDE.index("  pull")] + "sensor: {noise: 1.0e-5}"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (ALONE, "machine: the controllers move two actuators against each other, not 1"),
        (SLIDE.replace("sensor", THIRD), "not 3"),
        (SLIDE.replace(BOTH, "transmission: {arm: 0.5}"), "push and pull do not pull against each other at"),
        (ARM.replace("angle: -2.4", "angle: -0.6"), "at angle = 0.612 rad"),
    ],
)  # fmt: skip
def test_a_machine_that_these_controllers_cannot_move_is_refused(of, text, words):
    with pytest.raises(OrthosisError, match=words) as refused:
        ClosedLoop(of(text, **HELD), 1, plant=object())
    assert "\n" not in str(refused.value)


def test_margins_are_those_that_a_machine_has(of):
    p = of(SLIDE, **HELD, **{"scenario.duration": 1.0})
    rubbing = {"plant.effects.carriage_friction.enabled": True}
    assert set(perturbations(p)) == {"delay", "supply"}
    assert set(perturbations(p.changed(rubbing))) == {"delay", "supply", "friction"}
    assert perturbations(p.changed(rubbing))["friction"].unit == "N"
    assert 0.0 < maximum_error(p) < 1e-3
    lost = perturbations(p)["delay"].overrides(50.0)
    assert maximum_error(p.changed({**lost, "control.guard.tracking_error": 0.02})) > 2 * maximum_error(p)
