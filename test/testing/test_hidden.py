# SPDX-License-Identifier: Apache-2.0
"""The hidden plant: right where nothing is hidden, different in form where something is, and sealed."""

import ast
import json
from pathlib import Path

import numpy as np
import pytest

import pam_orthosis
from pam_orthosis.bag.read import read_bag, run_record
from pam_orthosis.cli.main import main
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load
from pam_orthosis.model.plant import Plant
from pam_orthosis.testing import case as cases
from pam_orthosis.testing import physics
from pam_orthosis.testing.effects import EFFECTS, OUTSIDE, SIZES
from pam_orthosis.testing.plant import HiddenPlant, apparatuses
from pam_orthosis.testing.quantities import Hidden
from pam_orthosis.testing.write import write_case

ROOT = Path(pam_orthosis.__file__).parent
SENSORS = ("angle_noise", "angle_resolution", "pressure_noise", "pressure_resolution")


@pytest.fixture
def silent(monkeypatch):
    """Switch the hidden plant's noise and rounding off."""
    module = "pam_orthosis.testing.plant."
    for name, value in {"ANGLE_NOISE": 0.0, "PRESSURE_NOISE": 0.0, "ANGLE_RESOLUTION": 1e-12,
                        "PRESSURE_RESOLUTION": 1e-9, "VOLTAGE_RESOLUTION": 1e-13}.items():  # fmt: skip
        monkeypatch.setattr(module + name, value)


def ideal():
    """Return parameters of a plant that is exactly the nominal model of the blind cases."""
    plain = load()
    deviations = {key: 1.0 for key in plain.flat() if key.startswith("plant.deviation.")}
    effects = {f"plant.effects.{name}.enabled": False for name in KNEE.catalogue}
    sensors = {f"plant.sensor.{name}": 0.0 for name in SENSORS}
    delays = dict.fromkeys((key for key in plain.flat() if key.startswith("plant.delay.")), 0.0)
    law = {"plant.muscle_law": "polynomial", "plant.voltage_resolution": 0.0, "plant.simulation.step": 5e-5}
    return load({**cases.NOMINAL, **deviations, **effects, **sensors, **delays, **law})


def swing(plant, periods=120):
    """Drive a plant by opposed voltages; returns (periods, 3) noise-free sensor values."""
    seen = []
    for k in range(periods):
        seen.append(plant._sense())
        wave = 0.8 * np.sin(2 * np.pi * 2.5 * k * 2e-3)
        plant.advance(5.02 + wave, 4.98 - wave)
    return np.array(seen)


def test_with_nothing_hidden_it_is_the_nominal_model(silent):
    """Two realisations of the same equations, in closed loop for 2 s with the leg moving."""
    p = ideal().changed({"scenario.start_hold": 0.1, "scenario.start_ramp": 0.5})
    p = p.changed({"scenario.start_angle": make_trajectory(p).sample(0).position})
    independent = ClosedLoop(p, plant=HiddenPlant(p)).run(1000)
    model = ClosedLoop(p).run(1000)
    assert np.ptp(model["angle"]) > 0.5
    assert np.abs(independent["angle"] - model["angle"]).max() < 1e-7
    assert np.abs(independent["extensor_pressure"] - model["extensor_pressure"]).max() < 0.5


@pytest.mark.parametrize(("name", "outside"), [*((n, False) for n in EFFECTS), *((n, True) for n in OUTSIDE)])
def test_every_hidden_effect_acts_more_the_larger_it_is(name, outside):
    p = cases.nominal()
    plain = swing(HiddenPlant(p))
    changes = []
    for size in ("small", "large"):
        rng = np.random.default_rng(3)
        secret = cases.draw(rng, p, "clean", size, name, outside)
        seen = swing(HiddenPlant(p, secret.hidden, {}, secret.misfits))
        assert np.isfinite(seen).all()
        changes.append(np.sqrt(np.mean(((seen - plain) / [3.5e-4, 500.0, 500.0]) ** 2)))
    if name not in ("random_pushes", "drifting_valve_gain", "temperature_drift"):  # act after seconds only
        assert changes[0] > 0.02
    assert changes[1] >= changes[0]


@pytest.mark.parametrize("name", [name for name, effect in EFFECTS.items() if effect.parameter != "-"])
def test_catalogue_and_hidden_form_mean_the_same_thing(name, silent, monkeypatch):
    """The change that an effect makes: equal where the form is the same, alike where it is not."""
    monkeypatch.setenv("PAM_ORTHOSIS_NO_COMPILER", "1")
    p, weights = ideal(), np.array([3.5e-4, 500.0, 500.0])
    secret = cases.draw(np.random.default_rng(3), p, "clean", "medium", name)
    values = {f"plant.effects.{name}.{k}": v for k, v in secret.answer["effects"][name].items()}
    plain = swing(HiddenPlant(p))
    hidden = (swing(HiddenPlant(p, secret.hidden)) - plain) / weights
    plant = Plant(p.changed({f"plant.effects.{name}.enabled": True, **values}))
    plant._sense = plant.measure
    catalogue = (swing(plant) - plain) / weights
    mismatch = np.linalg.norm(hidden - catalogue) / np.linalg.norm(catalogue)
    assert mismatch < (1e-3 if EFFECTS[name].same_form else 0.4)


def test_everything_of_the_catalogue_can_be_hidden():
    assert set(EFFECTS) == set(KNEE.catalogue)
    for effect in EFFECTS.values():
        assert effect.sizes[0] != effect.sizes[1] != effect.sizes[2]
        known = {q.name: q for q in KNEE.catalogue[effect.name].parameters}
        if effect.parameter == "-":
            continue
        for size in effect.sizes:
            value = 1 + size if effect.around_one else size
            assert known[effect.parameter].minimum <= value * 1.2 <= known[effect.parameter].maximum


def test_the_step_is_fine():
    """A coarser one is seen as a delay by the workflow (trap 6 of the study)."""
    assert physics.STEP <= 5e-5


def test_a_dead_time_is_exact():
    p = cases.nominal()
    late = swing(HiddenPlant(p, Hidden(angle_delay=0.004, pressure_delay_e=0.006)))
    now = swing(HiddenPlant(p))
    assert np.abs(late[2:, 0] - now[:-2, 0]).max() < 1e-9
    assert np.abs(late[3:, 1] - now[:-3, 1]).max() < 1e-6
    assert np.abs(late[:, 2] - now[:, 2]).max() == 0.0


def test_play_loses_its_width_when_the_knee_reverses():
    """The sprocket follows the knee at half a gap: outside the play it stands still."""
    h = Hidden(play=0.01)
    assert physics.sprocket(0.505, 1.0, 0.5, h) == (0.5, 0.0)
    angle, rate = physics.sprocket(0.52, 1.0, 0.5, h)
    assert angle == pytest.approx(0.51)
    assert rate == 1.0


@pytest.mark.parametrize("opening", [0.02, 0.4, -0.05, -0.8])
def test_valve_and_hose_agree_on_the_flow(opening):
    p, h = cases.nominal(), Hidden(hose=4e6)
    a, _ = apparatuses(p)
    flow = physics.hose_flow(opening, 4e5, a.supply, a, h)
    there = 4e5 + physics.hose_drop(flow, h)
    assert flow == pytest.approx(physics.valve_flow(opening, there, a.supply, a, h), abs=1e-10)
    assert abs(flow) <= abs(physics.valve_flow(opening, 4e5, a.supply, a, h))


def test_slip_elements_saturate_at_the_half_width():
    anchors = np.zeros(physics.ELEMENTS)
    assert physics.slip_force(1.0, anchors) == pytest.approx(1.0)
    assert physics.slip_force(-1.0, anchors) == pytest.approx(-1.0)
    forces = [physics.slip_force(x, anchors) for x in np.linspace(0, 3e-3, 30)]
    assert np.all(np.diff(forces) >= 0)
    assert 0.1 < physics.slip_force(2e-4, anchors) < 0.7


def test_realistic_maps_are_off_by_about_five_newtons():
    errors = []
    for seed in range(40):
        waves = cases.realistic_misfits(np.random.default_rng(seed))["force_waves"][0]
        errors += [physics.map_error(waves, x, g) for x in (0.02, 0.06, 0.1) for g in (1e5, 3e5, 5e5)]
    assert 3.5 < np.std(errors) < 6.5


@pytest.mark.parametrize("effects", [0, 1, 2, "creep", ["extensor_leak", "valve_delay"]])
def test_a_draw_hides_what_was_asked(effects):
    secret = cases.draw(np.random.default_rng(1), cases.nominal(), "clean", "medium", effects)
    wanted = effects if isinstance(effects, int) else len([effects] if isinstance(effects, str) else effects)
    assert len(secret.answer["effects"]) == wanted
    if not isinstance(effects, int):
        assert set(secret.answer["effects"]) == set([effects] if isinstance(effects, str) else effects)
    assert (secret.hidden == Hidden()) == (effects == 0)
    json.dumps(secret.answer)


def test_tolerances_are_drawn_for_every_case_and_within_reason():
    p = cases.nominal()
    tolerance = dict(p.gap.tolerance.items())
    draws = [cases.draw(np.random.default_rng(s), p, "clean", "small", 0).deviations for s in range(60)]
    for name, sd in tolerance.items():
        assert np.std([d.get(name, 0.0) for d in draws]) == pytest.approx(0.7 * sd, rel=0.4)
    assert {name for name, sd in tolerance.items() if not sd} == {"hose_conductance"}


@pytest.fixture(scope="module")
def short_case():
    """A case with recordings of a second."""
    patch = pytest.MonkeyPatch()
    patch.setattr(cases, "GAIT_SECONDS", 1.0)
    patch.setattr(cases, "HELD_OUT_GAIT_SECONDS", 0.8)
    patch.setattr(cases, "PARTS", (lambda script, d: script.go(0.6, d.low_angle),))
    made = (
        cases.make_case(11, "realistic", "large", "valve_dead_band"),
        cases.make_case(11, "realistic", "large", "valve_dead_band"),
    )
    patch.undo()
    return made


def test_a_case_follows_from_its_seed(short_case):
    one, again = short_case
    assert one.answer == again.answer
    assert np.array_equal(one.training["gait"]["angle"], again.training["gait"]["angle"])
    assert not np.array_equal(one.training["gait"]["angle"][:400], one.held_out["gait"]["angle"][:400])


def test_a_written_case_reads_back_and_its_bags_tell_nothing(short_case, tmp_path):
    case = short_case[0]
    training, held_out, truth = write_case(case, tmp_path / "case")
    bag = read_bag(training[0], ["angle", "extensor_voltage", "flexor_pressure", "reference_acceleration"])
    for name, series in bag.series.items():
        assert np.array_equal(series.value, case.training["gait"][name])
    assert np.array_equal(bag["angle"].stamp_ns, np.arange(500) * 2_000_000)
    assert json.loads(truth.read_text())["effects"] == case.answer["effects"]
    for path in (*training, *held_out):
        record = run_record(path)
        known = json.loads(record["parameters"])
        assert not any(key.startswith("plant.") for key in known)
        assert not any(value for key, value in known.items() if key.endswith(".enabled"))
        assert record["effects"] == "[]"
        assert truth.parent not in path.parents
        assert "true_angle" not in read_bag(path, ["angle"]).series


def test_a_case_is_not_overwritten(short_case, tmp_path):
    write_case(short_case[0], tmp_path)
    with pytest.raises(OrthosisError, match="holds a bag already"):
        write_case(short_case[0], tmp_path)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--effect", "ghost"], "no effect 'ghost'"),
        (["--effect", "none", "--effect", "creep"], "give names"),
        (["--effect", "creep", "--effect", "creep"], "--effect creep is given twice; give it once"),
        (["--outside", *["--effect", "random"] * 11], "11 effects to hide; there are 10"),
        (["--seed", "-1"], "whole number"),
        (["--size", "huge"], "invalid choice"),
    ],
)
def test_the_verb_refuses_what_it_cannot_do(arguments, message, tmp_path, capsys):
    assert main(["gap-hide", "--out", str(tmp_path / "new"), *arguments]) == 2
    assert message in capsys.readouterr().err


def imports(path):
    """Return the modules that a file imports, but for names in annotations, which load nothing."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    typed = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    for node in (one for one in ast.walk(tree) if id(one) not in typed):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def test_plant_and_workflow_know_nothing_of_each_other():
    """The oracle reads parameters; cases are recorded in closed loop, so they know motions too."""
    of_model, of_workflow = "pam_orthosis.model.", "pam_orthosis.discrepancy"
    for path in (*(ROOT / "testing").glob("*.py"), ROOT.parent / "benchmarks" / "hidden_rig.py"):
        names = [name for name in imports(path) if name.startswith((of_model, of_workflow))]
        recorded = path.name in ("case.py", "hidden_rig.py", "motions.py", "write.py")
        allowed = (f"{of_model}parameters.", *[f"{of_model}shapes."] * recorded)
        assert all(name.startswith(allowed) for name in names), path
        if not recorded:
            assert not [name for name in imports(path) if name.startswith("pam_orthosis.control")], path
    for path in ROOT.rglob("*.py"):
        if path.parent.name != "testing" and path.name != "gap_hide.py":
            assert not [name for name in imports(path) if name.startswith("pam_orthosis.testing")], path


@pytest.mark.parametrize("size", SIZES)
def test_sizes_are_known(size):
    cases.draw(np.random.default_rng(0), cases.nominal(), "realistic", size, 1)
    with pytest.raises(OrthosisError, match="no size"):
        cases.draw(np.random.default_rng(0), cases.nominal(), "clean", size + "r", 1)


def test_pushes_come_at_instants_of_their_own_in_each_recording():
    """A clock must not tell when they come: they are of nothing that is measured."""
    torque = cases._pushes(np.random.default_rng(1), 1.2)
    first, other = (cases._begun_anew(torque, seed) for seed in (1, 2))
    assert sorted(first) == sorted(other) == sorted(torque)
    assert abs(np.corrcoef(first, other)[0, 1]) < 0.3
    assert (cases._begun_anew(torque, 1) == first).all()
