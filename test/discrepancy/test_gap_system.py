# SPDX-License-Identifier: Apache-2.0
"""Systems of one's own: searched as ours are; what is wrong with them is said in one line."""

import json
import math
import signal
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import casadi as ca
import motor_bench
import numpy as np
import pytest
import yaml
from rosbags.typesys import Stores, get_typestore

import pam_orthosis as po
from pam_orthosis.bag.record import BagWriter
from pam_orthosis.bag.topics import JOINT, SECOND_NS, Topics
from pam_orthosis.cli.main import main
from pam_orthosis.discrepancy.api import (
    Assembled,
    Calibration,
    Channel,
    Contribution,
    Effect,
    Equation,
    Input,
    Model,
    OrthosisError,
    Parameter,
    Quantity,
    Source,
    System,
    check_system,
    describe,
    from_arrays,
    from_bag,
    from_csv,
    load_system,
)
from pam_orthosis.discrepancy.preparation.beginning import begin
from pam_orthosis.discrepancy.request import Asked, read_recordings
from pam_orthosis.discrepancy.systems import foreign
from pam_orthosis.discrepancy.systems.knee import knee
from pam_orthosis.discrepancy.systems.rig import test_rig as rig_system
from pam_orthosis.discrepancy.systems.system import Entry
from pam_orthosis.discrepancy.workers import Workers
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load
from pam_orthosis.report.gap_figures import _stand_ins

TABLE = Topics(KNEE)

CARRIAGE = Path(__file__).resolve().parents[2] / "examples" / "motor_carriage.py"
FRICTION = 2.0  # N


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    folder = tmp_path_factory.mktemp("carriage")
    return [motor_bench.write(folder / f"{seed}.csv", seed, FRICTION) for seed in (1, 2, 3)]


def _times_noise(table, *model):
    """Return how many times the noise a recalibrated model leaves."""
    read = read_recordings(Asked([Path(table)], [], *model, system=CARRIAGE), Workers(1))
    start = begin(read.nominal.system, read.training, [], read.nominal.parameters.gap)
    return start.recalibrated().white["overall"] / start.floor.white["overall"]


def _gap(tables, out, capsys):
    status = main(["gap", *tables[:2], "--held-out", tables[2], "--system", str(CARRIAGE), "--out", str(out)])
    return status, json.loads((out / "gap.json").read_text()), capsys.readouterr().out


def test_a_hidden_friction_of_a_foreign_carriage_is_named(tables, tmp_path, capsys):
    before = sorted(CARRIAGE.parent.iterdir())
    status, reported, words = _gap(tables, tmp_path / "out", capsys)
    assert (status, reported["verdict"], reported["system"]) == (0, "explained", "motor-driven carriage")
    assert [one["name"] for one in reported["effects"]] == ["friction"]
    level = reported["effects"][0]["parameters"]["level"]
    assert level["value"] == pytest.approx(FRICTION, rel=0.1)
    assert reported["effects"][0]["equation"] == "dynamics"
    assert reported["closure"]["overall"] > 0.9
    assert words.splitlines()[-1] == "EXPLAINED by friction"
    assert "knee" not in words
    assert "fits better" not in words  # its current is held between rows, as its system says
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "gap.html",
        "gap.json",
        "model.yaml",
    ]
    assert sorted(CARRIAGE.parent.iterdir()) == before  # nothing is written beside a user's file
    found = po.gap(tables[:2], tables[2:], system=CARRIAGE)
    assert found.as_dict().items() <= reported.items()
    model = tmp_path / "out" / "model.yaml"
    assert found.changes() == yaml.safe_load(model.read_text())
    third = motor_bench.write(tmp_path / "third.csv", 11, FRICTION)
    before, after = (_times_noise(third, *known) for known in ([], [model]))
    assert after < 1.3
    assert before > 10.0


def _searched(folder, friction, **changed):
    tables = [motor_bench.write(folder / f"{seed}.csv", seed, friction, **changed) for seed in (7, 8, 9)]
    outcome = po.gap(tables[:2], tables[2:], system=CARRIAGE).outcome
    return outcome, {one.name: one for one in outcome.effects}


def test_inputs_that_act_late_are_named_with_their_delay(tmp_path):
    """Far later than a remark on stamps reaches, and beside friction."""
    outcome, named = _searched(tmp_path, FRICTION, late=0.04)
    assert (outcome.verdict, set(named)) == ("explained", {"friction", "inputs_delay"})
    assert named["inputs_delay"].parameters["delay"][0] == pytest.approx(0.04, abs=2e-4)


def test_a_wrong_parameter_is_named_with_what_stands_for_it_as_well(tmp_path):
    """Only the ratio of mass and motor moves the carriage."""
    outcome, named = _searched(tmp_path, 0.0, mass=3.0)
    assert (outcome.verdict, set(named)) == ("recalibrated", {"wrong_mass"})
    _, unit, lower, upper = named["wrong_mass"].parameters["value"]
    assert lower < 3.0 < upper
    assert (unit, upper - lower < 0.6) == ("kg", True)
    assert outcome.look_alikes == ("wrong_motor",)
    assert "wrong parameter: mass is 2." in describe(outcome)
    assert "RECALIBRATED: by a wrong mass (or a wrong motor); recal" in describe(outcome)


def test_what_may_change_together_without_a_trace_is_said(tables, capsys):
    """Mass, motor and damping by one factor; the encoder's zero is not seen by itself, and no part of it."""
    assert main(["gap", *tables, "--system", str(CARRIAGE), "--until", "check"]) == 0
    said = capsys.readouterr().out
    assert "mass, motor and damping may change together without a trace in these data" in said


def test_a_wrong_parameter_is_named_beside_a_large_effect(tmp_path):
    """Recalibration moves it in any case: what the effect's form leaves over is no reason to be silent."""
    outcome, named = _searched(tmp_path, FRICTION, mass=3.0)
    wrong = set(named) - {"friction"}
    assert (outcome.verdict, len(wrong), wrong <= {"wrong_mass", "wrong_motor"}) == ("explained", 1, True)


def test_what_moves_the_other_way_by_a_ratio_is_recalibrated_to_the_end():
    """Three parameters, all twice as large, change nothing: they can be moved together in one step."""
    system = load_system(CARRIAGE)
    found = system.assemble(())
    rates = ca.Function("f", [found.x, found.u, found.theta], [found.rates])
    usual = rates([0.1, 0.2], [0.5], [0.0] * 4)
    twice = rates([0.1, 0.2], [0.5], [np.log(2) * value for value in (2.0, 12.0, 5.0)] + [0.0])
    assert np.array(twice) == pytest.approx(np.array(usual))
    assert {one.name for one in system.calibrations if not one.ratio} == {"position_offset"}


def test_without_friction_nothing_is_named(tmp_path, capsys):
    tables = [motor_bench.write(tmp_path / f"{seed}.csv", seed, 0.0) for seed in (4, 5, 6)]
    status, reported, _ = _gap(tables, tmp_path / "out", capsys)
    assert (status, reported["verdict"], reported["effects"]) == (0, "none", [])


MISTAKES = {
    "": ("", "it has no function system()"),
    "def system():": ("def system(:", ", line 48: SyntaxError"),
    "s.current -": (
        "s.curent -",
        ", line 16: there is no signal 'curent'; there are: position, velocity, cur",
    ),
    "p.motor *": ("p.motr *", ", line 16: there is no parameter 'motr'; there are: mass, motor, damping"),
    'stage="force",\n    parameters=(\n        Quantity("level", 3.0': (
        'stage="torque",\n    parameters=(\n        Quantity("level", 3.0',
        "effect friction: the equations assign no signal 'torque', its stage; they assign force",
    ),
    ', "velocity": s.force / p.mass': ("", "rates that the equations return: velocity is missing"),
    'states=["position"': ('states=["positon"', "channel position: 'position' is none of the states"),
    'Channel("position", "position"': ('Channel("position", None', "no channel shows a state"),
    '"N", 0.0, 50.0, "dry': ('"N", 5.0, 50.0, "dry', "effect friction: level: 3.0 is not inside its bounds"),
    '2.0, "kg", 0.06': ('2.0, "kg", -0.06', "tolerance of mass: -0.06 is not above 0"),
    '2.0, "kg"': ('float("nan"), "kg"', "parameter mass: its value is nan, no finite number"),
    '"kg", 0.06': ('"kg", "3%"', "parameter mass: its tolerance, in kg, is '3%', no finite number"),
    '0.0, "m", 1e-4': ('float("nan"), "m", 0.0', "parameter position_offset: its value is nan, no finite"),
    '"mm", 1e3': ('"mm", 0.0', "channel position: report_factor is 0"),
    "noise=0.001)],": ('noise=0.001)], late="3 ms",', "late is '3 ms', no finite number"),
    'Parameter("damping"': ('Parameter("mass"', "parameters: 'mass' is there twice"),
    "p.level * ca.tanh": ("p.level * nothing.tanh", "NameError: name 'nothing' is not defined"),
    "    ).system()": ("    )", "system() returns Model, not a System"),
    'inputs=[Input("current"': ('inputs=["current", Input("current"', "AttributeError"),
    '{"position": Source(column': (
        '{"positon": Source(column',
        "sources: 'positon' is none of position, curr",
    ),
    "factor=1e-3": ("factor=0", "source of position: factor is 0"),
    "import casadi as ca": ("import sys\nsys.exit()", ", line 8: SystemExit"),
    "SPEEDS = 1e-4": ("class Own(BaseException): ...\nraise Own('base')\nSPEEDS = 1", ", line 12: Own: base"),
    "-p.level * ca.sin(": ("(_ for _ in ()).throw(GeneratorExit('x')) or (", ", line 41: GeneratorExit: x"),
    'Channel("position"': ('Channel("time"', "channel 'time': a table has its stamps under this name"),
    'Input("current"': ('Input("time"', "input 'time': a table has its stamps under this name"),
    '"A", noise=0.001': ('"A", held="yes"', "input current: held is 'yes'; give True or False"),
    '[Input("current", "A", noise=0.001)': (
        '[Input("current", "A", held=None)',
        "input current: held is None; give True or False",
    ),
    "p.level * ca.tanh(s.velocity / p.speed)": (
        "(p.level + 0.3) * ca.tanh(s.velocity / p.speed)",
        "effect friction: it does not vanish at level = 0, said to be neutral",
    ),
    "ca.tanh(s.velocity / p.speed)": ("__import__('math').tanh(s.velocity)", "with friction: a constant in"),
    "ca.sin(2 * ca.pi / p.pitch * s.position)": (
        "(1.0 if s.position > 0 else 2.0)",
        ", line 41: a signal has no value yet, so `if`, `while`, `and`, `or`, min and max cannot look at it",
    ),
    'return {"position": s.velocity, "velocity": s.force / p.mass}': (
        "return s.velocity, s.force / p.mass",
        'rates that the equations return: give them by name, {"position": ..., "velocity": ...}, not tuple',
    ),
    "sources={": (
        "limits={'position': 1.0}, sources={",
        "limits of position: 1.0; give the lowest and the hig",
    ),
}


@pytest.mark.parametrize("right", MISTAKES, ids=lambda right: " ".join(right.split())[:30] or "empty")
def test_a_mistake_in_the_file_is_one_line(right, tmp_path):
    wrong, said = MISTAKES[right]
    text = CARRIAGE.read_text(encoding="utf-8")
    assert right in text
    file = tmp_path / "own.py"
    file.write_text(text.replace(right, wrong, 1) if right else "", encoding="utf-8")
    with pytest.raises(OrthosisError) as refused:
        load_system(file)
    assert str(refused.value).startswith(str(file))
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_who_interrupts_a_file_interrupts_the_verb(tables, tmp_path, capfd):
    file = tmp_path / "own.py"
    file.write_text("raise KeyboardInterrupt")
    assert main(["gap", tables[0], "--system", str(file)]) == 3
    assert capfd.readouterr().err == "pam-orthosis: interrupted\n"


@pytest.mark.parametrize("mass", ["0.0", "1e-320", "1e-290"])
def test_an_equation_without_a_finite_value_is_one_line(tables, tmp_path, capfd, mass):
    file = tmp_path / "own.py"
    file.write_text(CARRIAGE.read_text(encoding="utf-8").replace('2.0, "kg"', f'{mass}, "kg"'))
    assert main(["gap", tables[0], "--system", str(file), "--until", "replay"]) == 2
    (said,) = capfd.readouterr().err.splitlines()
    assert "the dynamics equation gives no finite number from the first sample on" in said


@pytest.mark.parametrize(
    ("expression", "said"),
    [
        ("p.level * ca.sqrt(s.position - 99)", ": it is no candidate; check its expression"),
        ("p.level * ca.sqrt(1 - p.level)", " at typical size; others are tried"),
    ],
)
def test_an_effect_that_gives_no_finite_number_is_not_said_to_be_small(
    tables, tmp_path, capsys, expression, said
):
    text, own = CARRIAGE.read_text(encoding="utf-8"), "-p.level * ca.sin(2 * ca.pi / p.pitch * s.position)"
    file = tmp_path / "own.py"
    assert own in text
    file.write_text(text.replace(own, expression), encoding="utf-8")
    assert main(["gap", *tables[:2], "--system", str(file), "--until", "check"]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if "cogging" in line]
    assert lines == [f"in these data the dynamics equation gives no finite number with cogging{said}"]


@pytest.mark.parametrize(("number", "share"), [("1e300", 0.0), ("-1e300", 0.2), ("4e12", 0.001)])
def test_a_number_that_nothing_measures_is_one_line(tables, tmp_path, capfd, number, share):
    head, *rows = Path(tables[0]).read_text(encoding="utf-8").splitlines()
    absurd = range(1, 2 + round(share * len(rows)))
    for row in absurd:
        rows[row] = f"{rows[row].rpartition(',')[0]},{number}"
    file = tmp_path / "absurd.csv"
    file.write_text("\n".join([head, *rows]))
    assert main(["gap", str(file), "--system", str(CARRIAGE), "--until", "replay"]) == 2
    (said,) = capfd.readouterr().err.splitlines()
    assert f"A in {len(absurd)} of {len(rows)} samples, the first in row 2 of numbers" in said


def test_gap_refuses_a_file_that_is_none_and_a_model_beside_it(tables, tmp_path, capsys):
    assert main(["gap", tables[0], "--system", str(tmp_path / "none.py")]) == 2
    assert "cannot read" in capsys.readouterr().err
    model = tmp_path / "found.yaml"
    model.write_text("valve.delay: 0.0\n")
    assert main(["gap", tables[0], "--system", str(CARRIAGE), "--model", str(model)]) == 2
    assert "found.yaml: " in (said := capsys.readouterr().err)
    assert "motor-driven carriage has no 'valve.delay'; it has mass, motor" in said
    model.write_text("gap.tolerance.person_mass: 0.1\n")
    assert main(["gap", tables[0], "--system", str(CARRIAGE), "--model", str(model)]) == 2
    assert f"{CARRIAGE} has the tolerances of its parameters" in capsys.readouterr().err
    model.write_text("gap.replay.angle_gain: 12.0\n")
    assert main(["gap", tables[0], "--system", str(CARRIAGE), "--model", str(model)]) == 2
    assert f"{CARRIAGE} gives its own by Model(gains=...)" in capsys.readouterr().err


def test_what_a_file_prints_is_no_answer(tmp_path, capsys):
    file = tmp_path / "own.py"
    file.write_text(f"print('loaded')\n{CARRIAGE.read_text()}", encoding="utf-8")
    load_system(file)
    assert capsys.readouterr() == ("", "loaded\n")


def _changed(folder, right, wrong):
    """Return a file with another carriage."""
    text, file = CARRIAGE.read_text(encoding="utf-8"), folder / "own.py"
    assert right in text
    file.write_text(text.replace(right, wrong, 1), encoding="utf-8")
    return file


def test_what_an_effect_prints_in_a_search_is_no_answer(tmp_path, capsys):
    system = load_system(_changed(tmp_path, "-p.level * ca.sin(", "print('called') or -p.level * ca.sin("))
    assert "called" in capsys.readouterr().err
    system.assemble(("cogging",))
    assert capsys.readouterr() == ("", "called\n")


def test_a_function_of_numpy_does_what_one_of_casadi_does_without_a_word(tmp_path):
    file = _changed(tmp_path, "-p.level * ca.tanh(", "-p.level * __import__('numpy').tanh(")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_system(file)


ENDLESS = "[0 for _ in iter(int, 1)]"


@pytest.mark.parametrize(
    ("right", "wrong", "line"),
    [
        ("-p.level * ca.sin(", f"{ENDLESS} or (", 41),
        ("    return Model(", f"    {ENDLESS}\n    return Model(", 50),
    ],
    ids=["effect", "system"],
)
def test_a_loop_without_an_end_is_one_line(tmp_path, monkeypatch, right, wrong, line):
    file = _changed(tmp_path, right, wrong)
    monkeypatch.setattr(foreign, "LONGEST_SECONDS", 0.5)
    before = signal.getsignal(signal.SIGVTALRM)
    with pytest.raises(OrthosisError, match=f"own.py, line {line}: no answer after .* of computing"):
        load_system(file)
    assert signal.getsignal(signal.SIGVTALRM) == before
    assert signal.getitimer(signal.ITIMER_VIRTUAL) == (0.0, 0.0)


def test_a_file_is_read_in_another_thread_too():
    with ThreadPoolExecutor(1) as threads:
        assert threads.submit(load_system, CARRIAGE).result().name == "motor-driven carriage"


def test_a_table_is_read_by_columns_in_other_units(tables):
    system = load_system(CARRIAGE)
    read = from_csv(Path(tables[0]), system)
    expected = motor_bench.rows(1, FRICTION)
    assert read.signals["position"] == pytest.approx(1e-3 * expected[:, 1], abs=1e-9)
    assert read.signals["current"] == pytest.approx(expected[:, 2], abs=1e-9)
    other = replace(system, sources={"position": Source(column="encoder", factor=1e-3)})
    with pytest.raises(OrthosisError, match="no column encoder for position; there are: time, encoder_mm"):
        from_csv(Path(tables[0]), other)
    with pytest.raises(OrthosisError, match=r"no column position; there are: time, .* --columns position="):
        from_csv(Path(tables[0]), replace(system, sources={}))


def test_a_bag_is_read_by_topics(tmp_path):
    system, bag = load_system(CARRIAGE), tmp_path / "bag"
    samples = motor_bench.rows(1, FRICTION)[:700]
    _write_bag(bag, samples)
    with pytest.raises(OrthosisError, match=r"bag: no \.csv table, .* not say under which topic current is"):
        from_bag(bag, replace(system, sources={"position": _topic("position")}))
    with pytest.raises(OrthosisError, match="JointState has no field 'place'"):
        from_bag(bag, replace(system, sources={"position": _topic("place"), "current": _topic("effort")}))
    placed = replace(system, sources={"position": _topic("position"), "current": _topic("effort", 1.0)})
    check_system(placed)
    read = from_bag(bag, placed, "left")
    assert read.period == pytest.approx(motor_bench.PERIOD)
    assert read.signals["position"] == pytest.approx(1e-3 * samples[:, 1])
    assert read.signals["current"] == pytest.approx(samples[:, 2])


def _topic(field, factor=1e-3):
    return Source(topic="motor", type=JOINT, field=field, joint="carriage", factor=factor)


def _write_bag(folder, samples):
    store = get_typestore(Stores.ROS2_JAZZY)
    kinds = store.types
    with BagWriter(folder, {}) as writer:
        writer.add_topic("/left/motor", JOINT)
        for time, place, current in samples:
            stamp_ns = round(time * 1e9)
            stamp = kinds["builtin_interfaces/msg/Time"](*divmod(stamp_ns, SECOND_NS))
            header = kinds["std_msgs/msg/Header"](stamp, "")
            message = kinds[JOINT](header, ["carriage"], np.array([place]), np.zeros(0), np.array([current]))
            writer.write("/left/motor", stamp_ns, bytes(store.serialize_cdr(message, JOINT)))


def test_reading_bags_knows_the_rig_without_changing_the_knee():
    assert not [name for name in TABLE.signals if name.startswith("rig_")]


def test_a_system_by_hand_and_ours_fit_together():
    check_system(_by_hand())
    check_system(_leaking())
    entries = {"x": (Entry("m/s", "leak", "leak.size"),)}
    check_system(replace(_leaking(), entries=entries, needs={"all": ("u",)}))
    check_system(knee(load()))
    check_system(rig_system(load(), "dmsp_10"))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"equations": ()}, "one equation at least"),
        ({"derived": {"x": "x"}}, "derived: 'x' has to be a state that is not measured"),
        ({"calibrations": (Calibration("decay", 0.1, "1/s", "decay"),) * 2}, "'decay' is there 2 times"),
        ({"calibrations": (Calibration("decay", 0.1, "", "", nominal=math.nan),)}, "decay: nan is no"),
        ({"calibrations": ()}, "the parameters are not those of calibrations and effects"),
        ({"inputs": ()}, "1 inputs, not 0"),
        ({"inputs": ("time",)}, "input 'time': a table has its stamps under this name"),
        ({"limits": {"y": (0.0, 1.0)}}, "limits: 'y' is none of x"),
        ({"input_noise": {"u": float("nan")}}, "noise of u: nan is no finite number"),
        ({"equations": (Equation("all", ("x",), ("x",), {}),)}, "it needs the state x and its gain"),
        ({"places": {"leek": "all"}}, "places: 'leek' is none of leak"),
        ({"places": {"leak": "al"}}, "place of leak: 'al' is none of all"),
        ({"places": {}}, "effect leak without one of `places`: stage: 'x' is none of body"),
        ({"needs": {"al": ("u",)}}, "needs: 'al' is none of "),
        ({"needs": {"all": ("v",)}}, "needs of all: 'v' is none of u"),
        ({"derived_twice": {"bent": "y"}}, "derived_twice: 'bent' has to be a state .* 'y' one that one"),
        ({"derived_twice": {"bent": "x"}}, "with one rate in `derived`"),
        ({"entries": {"y": (Entry("m"),)}}, "entries: 'y' is none of x"),
        ({"entries": {"x": ("m",)}}, "entries of x: 'm' is no Entry"),
        ({"entries": {"x": (Entry("m", size=0.0),)}}, "entries of x: size is 0"),
        ({"entries": {"x": (Entry("m", parameter="leak.a"),)}}, "parameter of leak: 'a' is none of size"),
    ],
)
def test_a_system_that_does_not_fit_together_is_refused(changed, said):
    with pytest.raises(OrthosisError, match=said):
        check_system(replace(_leaking(), **changed))


def _leaking():
    """The tank by hand, with an effect."""
    tank, size = _by_hand(), ca.SX.sym("leak.size")

    def assemble(effects):
        plain, added = tank.assemble(()), "leak" in effects
        leaking = {"rates": plain.rates - size, "theta": ca.vertcat(plain.theta, size)}
        return replace(plain, parameters=("decay", "leak.size"), **leaking) if added else plain

    quantity = Quantity("size", 0.1, "m/s", 0.0, 1.0, "leak", 0.0)
    leak = Effect("leak", "x", (quantity,), None, "A leak.", "test")
    return replace(tank, catalogue={"leak": leak}, places={"leak": "all"}, assemble=assemble)


def test_a_forgotten_symbol_is_named():
    system = _by_hand()
    found = system.assemble(())
    stray = replace(found, rates=found.rates + ca.SX.sym("stray"))
    with pytest.raises(OrthosisError, match="the symbol stray, which is no state"):
        check_system(replace(system, assemble=lambda _: stray))


def _by_hand():
    x, u, time, theta = (ca.SX.sym(name) for name in ("x", "u", "time", "decay"))
    assembled = Assembled(("x",), x, u, time, theta, ("decay",), u - (1 + theta) * x, {"x": x})
    channel, equation = Channel("x", "x", "m", "m", 1.0), Equation("all", ("x",), ("x",), {"x": {"x": 4.0}})
    decay = Calibration("decay", 0.1, "1/s", "decay")
    return System("tank", (channel,), ("u",), {}, (equation,), (decay,), {}, lambda effects: assembled)


def _two_tanks(**changed):
    """Return two tanks in a row, of which only the second one's level and its outflow are measured."""

    def equations(s, p):
        s.passed = p.pipe * (s.first - s.second)
        s.outflow = p.hole * s.second
        return {"second": s.passed - s.outflow, "first": s.pump - s.passed}

    def leaking(s, p, own):
        return Contribution({"passed": -p.size * own[0], "measured_outflow": p.size}, (s.first - own[0],))

    size = Quantity("size", 0.1, "1/s", 0.0, 1.0, "leak", 0.0)
    leak = Effect("leak", "passed", (size,), leaking, "A leak.", "test", states=("wet",))
    settings = {
        "name": "tanks",
        "channels": [Channel("second", "second", "m", "m", 1.0), Channel("outflow", None, "m/s", "m/s", 1.0)],
        "inputs": [Input("pump", "m/s")],
        "states": ["first", "second"],
        "equations": equations,
        "parameters": [
            Parameter("pipe", 0.5, "1/s", 0.1, "pipe"),
            Parameter("hole", 0.2, "1/s", 0.0, "hole"),
        ],
        "effects": [leak],
    }
    return Model(**(settings | changed))


def test_the_builder_finds_out_what_the_engine_has_to_know():
    system = _two_tanks().system()
    check_system(system)
    assert system.derived == {}
    assert [one.name for one in system.calibrations] == ["pipe"]
    equation = system.equations[0]
    assert (equation.name, equation.states, equation.channels) == (
        "dynamics",
        ("second",),
        ("second", "outflow"),
    )
    assert system.equation_of("leak") == "dynamics"
    assert system.without(["pump"]).equations == ()
    assert _stand_ins(system) == []
    found = system.assemble(("leak",))
    assert found.states == ("first", "second", "wet")
    evaluated = ca.Function("f", [found.x, found.u, found.theta], [found.rates, found.measured["outflow"]])
    rates, outflow = evaluated([3.0, 2.0, 1.0], [0.7], [0.1, 0.3])
    passed = 0.5 * np.exp(0.1 / 0.5) * (3.0 - 2.0) - 0.3 * 1.0
    assert np.array(rates)[:, 0] == pytest.approx([0.7 - passed, passed - 0.2 * 2.0, 3.0 - 1.0])
    assert float(outflow) == pytest.approx(0.2 * 2.0 + 0.3)


def test_an_apparatus_at_altitude_has_the_pressure_of_its_air(tmp_path):
    channels = [Channel("second", "second", "Pa", "Pa", 1.0), Channel("outflow", None, "m/s", "m/s", 1.0)]
    place = _two_tanks(channels=channels).system()
    high = _two_tanks(channels=channels, ambient=6.0e4).system()
    rows = (f"{0.01 * i:.2f},{6.0e4 + i},0.1,0.2" for i in range(100))
    table = tmp_path / "bolivia.csv"
    table.write_text("\n".join(["time,second,outflow,pump", *rows]))
    with pytest.raises(
        OrthosisError, match=r"At altitude give the ambient pressure .* as `ambient` of a system of your own"
    ):
        from_csv(table, place)
    assert from_csv(table, high).signals["second"][0] == pytest.approx(6.0e4, abs=1.0)
    check_system(high)
    with pytest.raises(OrthosisError, match=r"ambient: -1\.0 is not above 0"):
        check_system(replace(high, ambient=-1.0))


@pytest.mark.parametrize(
    ("unit", "limits", "absolute"),
    [
        ("Pa", {}, True),
        ("Pa", {"second": (0.0, 1e6)}, True),
        ("Pa", {"second": (-1e5, 1e6)}, False),
        ("m", {}, False),
    ],
)
def test_a_pressure_is_absolute_unless_its_limits_begin_below_0(unit, limits, absolute):
    channels = [Channel("second", "second", unit, unit, 1.0), Channel("outflow", None, "m/s", "m/s", 1.0)]
    assert _two_tanks(channels=channels, limits=limits).system().is_absolute("second") is absolute


@pytest.mark.parametrize("at", [0, 3])
def test_a_stamp_that_is_no_number_is_a_row_that_is_missing_an_infinite_one_is_refused(at):
    arrays = {name: np.arange(40.0) for name in ("time", "second", "outflow")}
    arrays["time"][at] = np.nan
    assert "1 of 40 rows" in from_arrays("run", _two_tanks().system(), arrays).remarks[0]
    arrays["time"][at] = np.inf
    with pytest.raises(OrthosisError, match=f"run: time is infinite at sample {at}"):
        from_arrays("run", _two_tanks().system(), arrays)


def test_parts_are_driven_by_recorded_neighbours():
    channels = [Channel("first", "first", "m", "m", 1.0), Channel("second", "second", "m", "m", 1.0)]
    parts = {"upper": ["first"], "lower": ["second"]}
    system = _two_tanks(channels=channels, parts=parts, effects=[], gains={"first": [2.0]}).system()
    check_system(system)
    assert [(one.name, one.states) for one in system.equations] == [
        ("upper", ("first",)),
        ("lower", ("second",)),
    ]
    assert system.equations[0].gains == {"first": {"first": 2.0}}
    assert system.needs == {"upper": ("pump",), "lower": ()}
    assert [one.name for one in system.without(["pump"]).equations] == ["lower"]


def test_what_an_effect_adds_to_must_come_at_its_stage_or_later():
    def adding(name):
        effect = _two_tanks().effects[0]
        return [
            replace(effect, stage="outflow", expression=lambda s, p, own: Contribution({name: p.size}, (0,)))
        ]

    with pytest.raises(OrthosisError, match="cannot add to 'passed', which is there before"):
        _two_tanks(effects=adding("passed")).system().assemble(("leak",))
    with pytest.raises(OrthosisError, match="adds to 'nothing', which is never assigned"):
        _two_tanks(effects=adding("nothing")).system().assemble(("leak",))
