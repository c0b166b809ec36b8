# SPDX-License-Identifier: Apache-2.0
"""A machine of a user's file is searched as the knee is: its system follows from the declaration."""

import csv
import json
import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

import pam_orthosis as po
from pam_orthosis.bag.simulated import record_run
from pam_orthosis.cli.main import main
from pam_orthosis.discrepancy import workflow
from pam_orthosis.discrepancy.answer.agreement import remarks_on_agreement
from pam_orthosis.discrepancy.preparation import beginning, check, mistakes
from pam_orthosis.discrepancy.preparation.beginning import begin
from pam_orthosis.discrepancy.preparation.mistakes import against_words
from pam_orthosis.discrepancy.recordings.data import from_csv
from pam_orthosis.discrepancy.systems.declared import declared_machine
from pam_orthosis.discrepancy.systems.soundness import check_system
from pam_orthosis.discrepancy.systems.suspects import VALVE
from pam_orthosis.errors import OrthosisError
from pam_orthosis.library.options import in_python
from pam_orthosis.model.machines import read_machine
from pam_orthosis.model.parameters import load
from pam_orthosis.model.plant import Plant
from pam_orthosis.reading import config_folder

SLIDE = """
meaning: a double-acting cylinder on a carriage
mechanism: {kind: translation, inertia: 5.0, damping: 40.0, minimum: 0.0, maximum: 0.3, start: 0.15}
actuators:
  push: {kind: cylinder, area: 8.0e-4, volume: 2.0e-5, length: 0.3, transmission: {arm: 1.0}}
  pull: {kind: cylinder, area: 8.0e-4, volume: 2.0e-5, length: 0.3,
         transmission: {arm: -1.0, contraction: 0.3}}
sensor: {noise: 1.0e-5}
"""
COLUMNS = ("time", "position", "push_pressure", "pull_pressure", "push_voltage", "pull_voltage")
PERIOD, STEPS = 0.002, 3500
STIFFNESS, BRAKE = 12.0, 1.0  # V/m, V s/m
# hardware that is as its file says
AS_DECLARED = {
    "scenario.control_period": PERIOD,
    "valve.dead_band": 0.0,
    "valve.delay": 0.0,
    **{f"plant.delay.{part}": 0.0 for part in ("computing", "converter", "valve", "hose_length")},
    **{
        f"plant.deviation.{name}": 1.0
        for name in ("conductance", "critical_ratio", "polytropic_exponent", "supply_pressure")
    },
}


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    path = tmp_path_factory.mktemp("machine") / "slide.yaml"
    path.write_text(SLIDE, encoding="utf-8")
    return path, read_machine(path)


def _write(path, machine, seed, friction=0.0):
    """Record the emulated machine as it follows a sum of sines; `friction`: N, hidden in it."""
    effects = {f"plant.effects.{name}.enabled": False for name in machine.catalogue}
    if friction:
        effects["plant.effects.carriage_friction.enabled"] = True
        effects["plant.effects.carriage_friction.coulomb"] = friction
    plant = Plant(load({**AS_DECLARED, **effects}, machine), seed)
    before = 0.15
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(COLUMNS)
        for number in range(STEPS):
            time = number * PERIOD
            wanted = 0.15 + 0.05 * math.sin(3.0 * time + seed) + 0.02 * math.sin(9.0 * time)
            measured = plant.measure()
            error = wanted - measured[0]
            drive = STIFFNESS * error - BRAKE * (measured[0] - before) / PERIOD
            before = measured[0]
            voltages = [min(max(5.0 + side * drive, 0.0), 10.0) for side in (1, -1)]
            writer.writerow([f"{value:.9g}" for value in (time, *measured, *voltages)])
            plant.advance(*voltages)
    return path


def test_the_system_of_a_file_fits_together_and_is_the_emulated_machine(machine, tmp_path):
    """Two realisations of the same equations: what is left is noise."""
    _, declared = machine
    parameters = load(AS_DECLARED, declared)
    system = declared_machine(declared, parameters)
    check_system(system)
    assert [one.name for one in system.equations] == ["force", "gas"]
    assert {"carriage_friction", "push_leak", "pull_leak", "supply_sag"} <= set(system.candidates)
    recorded = [from_csv(_write(tmp_path / f"{seed}.csv", declared, seed), system) for seed in (1, 2)]
    start = begin(system, recorded[:1], recorded[1:], parameters.gap)
    assert all(white < 1.3 for white in start.recalibrated().white.values())
    assert not remarks_on_agreement(start.problem, start.held_out, start.null)
    resisted = from_csv(_write(tmp_path / "friction.csv", declared, 3, friction=8.0), system)
    start = begin(system, recorded[:1], [resisted], parameters.gap)
    assert start.recalibrated().white["position"] > 5
    (remark,) = remarks_on_agreement(start.problem, start.held_out, start.null)
    assert "friction.csv: is that of another apparatus" in remark
    assert not remarks_on_agreement(start.held_out, start.problem, start.null)  # it fits neither


def test_a_coordinate_that_moves_against_all_forces_is_said(machine, tmp_path, monkeypatch):
    """Where friction is most of the gap, another sign fits as well: only the work of the forces shows it."""
    _, declared = machine
    parameters = load(AS_DECLARED, declared)
    system = declared_machine(declared, parameters)
    right = [from_csv(_write(tmp_path / f"{seed}.csv", declared, seed, 30.0), system) for seed in (1, 2)]
    turned = [
        replace(one, signals={**one.signals, "position": 0.3 - one.signals["position"]}) for one in right
    ]
    monkeypatch.setattr(beginning, "mistake_words", lambda *_: "")  # that both valves are exchanged
    start = begin(system, turned[:1], turned[1:], parameters.gap)
    (said,) = (one for one in start.remarks if one.startswith("CHECK"))
    assert "position moves against the forces on it" in said
    assert "external_force" not in said
    assert (start.mistaken, start.against) == (True, said)
    start = begin(system, right[:1], right[1:], parameters.gap)
    assert not start.mistaken
    braked = declared_machine(declared, parameters.changed({"machine.mechanism.damping": 4000.0}))
    start = begin(braked, right[:1], right[1:], parameters.gap)
    assert not against_words(start.held_out), "a model that brakes too much lacks a drive, and none is there"


def elbow(folder, second=-0.03, first="biceps"):
    muscle = "{kind: muscle, parameters: muscle.dmsp_20, transmission: {arm: %g, contraction: %g}}"
    (folder / "elbow.yaml").write_text(
        "meaning: elbow\n"
        "mechanism: {kind: rotation, inertia: 0.15, minimum: -1.2, maximum: 2.8, start: 0.8}\n"
        "sensor: {noise: 3.0e-4}\n"
        f"actuators:\n  {first}: {muscle % (0.03, 0.03)}\n  triceps: {muscle % (second, 0.09)}\n",
        encoding="utf-8",
    )
    return read_machine(folder / "elbow.yaml")


@pytest.mark.parametrize(("second", "said"), [(-0.03, False), (0.03, True)])
def test_muscles_that_all_pull_one_way_are_said(tmp_path, second, said):
    own = elbow(tmp_path, second)
    remarks = check.pulling_alike(declared_machine(own, load(machine=own)))
    assert len(remarks) == said
    assert all("machine.triceps.transmission.arm (0.03) have the same sign" in one for one in remarks)


@pytest.mark.parametrize(
    ("own", "mended", "said"), [(19.5, 5.25, True), (19.5, 8.0, False), (9.0, 1.0, False), (23.0, 6.8, True)]
)
def test_gauge_pressures_are_said_where_tolerances_leave_much(machine, monkeypatch, own, mended, said):
    """What mending leaves is what parameters are off by, within their tolerances: a few times the noise."""
    _, declared = machine
    system = declared_machine(declared, load(machine=declared))
    held_out = SimpleNamespace(system=system, scored=[])
    monkeypatch.setattr(mistakes, "_gap", lambda _: own)
    both = {f"{name}_pressure" for name in ("push", "pull")}

    def fit(_held_out, changed, _cutoff):
        return mended if {*changed[0]} == both and np.min([*changed[0].values()]) > 3e5 else np.inf

    monkeypatch.setattr(mistakes, "_fit", fit)
    signals = {name: np.full(9, 2.5e5) for name in (*both, "position")}
    held_out.scored = [SimpleNamespace(run=SimpleNamespace(recording=SimpleNamespace(signals=signals)))]
    words = mistakes.mistake_words(held_out, 8.0)
    asked = (
        "with 1.013 bar added to push_pressure and pull_pressure: gauge, it seems, where absolute pressure"
    )
    assert (asked in words) == bool(words) == said


def test_units_that_columns_name_may_be_wrong(machine):
    _, declared = machine
    system = replace(declared_machine(declared, load(machine=declared)), input_units={})
    turning = replace(system, channels=(replace(system.channels[0], unit="rad"), *system.channels[1:]))
    pressures = {one.name: np.full(9, 2.5e5) for one in system.channels[1:]}
    recorded = [{"position": np.linspace(0.0, 0.03, 9), **pressures}]
    ((said, (mended,)),) = mistakes._of_degrees(turning, recorded)
    assert said.startswith("with position 57.3 times as large: in rad")
    assert np.ptp(mended["position"]) == pytest.approx(0.03 * 180 / np.pi)
    assert not [*mistakes._of_degrees(turning, [{"position": np.linspace(0.0, 0.3, 9)}])], "so far it cannot"
    assert not [*mistakes._of_degrees(system, recorded)], "a slide"
    ((said, (mended,)),) = mistakes._of_absolute(turning, recorded)
    assert said.endswith("absolute, it seems, where their columns say gauge")
    assert mended["push_pressure"][0] == pytest.approx(2.5e5 - system.ambient)
    assert not [*mistakes._of_absolute(turning, [{name: np.full(9, 1.5e5) for name in pressures}])]


@pytest.mark.parametrize(
    ("arms", "weight", "named"),
    [
        ((0.04, -0.04), 4.0, {"machine.mechanism.weight", "arms"}),
        ((0.04, -0.04), 0.0, {"arms"}),
        (None, 0.0, set()),
    ],
)
def test_what_a_machine_moves_and_its_arms_may_be_wrong(tmp_path, arms, weight, named):
    text = SLIDE
    if arms:
        text = text.replace("translation", "rotation").replace("damping: 40.0", f"weight: {weight}")
        text = text.replace("arm: 1.0", f"arm: {arms[0]}").replace("arm: -1.0", f"arm: {arms[1]}")
    (tmp_path / "own.yaml").write_text(text, encoding="utf-8")
    own = read_machine(tmp_path / "own.yaml")
    system = declared_machine(own, load(machine=own))
    check_system(system)
    each = {f"machine.{name}.transmission.arm" for name in ("push", "pull")}
    both = "common factor of machine.push.transmission.arm and machine.pull.transmission.arm"
    always = {"machine.mechanism.inertia", "machine.push.area", "machine.pull.area"}
    expected = (named - {"arms"}) | (each | {both} if "arms" in named else set()) | always
    assert {what for what in system.wrong.values() if what not in VALVE} == expected
    assert ("weight" in {one.name for one in system.calibrations}) == bool(weight)


def test_the_damping_of_each_actuator_is_recalibrated(tmp_path, machine_files):
    text = SLIDE.replace("volume: 2.0e-5, length: 0.3,\n", "volume: 2.0e-5, damping: 60.0, length: 0.3,\n")
    (tmp_path / "own.yaml").write_text(text, encoding="utf-8")
    slide, elbow = (read_machine(one) for one in (tmp_path / "own.yaml", machine_files["elbow"]))
    of_slide, of_elbow = (declared_machine(one, load(machine=one)) for one in (slide, elbow))
    assert {"damping", "pull_damping"} == {n.name for n in of_slide.calibrations if "damping" in n.name}
    each = {"damping", "biceps_damping", "triceps_damping"}
    assert each == {n.name for n in of_elbow.calibrations if "damping" in n.name}
    check_system(of_slide)
    assembled = {f"machine.{name}.transmission.contraction" for name in ("biceps", "triceps")}
    assert assembled < set(of_elbow.wrong.values())
    assert not any("contraction" in what for what in of_slide.wrong.values())


def test_a_spring_of_a_machine_may_be_wrong(tmp_path):
    text = SLIDE.replace("damping: 40.0", "damping: 40.0, stiffness: 900.0, rest: 0.1")
    (tmp_path / "own.yaml").write_text(text, encoding="utf-8")
    own = read_machine(tmp_path / "own.yaml")
    system = declared_machine(own, load(machine=own))
    check_system(system)
    assert "machine.mechanism.stiffness" in system.wrong.values()


@pytest.mark.parametrize("first", ["biceps", "muscle"])  # knees call the damping of both muscle_damping
def test_muscles_of_one_kind_are_damped_each_by_itself(tmp_path, first):
    own = elbow(tmp_path, first=first)
    parts = declared_machine(own, load(machine=own)).assemble(())
    torque = parts.rates[parts.states.index("velocity")]
    slopes = ca.Function(
        "slopes", [parts.x, parts.u, parts.time, parts.theta], [ca.gradient(torque, parts.theta)]
    )
    for pulls, slack in ((first, "triceps"), ("triceps", first)):
        at = {"angle": 0.8, "velocity": 0.5, f"{pulls}_pressure": 4e5, f"{slack}_pressure": 1.02e5}
        found = slopes([at[name] for name in parts.states], [5.0, 5.0], 0.0, [0.0] * len(parts.parameters))
        moves = dict(zip(parts.parameters, np.ravel(found.full()), strict=True))
        assert abs(moves[f"{pulls}_damping"]) > 0.1
        assert moves[f"{slack}_damping"] == 0


def test_a_machine_of_one_actuator_is_searched(tmp_path):
    (tmp_path / "one.yaml").write_text(re.sub("  pull: .*\n.*\n", "", SLIDE), encoding="utf-8")
    one = read_machine(tmp_path / "one.yaml")
    system = declared_machine(one, load(machine=one))
    check_system(system)
    assert (one.names, system.inputs) == (("push",), ("push_voltage",))


def test_a_wrong_mass_is_named_and_not_two_forces(machine, tmp_path, capsys):
    """Both forces by one factor would do as well; a mass is one parameter."""
    path, _ = machine
    heavy = tmp_path / "slide.yaml"
    heavy.write_text(SLIDE.replace("inertia: 5.0", "inertia: 7.0"), encoding="utf-8")
    tables = [_write(tmp_path / f"{seed}.csv", read_machine(heavy), seed) for seed in (1, 2)]
    main(["gap", str(tables[0]), "--held-out", str(tables[1]), "--machine", str(path), "--json"])
    # and the delay, which the file does not say to be none
    delay, named = json.loads(capsys.readouterr().out)["effects"]
    assert delay["name"] == "valve_delay"
    assert named["wrong_parameter"] == "machine.mechanism.inertia"
    assert named["parameters"]["value"]["value"] == pytest.approx(7.0, rel=0.05)


def test_gap_takes_the_file_of_a_machine(machine, tmp_path, capsys):
    path, declared = machine
    table, judge = (_write(tmp_path / f"{seed}.csv", declared, seed) for seed in (1, 2))
    given = ["gap", str(table), "--held-out", str(judge), "--machine", str(path)]
    assert main([*given, "--until", "replay"]) == 0
    words = capsys.readouterr().out
    assert "position [mm]" in words
    assert "knee" not in words
    assert main(["gap", str(table), "--machine", str(path), "--system", "own.py"]) == 2
    assert "give one" in capsys.readouterr().err
    assert main(["gap", str(table), "--machine", str(tmp_path / "none.yaml")]) == 2
    assert "none.yaml" in capsys.readouterr().err


def test_the_help_says_that_tables_may_be_of_a_machine(capsys):
    with pytest.raises(SystemExit):
        main(["gap", "--help"])
    assert ".csv tables of the knee, of --machine or of --system" in " ".join(capsys.readouterr().out.split())


def test_the_library_reads_tables_of_a_machine_as_the_verb_does(machine, tmp_path, monkeypatch):
    path, declared = machine
    table = _write(tmp_path / "run.csv", declared, 1)
    own = table.read_text(encoding="utf-8").replace("time,position", "t,x", 1)
    table.write_text(own, encoding="utf-8")
    begun = []

    def begin_with(system, recordings, *_):
        begun.append((system.name, recordings[0]))
        raise OrthosisError("read")

    monkeypatch.setattr(beginning, "begin", begin_with)
    monkeypatch.setattr(workflow, "begin", begin_with)
    columns = {"time": "t:s", "position": "x"}
    texts = [f"{signal}={column}" for signal, column in columns.items()]
    assert main(["gap", str(table), "--machine", str(path), "--columns", *texts]) == 2
    for given in ({"machine": str(path), "columns": columns}, {"machine": declared, "columns": texts}):
        with pytest.raises(OrthosisError, match=r"^read$"):
            po.gap([table], **given)
    (name, said), *found = begun
    assert len(found) == 2
    told = tuple(map(in_python, said.remarks))
    for system, one in found:
        assert (system, one.period, one.remarks) == (name, pytest.approx(PERIOD), told)
        assert one.signals.keys() == said.signals.keys()
        assert all((one.signals[key] == said.signals[key]).all() for key in said.signals)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (
            "dmsp_20: {map_length: 0.3}",
            "model.yaml is of a muscle that the slide does not have; leave `model` out",
        ),
        ("{dmsp_20: {map_length: 0.3}, valve.delay: 0.0}", "a recording needs more than 1 samples"),
        (
            "gap.tolerance.flexor_force: 0.015",
            "flexor_force is of a knee; each actuator of slide has gap.tolerance.extensor_force",
        ),
        ("gap.tolerance.extensor_force: 0.02", "a recording needs more than 1 samples"),
    ],
)
def test_a_model_file_of_what_the_machine_does_not_have_is_refused(machine, tmp_path, rows, said):
    table, model = tmp_path / "run.csv", tmp_path / "model.yaml"
    table.write_text(",".join(COLUMNS) + "\n0,0.1,1e5,1e5,5,5\n", encoding="utf-8")
    model.write_text(rows, encoding="utf-8")
    with pytest.raises(OrthosisError, match=said):
        po.gap([table], machine=machine[0], model=model)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({}, r'no column time; .* as in `columns={"time": "COLUMN"}`, or by `machine` of what other machine'),
        ({"time": "t", "place": "x"}, "`columns` place: no such signal"),
        ({"time": ""}, "`columns` time=: give SIGNAL=COLUMN"),
        ("time=position", "column position would be time and position; say by `columns` which one it is"),
        (["time=t"], "a recording needs more than 1 samples"),
    ],
)
def test_the_library_refuses_tables_in_words_of_python(machine, tmp_path, columns, said):
    path, declared = machine
    table = tmp_path / "run.csv"
    table.write_text(",".join(["t", *COLUMNS[1:]]) + "\n0,0.1,1e5,1e5,5,5\n", encoding="utf-8")
    for given in (path, str(path), declared):
        with pytest.raises(OrthosisError, match=said) as refused:
            po.gap([table], machine=given, columns=columns)
        assert "--" not in str(refused.value)


@pytest.fixture(scope="module")
def bag(machine, tmp_path_factory):
    """Return a bag of the closed loop with the machine, a recorded run without ROS."""
    _, declared = machine
    folder = tmp_path_factory.mktemp("bag") / "run"
    motion = {"scenario.trajectory": "sine", "scenario.sine.centre": 0.15, "scenario.sine.amplitude": 0.05}
    record_run(load({**AS_DECLARED, **motion, "scenario.duration": 14.0}, declared), "default", folder)
    return folder


def test_a_bag_says_itself_of_which_machine_it_is(bag, machine, capsys):
    assert main(["gap", str(bag), "--until", "replay"]) == 0
    alone = capsys.readouterr().out
    assert "position [mm]" in alone
    assert main(["gap", str(bag), "--machine", str(machine[0]), "--until", "replay"]) == 0
    assert capsys.readouterr().out == alone


def test_recordings_of_different_machines_are_not_mixed_in_silence(bag, machine, machine_files, capsys):
    walk = str(Path(__file__).resolve().parents[2] / "bags" / "walk")
    for command, words in (
        ([str(bag), walk], "different systems (slide, the knee): one at a time"),
        ([str(bag), "--held-out", "nowhere"], "no bag at nowhere"),
        ([str(bag), "--held-out", "nowhere.csv"], "cannot read nowhere.csv: No such file"),
        ([str(bag), "--machine", str(machine_files["elbow"])], "recorded with another file, of slide"),
        ([walk, "--machine", str(machine[0])], "recorded with another file, of knee: leave --machine out"),
    ):
        assert main(["gap", *command, "--until", "check"]) == 2
        error = capsys.readouterr().err
        assert words in error
        assert error.count("\n") == 1


def test_a_knee_of_a_users_file_is_searched_as_the_knee(tmp_path, capsys):
    file, table = tmp_path / "mine.yaml", tmp_path / "walk.csv"
    shipped = (config_folder() / "machines" / "knee.yaml").read_text(encoding="utf-8")
    shipped += f"values: {{valve.delay: {load().valve.delay}}}\n"
    lines = ["time,angle,extensor_pressure,flexor_pressure,extensor_voltage,flexor_voltage"]
    waves = [[math.sin(0.02 * i + phase) for phase in range(5)] for i in range(3000)]
    lines += [
        f"{0.005 * i:.3f},{0.5 + 0.1 * a:.6f},{3e5 + 5e4 * b:.1f},{3e5 + 5e4 * c:.1f},{5 + d:.4f},{5 + e:.4f}"
        for i, (a, b, c, d, e) in enumerate(waves)
    ]
    table.write_text("\n".join(lines) + "\n", encoding="utf-8")
    reported = []
    for command in (["--machine", str(file)], []):
        file.write_text(shipped, encoding="utf-8")
        assert main(["gap", str(table), *command, "--until", "replay"]) == 0
        reported.append(capsys.readouterr().out.splitlines()[-1])
    assert reported[0] == reported[1]
    file.write_text(shipped.replace("flexor:", "bender:"), encoding="utf-8")
    assert main(["gap", str(table), "--machine", str(file), "--until", "replay"]) == 2
    assert "mine: gap knows a knee by its extensor and flexor alone" in capsys.readouterr().err
