# SPDX-License-Identifier: Apache-2.0
"""A force or torque from outside that a load cell records is an input of a machine."""

import json
import math

import casadi as ca
import numpy as np
import pytest

import pam_orthosis as po
from pam_orthosis.cli.main import main
from pam_orthosis.discrepancy.preparation.beginning import begin
from pam_orthosis.discrepancy.recordings.data import from_arrays, with_loop_of_table
from pam_orthosis.discrepancy.replay.run import Run, Shift
from pam_orthosis.discrepancy.request import Asked, read_recordings
from pam_orthosis.discrepancy.systems.declared import declared_machine
from pam_orthosis.discrepancy.systems.knee import knee
from pam_orthosis.discrepancy.systems.soundness import check_system
from pam_orthosis.discrepancy.workers import Workers
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.machines import KNEE, read_machine
from pam_orthosis.model.parameters import load
from pam_orthosis.model.plant import Plant

SLIDE = """
meaning: a double-acting cylinder on a carriage
mechanism: {kind: translation, inertia: 5.0, damping: 40.0, minimum: 0.0, maximum: 0.3, start: 0.15}
actuators:
  push: {kind: cylinder, area: 8.0e-4, volume: 2.0e-5, length: 0.3, transmission: {arm: 1.0}}
  pull: {kind: cylinder, area: 8.0e-4, volume: 2.0e-5, length: 0.3,
         transmission: {arm: -1.0, contraction: 0.3}}
sensor: {noise: 1.0e-5}
values: {valve.dead_band: 0.0, valve.delay: 0.0}
"""
ASSUMED = (
    "push_voltage, pull_voltage: the loop's period is assumed to be 5 ms; if it is shorter than 2 ms, they"
    " are too old to drive the model: give scenario.control_period by --model"
)
COLUMNS = ("time", "position", "push_pressure", "pull_pressure", "push_voltage", "pull_voltage")
PERIOD, STEPS, NOISE = 0.002, 3500, 1.0  # s, -, N of the load cell
EXACT = {
    "scenario.control_period": PERIOD,
    **{f"plant.delay.{part}": 0.0 for part in ("computing", "converter", "valve", "hose_length")},
    **{
        f"plant.deviation.{name}": 1.0
        for name in ("conductance", "critical_ratio", "polytropic_exponent", "supply_pressure")
    },
}


class Pushed(Plant):
    """An emulated machine that somebody pushes as no effect of the catalogue does."""

    def __init__(self, machine, seed):
        draw = np.random.default_rng(seed)
        self._rates, self._phases = draw.uniform(1.0, 12.0, 6), draw.uniform(0.0, 2 * math.pi, 6)
        effects = {f"plant.effects.{name}.enabled": False for name in machine.catalogue}
        super().__init__(load({**EXACT, **effects}, machine), seed)

    def push(self, time):
        """Return the force of the push, N."""
        return 8.0 * float(np.sin(self._rates * time + self._phases).sum()) * min(time, 1.0)

    def _external(self, time):
        return (self.push(time + PERIOD / 2),)  # held over each period: its mean


@pytest.fixture(scope="module")
def slide(tmp_path_factory):
    """Return a machine's file, and the samples of two recordings of it (SI), the last is the load cell's."""
    path = tmp_path_factory.mktemp("slide") / "slide.yaml"
    path.write_text(SLIDE, encoding="utf-8")
    return path, [_samples(read_machine(path), seed) for seed in (1, 2)]


def _samples(machine, seed):
    plant, rows, before = Pushed(machine, seed), np.empty((STEPS, len(COLUMNS) + 1)), 0.15
    noise = NOISE * np.random.default_rng(9 + seed).standard_normal(STEPS)
    for number in range(STEPS):
        time = number * PERIOD
        wanted = 0.15 + 0.05 * math.sin(3.0 * time + seed) + 0.02 * math.sin(9.0 * time)
        place, *pressures = plant.measure()
        drive = 12.0 * (wanted - place) - (place - before) / PERIOD
        before, voltages = place, [min(max(5.0 + side * drive, 0.0), 10.0) for side in (1, -1)]
        rows[number] = time, place, *pressures, *voltages, plant.push(time) + noise[number]
        plant.advance(*voltages)
    return rows


def _write(path, rows, *more):
    """Write samples as a table, its columns named like signals, and those behind as given."""
    names = [*COLUMNS, *more]
    np.savetxt(path, rows[:, : len(names)], "%.9g", ",", header=",".join(names), comments="")
    return path


def _verdict(capsys, machine, tables):
    status = main(["gap", str(tables[0]), "--held-out", str(tables[1]), "--machine", str(machine), "--json"])
    return status, json.loads(capsys.readouterr().out)


def test_a_recorded_push_is_no_gap(slide, tmp_path, capsys):
    path, samples = slide
    plain = [_write(tmp_path / f"plain{i}.csv", rows) for i, rows in enumerate(samples)]
    status, found = _verdict(capsys, path, plain)
    assert (status, found["effects"]) == (1, [])
    assert found["verdict"] in ("described", "unexplained")
    pushed = [
        _write(tmp_path / f"pushed{i}.csv", rows, "External force [N]") for i, rows in enumerate(samples)
    ]
    status, found = _verdict(capsys, path, pushed)
    assert (status, found["verdict"]) == (0, "none")
    assert found["remarks"] == [ASSUMED]


def _recorded(system, rows):
    return from_arrays("x", system, dict(zip([*COLUMNS, "external_force"], rows.T, strict=True)))


def _read(machine, tables, *columns):
    return read_recordings(Asked(tables, [], machine=machine, columns=columns), Workers(1))


@pytest.mark.parametrize(
    ("column", "mapping", "factor"),
    [
        ("external_force", [], 1.0),
        ("external_force_mN", [], 1e3),
        ("load", ["external_force=load"], 1.0),
        ("load (kN)", ["external_force=-load"], -1e-3),
        ("load", ["external_force=load:mN"], 1e3),
    ],
)
def test_its_column_is_found_and_converted(slide, tmp_path, column, mapping, factor):
    path, samples = slide
    rows = samples[0].copy()
    rows[:, -1] *= factor
    read = _read(path, [_write(tmp_path / "x.csv", rows, column)], *mapping)
    (one,), system = read.training, read.nominal.system
    np.testing.assert_allclose(one.signals["external_force"], samples[0][:, -1], rtol=1e-6, atol=1e-6)
    assert (system.gradual, system.sensed) == (("external_force",),) * 2
    assert system.unit("external_force") == "N"
    assert not one.unread
    assert one.remarks == (ASSUMED,)


def test_a_machines_file_may_state_the_period_of_its_loop(slide, tmp_path):
    path, samples = slide
    stated = tmp_path / "stated.yaml"
    stated.write_text(path.read_text().replace("valve.delay: 0.0", "scenario.control_period: 0.002"))
    (one,) = _read(stated, [_write(tmp_path / "x.csv", samples[0])]).training
    assert not one.remarks


def test_without_it_a_machine_is_searched_without_it(slide, tmp_path):
    path, samples = slide
    read = _read(path, [_write(tmp_path / "x.csv", samples[0])])
    assert read.nominal.system.inputs == ("push_voltage", "pull_voltage")


@pytest.mark.parametrize(
    ("more", "mapping", "said"),
    [
        (("external_force", ""), [], "0.csv has external_force, 1.csv does not: give it in all recordings"),
        (("load", "cell"), ["external_force=load"], "0.csv has external_force, 1.csv does not"),
        (("cell", "cell"), ["external_force=load"], "no column load for external_force; there are: time"),
        (("load", "load"), ["external_force=load:N m"], "external_force is given in N m, and needs N"),
        (("load", "load"), ["external_torque=load"], "no such signal; did you mean external_force?"),
        (("", ""), ["load=position"], "no such signal; there are: .*pull_voltage, external_force$"),
    ],
)
def test_recordings_have_it_or_none_does(slide, tmp_path, monkeypatch, capsys, more, mapping, said):
    path, samples = slide
    monkeypatch.chdir(tmp_path)
    names = [
        str(_write(tmp_path / f"{i}.csv", rows, *filter(None, [column])).name)
        for i, (rows, column) in enumerate(zip(samples, more, strict=True))
    ]
    columns = ["--columns", *mapping] if mapping else []
    assert main(["gap", names[0], "--held-out", names[1], "--machine", str(path), *columns]) == 2
    with pytest.raises(OrthosisError, match=said):
        raise OrthosisError(capsys.readouterr().err.strip())
    held_out = names[1:]
    with pytest.raises(OrthosisError, match=said.replace("--columns", "`columns`")):
        po.gap(names[:1], held_out, machine=str(path), columns=mapping)


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (1.0, ""),
        (-1.0, "with external_force of the other sign: turn it"),
        (1e-3, "with external_force times 1000: is it in kN? --columns 'external_force=COLUMN:kN'"),
    ],
)
def test_a_load_cell_of_the_other_sign_or_in_kn_is_said(slide, tmp_path, factor, said):
    path, samples = slide
    turned = [rows * [*[1.0] * len(COLUMNS), factor] for rows in samples]
    tables = [_write(tmp_path / f"{i}.csv", rows, "external_force") for i, rows in enumerate(turned)]
    read = _read(path, tables)
    start = begin(read.nominal.system, read.training[:1], read.training[1:], read.nominal.parameters.gap)
    assert start.mistaken == bool(said)
    assert said in " ".join(start.remarks)


def _acceleration(system, **inputs):
    """Return the acceleration of a resting system, its inputs 5 V but for those given."""
    assembled = system.assemble(())
    rate = assembled.rates[assembled.states.index("velocity")]
    law = ca.Function("law", [assembled.x, assembled.u, assembled.time, assembled.theta], [rate])
    first = system.channels[0].name
    x = [{first: 0.5, "velocity": 0.0}.get(name, 3e5) for name in assembled.states]
    return float(law(x, [inputs.get(name, 5.0) for name in system.inputs], 0.0, 0.0))


def test_it_moves_the_coordinate_that_way():
    known = load()
    system = knee(known, None, True)
    check_system(system)
    less, more = (_acceleration(system, external_torque=value) for value in (-1.0, 1.0))
    q, velocity = ca.SX.sym("q"), ca.SX.sym("velocity")
    terms = KNEE.mechanism(known).terms(q, velocity)
    inertia = float(ca.Function("inertia", [q, velocity], [terms.inertia])(0.5, 0.0))
    assert more - less == pytest.approx(2.0 / inertia, rel=1e-3)
    assert _acceleration(system, external_torque=0.0) == pytest.approx(_acceleration(knee(known)))


def test_valves_that_are_late_do_not_delay_it(slide):
    path, samples = slide
    machine = read_machine(path)
    system = declared_machine(machine, load({"valve.delay": 0.004}, machine), None, True)
    assert system.late == 0.004
    recorded = _recorded(system, samples[0])
    rows = Run(system, recorded, 40.0).data(("position",), Shift(0.002, 0.006))
    start = 2 * len(system.channels)
    held, sensed = rows[:, start], rows[:, start + 2]
    np.testing.assert_allclose(held[4:], samples[0][:-4, 4])  # one sample more before its change
    np.testing.assert_allclose(sensed[1:], samples[0][:-1, -1])


def test_the_period_of_a_loop_is_that_of_its_voltages(slide):
    path, samples = slide
    machine = read_machine(path)
    system = declared_machine(machine, load(machine=machine), None, True)
    rows = samples[0].copy()
    rows[:, 4:6] = np.repeat(rows[::5, 4:6], 5, axis=0)
    one = with_loop_of_table(_recorded(system, rows), system, PERIOD, False)
    assert "push_voltage, pull_voltage change every 5 rows" in one.remarks[-1]
    rare = with_loop_of_table(_recorded(system, rows), system, PERIOD, True)
    assert rare.left_out == ("push_voltage", "pull_voltage")
    assert "external_force" in rare.signals


def test_columns_that_are_not_read_are_said_once(slide, tmp_path, capsys):
    path, samples = slide
    plain = [
        str(_write(tmp_path / f"plain{i}.csv", rows, "reference_position")) for i, rows in enumerate(samples)
    ]  # as this package's own tables have
    more = [str(_write(tmp_path / f"{i}.csv", rows, "load cell")) for i, rows in enumerate(samples)]
    words = []
    for files in (plain, more):
        command = ["gap", files[0], "--held-out", files[1], "--machine", str(path), "--until", "check"]
        assert main(command) == 0
        words.append([line for line in capsys.readouterr().out.splitlines() if "not read" in line])
    assert not words[0]
    assert words[1] == ["remark: columns not read, as they are named like none of the signals: load cell"]
