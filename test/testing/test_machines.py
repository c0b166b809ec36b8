# SPDX-License-Identifier: Apache-2.0
"""Effects hidden in other machines than the knee: ankle, shoe, a user's cylinder."""

import json
from pathlib import Path

import numpy as np
import pytest

from pam_orthosis.bag.read import machine_of, run_record
from pam_orthosis.cli.main import main
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model.machines import machine_named
from pam_orthosis.model.parameters import load
from pam_orthosis.testing import case as cases
from pam_orthosis.testing.effects import EFFECTS, of_machine
from pam_orthosis.testing.plant import HiddenPlant, scale_of
from pam_orthosis.testing.quantities import Hidden

ROOT = Path(__file__).parents[2]
CYLINDER = ROOT / "examples" / "cylinder" / "cylinder.yaml"
MACHINES = {"ankle": {"leg.person.present": True}, "shoe": {}, str(CYLINDER): {}}


def plain(name):
    """Return the nominal model of a machine whose emulated hardware is exactly that."""
    machine = machine_named(Path(name))
    p = cases.nominal(machine).changed(MACHINES[name])
    flat = p.flat()
    off = {key: False for key in flat if key.startswith("plant.effects.") and key.endswith(".enabled")}
    off |= {key: 1.0 for key in flat if key.startswith("plant.deviation.")}
    off |= {key: 0.0 for key in flat if key.startswith(("plant.delay.", "plant.mounting."))}
    off["plant.delay.valve"] = p.valve.delay
    sensors = {key for key in flat if key.startswith(("plant.sensor.", f"{machine.sensor}_"))}
    off |= dict.fromkeys(sensors, 0.0)
    exact = {"plant.muscle_law": "polynomial", "plant.voltage_resolution": 0.0}
    return p.changed({**off, **exact, "plant.simulation.step": 5e-5, "scenario.start_hold": 0.1})


@pytest.mark.parametrize("name", MACHINES)
def test_with_nothing_hidden_it_is_the_nominal_model(name, monkeypatch):
    """Two realisations of the same equations, in closed loop for 1.5 s with the load moving."""
    for constant in ("ANGLE_NOISE", "PRESSURE_NOISE"):
        monkeypatch.setattr(f"pam_orthosis.testing.plant.{constant}", 0.0)
    for constant in ("ANGLE_RESOLUTION", "PRESSURE_RESOLUTION", "VOLTAGE_RESOLUTION"):
        monkeypatch.setattr(f"pam_orthosis.testing.plant.{constant}", 1e-12)
    p = plain(name).changed({"scenario.start_ramp": 0.5})
    steps = round(1.5 / p.scenario.control_period)
    independent, model = ClosedLoop(p, plant=HiddenPlant(p)).run(steps), ClosedLoop(p).run(steps)
    q = p.declared.coordinate.name
    assert np.ptp(model[q]) > 0.005
    assert np.abs(independent[q] - model[q]).max() < 1e-4 * np.ptp(model[q])
    for one in p.declared.names:
        assert np.abs(independent[f"{one}_pressure"] - model[f"{one}_pressure"]).max() < 10.0


@pytest.mark.parametrize(("name", "delay"), [("ankle", 5e-3), ("knee", 0.0)])
def test_a_nominal_model_has_nothing_that_the_plant_has_not(name, delay, tmp_path):
    """A dead time is in both, or in none; effects and what controllers do against a dead band are not."""
    text = (ROOT / "config" / "machines" / f"{name}.yaml").read_text().replace("  valve.delay: 9.9e-3", "")
    text += "" if "values:" in text else "values:\n"
    stated = {"valve.delay": 5e-3, "valve.dead_band": 0.2, "effects.joint_friction.enabled": "true"}
    file = tmp_path / "own.yaml"
    file.write_text(text + "".join(f"  {key}: {value}\n" for key, value in stated.items()))
    p = cases.nominal(machine_named(file))
    assert (p.valve.delay, p.valve.dead_band) == (delay, 0.0)
    assert not p.at("effects.joint_friction.enabled")
    assert HiddenPlant(p)._parts[2].valve_delay == delay


def test_air_comes_after_the_stated_dead_time_and_the_hidden_one():
    p = cases.nominal(machine_named(Path("ankle")))
    plant = HiddenPlant(p, Hidden(valve_delay=4e-3, hose=1.5e6))
    plain = HiddenPlant(p, Hidden(hose=1.5e6))
    begun = []
    for one in (plain, plant):
        sensed = [one._sense()[1]]
        while sensed[-1] - sensed[0] < 500.0:
            one.advance(7.0, 5.0)
            sensed.append(one._sense()[1])
        begun.append((len(sensed) - 2) * p.scenario.control_period)
    assert begun == pytest.approx([8e-3, 12e-3])


@pytest.mark.parametrize("name", MACHINES)
def test_what_can_be_hidden_is_in_the_catalogue_under_its_name(name):
    p = cases.nominal(machine_named(Path(name)))
    known, table = p.declared.catalogue, of_machine(EFFECTS, p.declared, scale_of(p))
    assert {"valve_delay", "supply_sag", f"{p.declared.names[1]}_leak"} < set(table) <= set(known)
    assert ("carriage_friction" if name == str(CYLINDER) else "joint_friction") in table
    for effect in table.values():
        bounds = {q.name: q for q in known[effect.name].parameters}.get(effect.parameter)
        for size in effect.sizes if bounds else ():
            assert bounds.minimum <= (1 + size if effect.around_one else size) <= bounds.maximum


def test_sizes_go_by_the_machine():
    """The ankle's smaller muscles at shorter levers rub less, its hoses are the same."""
    p = cases.nominal(machine_named(Path("ankle")))
    table = of_machine(EFFECTS, p.declared, scale_of(p))
    ratio = table["joint_friction"].sizes[1] / EFFECTS["joint_friction"].sizes[1]
    assert ratio == pytest.approx(0.18, rel=0.2)
    assert table["hose_resistance"].sizes == EFFECTS["hose_resistance"].sizes
    assert table["dorsiflexor_leak"].field == "leak_e"
    assert table["plantarflexor_leak"].field == "leak_f"


@pytest.mark.parametrize("name", MACHINES)
def test_friction_takes_energy_and_a_leak_takes_air(name):
    p = plain(name).changed({"scenario.start_hold": 30.0})
    still = HiddenPlant(p)
    leaking = HiddenPlant(p, Hidden(leak_f=5e-10))
    for plant in (still, leaking):
        for _ in range(round(0.5 / p.scenario.control_period)):
            plant.advance(5.0, 5.0)
    assert still.x[3] - leaking.x[3] > 1e3
    assert abs(still.x[0] - p.at(p.declared.start)) < 1e-3


def test_a_case_of_an_ankle_is_written_as_one(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(cases, "GAIT_SECONDS", 0.6)
    monkeypatch.setattr(cases, "HELD_OUT_GAIT_SECONDS", 0.6)
    monkeypatch.setattr(cases, "PARTS", (lambda script, d: script.go(0.4, d.low_angle),))
    hidden = ["--machine", "ankle", "--effect", "plantarflexor_leak"]
    assert main(["gap-hide", *hidden, "--out", str(tmp_path / "new")]) == 0, capsys.readouterr().err
    truth = json.loads((tmp_path / "new" / "sealed" / "truth.json").read_text())
    assert list(truth["effects"]) == ["plantarflexor_leak"]
    run = run_record(tmp_path / "new" / "training_diagnostic")
    assert machine_of(tmp_path, run).kind == "ankle"
    assert not any(key.startswith("plant.") for key in json.loads(run["parameters"]))


ONE = """
mechanism: {kind: translation, inertia: 8.0, minimum: 0.0, maximum: 0.3, start: 0.15}
actuators:
  push: {kind: cylinder, area: 8.0e-4, volume: 3.0e-5, length: 0.3, transmission: {arm: 1.0}}
sensor: {noise: 1.0e-5}
"""


@pytest.mark.parametrize(
    ("given", "more", "message"),
    [
        ("leg", [], "a device of several machines"),
        ("rig", [], "the test rig has verbs of its own"),
        (
            "ghost.yaml",
            [],
            "no machine ghost.yaml: there is no such file; those that come with it: ankle, knee",
        ),
        ("ankle", ["--effect", "extensor_leak"], "no effect 'extensor_leak' to hide"),
        (ONE, [], "two actuators"),
    ],
)
def test_the_verb_refuses_machines_that_it_cannot_emulate(given, more, message, tmp_path, capsys):
    if given == ONE:
        given = str(tmp_path / "one.yaml")
        Path(given).write_text(ONE)
    assert main(["gap-hide", "--machine", given, "--out", str(tmp_path / "new"), *more]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.strip().splitlines()) == 1


def test_a_knee_with_a_person_is_refused():
    with pytest.raises(cases.OrthosisError, match="no person"):
        HiddenPlant(load({**cases.NOMINAL, "leg.person.present": True}))


@pytest.mark.parametrize("name", MACHINES)
def test_the_motions_of_a_machine_are_drawn_anew(name):
    """Two runs to fit, two to judge, within the machine's range."""
    p = cases.nominal(machine_named(Path(name)))
    rng = np.random.default_rng(1)
    one, other = cases.trajectories(rng, p), cases.trajectories(rng, p, held_out=True)
    assert set(one) == set(other) == ({"first", "second"} if name == "shoe" else {"motion", "diagnostic"})
    low, high = (p.at(key) for key in p.declared.stops)
    for kind in one:
        at = [[run[kind][0].sample(t * 10**8).position for t in range(300)] for run in (one, other)]
        assert low < np.min(at) < np.max(at) < high
        assert np.abs(np.subtract(*at)).max() > 0.05 * np.ptp(at)
