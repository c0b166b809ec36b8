# SPDX-License-Identifier: Apache-2.0
"""Tables of any apparatus: columns and units, missing rows, stamps against each other."""

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import motor_bench
import numpy as np
import pytest

from pam_orthosis.bag.examples import write_example
from pam_orthosis.bag.read import read_bag
from pam_orthosis.cli.main import main
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.discrepancy import workflow
from pam_orthosis.discrepancy.answer import between
from pam_orthosis.discrepancy.fitting import measure
from pam_orthosis.discrepancy.preparation import beginning, check, mistakes
from pam_orthosis.discrepancy.preparation.mistakes import mistake_words
from pam_orthosis.discrepancy.recordings import stamps
from pam_orthosis.discrepancy.recordings.columns import read_mapping, signals_of, with_columns
from pam_orthosis.discrepancy.recordings.data import (
    from_arrays,
    from_csv,
    recording,
    with_loop_of_table,
    with_prompt_inputs,
)
from pam_orthosis.discrepancy.recordings.even import even
from pam_orthosis.discrepancy.recordings.stamps import STEP, remarks_on_stamps, skews
from pam_orthosis.discrepancy.request import Asked, read_recordings
from pam_orthosis.discrepancy.search.confirmation import emptied
from pam_orthosis.discrepancy.systems.knee import knee
from pam_orthosis.discrepancy.systems.system import Source
from pam_orthosis.discrepancy.systems.user_file import load_system
from pam_orthosis.discrepancy.workers import Workers
from pam_orthosis.errors import OrthosisError
from pam_orthosis.library import answers
from pam_orthosis.library.options import in_python
from pam_orthosis.model.parameters import config_folder, load, scenario_overrides
from pam_orthosis.report import gap as gap_page

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
TIME = np.arange(600) * 0.002
PLAIN = SimpleNamespace(simpler={}, input_period="")  # a user's model without effects
SI = {
    "time": TIME,
    "angle": 0.5 + 0.3 * np.sin(4 * TIME),
    "extensor_pressure": 3e5 + 1e4 * np.sin(9 * TIME),
    "flexor_pressure": 2.5e5 + 1e4 * np.cos(9 * TIME),
    "extensor_voltage": 5 + np.sin(20 * TIME),
    "flexor_voltage": 5 + np.cos(20 * TIME),
}


@pytest.fixture(scope="module")
def system():
    return knee(load())


def write(path, columns):
    np.savetxt(
        path, np.column_stack(list(columns.values())), "%.12g", ",", header=",".join(columns), comments=""
    )
    return path


def test_units_in_the_columns_names_are_converted(system, tmp_path):
    other = {
        "t": 1e3 * TIME,
        "angle [deg]": np.rad2deg(SI["angle"]),
        "p1 (bar gauge)": (SI["extensor_pressure"] - 1.013e5) / 1e5,
        "flexor_pressure_kPa": SI["flexor_pressure"] / 1e3,
        "extensor_voltage_mV": 1e3 * SI["extensor_voltage"],
        "flexor_voltage": SI["flexor_voltage"],
        "comment": 0 * TIME,
    }
    mapping = read_mapping(["time=t:ms", "extensor_pressure=p1 (bar gauge)"])
    found = from_csv(write(tmp_path / "other.csv", other), with_columns(system, mapping))
    assert found.period == pytest.approx(0.002)
    for name, values in found.signals.items():
        np.testing.assert_allclose(values, SI[name], rtol=1e-9)


def test_a_unit_that_contradicts_the_column_is_refused(system, tmp_path):
    other = {"time": TIME, "angle [deg]": np.rad2deg(SI["angle"]), "p1 [bar]": SI["extensor_pressure"] / 1e5}
    other |= {name: values for name, values in SI.items() if name not in ("angle", "extensor_pressure")}
    file = write(tmp_path / "other.csv", other)
    for unit, above in (("bar", 0.0), ("bar gauge", 1.013e5)):
        mapping = read_mapping([f"extensor_pressure=p1 [bar]:{unit}"])
        found = from_csv(file, with_columns(system, mapping)).signals["extensor_pressure"]
        np.testing.assert_allclose(found, SI["extensor_pressure"] + above, rtol=1e-9)
    mapping = read_mapping(["extensor_pressure=p1 [bar]:kPa"])
    with pytest.raises(OrthosisError, match=r"p1 \[bar\] names the unit bar, .* gives kPa; leave that out"):
        from_csv(file, with_columns(system, mapping))


def test_names_may_have_capitals_and_spaces(system, tmp_path):
    other = {name.replace("_", " ").capitalize(): values for name, values in SI.items()}
    other = {"Angle [deg]" if name == "Angle" else name: values for name, values in other.items()}
    other["Angle [deg]"] = np.rad2deg(SI["angle"])
    found = from_csv(write(tmp_path / "other.csv", other), system)
    for name, values in found.signals.items():
        np.testing.assert_allclose(values, SI[name], rtol=1e-9)
    with pytest.raises(OrthosisError, match=r"Angle \[deg\] and angle_deg both give angle"):
        from_csv(write(tmp_path / "two.csv", {**other, "angle_deg": SI["angle"]}), system)


def test_time_may_be_dates_unless_its_unit_is_given(system, tmp_path):
    whole, *rows = write(tmp_path / "x.csv", SI).read_text().splitlines()
    start = np.datetime64("2026-12-31T23:59:59.500000")
    dates = start + np.round(1e6 * TIME).astype("timedelta64[us]")
    cells = [f"{date},{row.partition(',')[2]}" for date, row in zip(dates, rows, strict=True)]
    file = tmp_path / "dates.csv"
    file.write_text("\n".join([whole, *cells]))
    found = from_csv(file, system)
    assert (found.period, found.start) == (pytest.approx(0.002), 0.0)
    file.write_text("\n".join([whole.replace("time", "time [ms]"), *cells]))
    with pytest.raises(OrthosisError, match=r"write time in seconds, as a number such as 0.002$"):
        from_csv(file, system)
    file.write_text("\n".join([whole, *cells]))
    scaled = replace(system, sources={"time": Source("time", factor=1e-3)})
    with pytest.raises(OrthosisError, match=r"write time in seconds, as a number such as 0.002$"):
        from_csv(file, scaled)
    german = "29.03.2026 01:59:55.000000," + rows[0].partition(",")[2]
    file.write_text("\n".join([whole, german, *cells]))
    with pytest.raises(OrthosisError, match=r"write time in seconds, .* or as dates such as 2026-"):
        from_csv(file, system)


def test_a_column_may_count_the_other_way_round(system):
    columns = {**SI, "q": -SI["angle"]}
    del columns["angle"]
    found = signals_of("x", with_columns(system, {"angle": "-q"}), columns, 1e5)
    assert (found["angle"] == SI["angle"]).all()


def test_a_column_of_remarks_beside_the_signals_is_not_read(system, tmp_path):
    lines = write(tmp_path / "x.csv", SI).read_text().splitlines()
    words = ["remark", *("" if row % 2 else "valve sticks, 5.0 V" for row in range(len(TIME)))]
    file = tmp_path / "remarks.csv"
    german = (line.replace(",", ";").replace(".", ",") for line in lines)
    file.write_text("\n".join(f"{line};{word}" for line, word in zip(german, words, strict=True)))
    found = from_csv(file, system)
    assert not found.remarks
    for name, values in found.signals.items():
        np.testing.assert_allclose(values, SI[name], rtol=1e-9)


@pytest.mark.parametrize(
    ("mapping", "words"),
    [
        (["angel=q"], "no such signal; did you mean angle?"),
        (["angle"], "give SIGNAL=COLUMN"),
        (["angle=a", "angle=b"], "twice"),
        (["angle=nothing"], "no column nothing for angle"),
        (["angle=extensor_voltage:furlong"], "unknown unit furlong"),
        (["angle=extensor_voltage:bar"], "angle is given in Pa, and needs rad"),
        (
            ["extensor_pressure=flexor_pressure"],
            "column flexor_pressure would be extensor_pressure and flexor_pressure; say by --columns which",
        ),
    ],
)
def test_an_unusable_mapping_says_why(tmp_path, capsys, mapping, words):
    table = write(tmp_path / "x.csv", SI)
    assert main(["gap", str(table), "--columns", *mapping]) == 2
    assert words in capsys.readouterr().err


def test_a_mapping_without_tables_is_refused(tmp_path, capsys):
    bag, *_ = write_example("friction", tmp_path / "case")
    assert main(["gap", str(bag), "--columns", "time=foo", "--until", "check"]) == 2
    assert "--columns: only tables have columns, and these are bags; leave it out" in capsys.readouterr().err


def test_missing_rows_are_bridged_and_counted():
    kept = np.delete(np.arange(1000), [100, 101, 400, 700])
    time, angle, volts = 0.002 * kept, np.sin(kept / 50.0), np.floor(kept / 10.0)
    found = even("x", time, {"angle": angle, "volts": volts}, ["volts"])
    assert "4 of 1000 rows are missing, at most 2 in a row" in found.remarks[0]
    assert found.period == pytest.approx(0.002)
    np.testing.assert_allclose(found.signals["angle"], np.sin(np.arange(1000) / 50.0), atol=4.5e-4)
    expected = np.floor(np.arange(1000) / 10.0)
    expected[[100, 101, 400, 700]] -= [2 / 3, 1 / 3, 0.5, 0.5]  # nothing says where in between it changed
    np.testing.assert_allclose(found.signals["volts"], expected)


def with_cells(path, cells):
    """Write a table with other texts in some cells: (row of numbers, signal) -> text."""
    lines = [line.split(",") for line in write(path, SI).read_text().splitlines()]
    for (row, name), text in cells.items():
        lines[row][list(SI).index(name)] = text
    path.write_text("\n".join(map(",".join, lines)), encoding="utf-8")
    return path


def test_rows_with_cells_that_hold_nothing_are_missing_rows(system, tmp_path):
    cells = {(50, "angle"): "", (51, "time"): "", (200, "flexor_pressure"): "NaN", (600, "angle"): "nan"}
    found = from_csv(with_cells(tmp_path / "x.csv", cells), system)
    first, second = found.remarks
    assert "4 of 600 rows have an empty cell or NaN, most in angle, the first in row 50 of numbers" in first
    assert "3 of 599 rows are missing, at most 2 in a row: interpolated" in second
    np.testing.assert_allclose(found.signals["angle"], SI["angle"][:-1], atol=1e-5)


def test_a_long_stretch_of_empty_cells_cuts(system, tmp_path):
    cells = {(row, "extensor_pressure"): "" for row in range(101, 301)}
    found = from_csv(with_cells(tmp_path / "x.csv", cells), system)
    assert "200 of 600 rows have an empty cell or NaN" in found.remarks[0]
    assert "rows are missing after 0.198 s, more than 5" in found.remarks[1]
    assert "of 2 parts the longest, 300 of 400 rows" in found.remarks[1]
    np.testing.assert_allclose(found.signals["angle"], SI["angle"][300:], atol=1e-9)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (
            range(1, 601),
            "600 of 600 rows have an empty cell or NaN, most in flexor_voltage, the first in row 1",
        ),
        (range(2, 601, 2), "x.csv is not uniform in time: 299 of 599 rows are missing"),
    ],
)
def test_a_signal_that_is_hardly_recorded_is_refused(system, tmp_path, rows, said):
    with pytest.raises(OrthosisError, match=said):
        from_csv(with_cells(tmp_path / "x.csv", {(row, "flexor_voltage"): "" for row in rows}), system)


@pytest.mark.parametrize("name", ["flexor_pressure", "angle"])
def test_a_logger_that_drops_out_is_bridged_before_its_range_is_judged(system, tmp_path, name):
    table = with_cells(tmp_path / "x.csv", dict.fromkeys([(1, name), (100, name), (101, name)], "-9"))
    found = from_csv(table, system)
    (remark,) = found.remarks
    assert f"{name} leaves " in remark
    assert "in 3 of 600 samples, the first in row 1 of numbers: bridged" in remark
    np.testing.assert_allclose(found.signals[name], SI[name], rtol=5e-3)


@pytest.mark.parametrize(
    ("name", "rows"),
    [
        ("flexor_pressure", range(40, 600, 40)),  # too many
        ("flexor_pressure", range(100, 104)),  # too long
        ("flexor_voltage", [100]),  # an input does jump
    ],
)
def test_samples_out_of_range_that_are_no_dropouts_are_counted(system, tmp_path, name, rows):
    said = f"{name} from -9 .* in {len(rows)} of 600 samples, the first in row {rows[0]} of numbers"
    with pytest.raises(OrthosisError, match=said):
        from_csv(with_cells(tmp_path / "x.csv", dict.fromkeys([(row, name) for row in rows], "-9")), system)


def test_a_peak_beyond_the_range_is_no_dropout(system, tmp_path):
    table = {**SI, "angle": SI["angle"] + 1.80001 - SI["angle"].max()}
    with pytest.raises(OrthosisError, match=r"leaves -0.3 to 1.8 rad in . of 600 samples, the first in row"):
        from_csv(write(tmp_path / "x.csv", {**table, "time": 5 * TIME}), system)


def test_a_long_gap_cuts_and_the_longest_part_is_used():
    time = 0.002 * np.concatenate([np.arange(300), np.arange(400, 1000)])
    found = even("x", time, {"angle": time}, [])
    assert (len(found.signals["angle"]), found.start) == (600, pytest.approx(0.8))
    assert "missing after 0.598 s, more than 5: of 2 parts the longest, 600 of" in found.remarks[0]


@pytest.mark.parametrize(("size", "kept"), [(0.02, 1000), (1.0, 699)])
def test_rows_in_which_an_input_leaps_are_no_bridge(size, kept):
    rows = np.arange(1000)
    volts = np.where(rows < 300, 0.0, size) + np.sin(rows / 50.0)
    left = np.delete(rows, [299, 300])
    found = even("x", 0.002 * left, {"angle": left, "volts": volts[left]}, ["volts"])
    assert len(found.signals["angle"]) == kept
    assert found.start == pytest.approx(0.0 if kept == 1000 else 0.602)
    assert ("after 0.596 s, while volts leaps: of 2 parts" in found.remarks[0]) == (kept < 1000)


def test_of_gaps_that_cut_each_has_its_reason():
    rows = np.arange(1000)
    volts = np.where((rows < 300) | (rows > 800), 0.0, 1.0)
    left = np.delete(rows, [*range(100, 110), 299, 300, *range(797, 805), *range(900, 910)])
    found = even("x", 0.002 * left, {"angle": left, "volts": volts[left]}, ["volts"])
    said = "after 0.198, 1.592, 1.798 s, more than 5, and after 0.596 s, while volts leaps: of 5 parts the"
    assert said in found.remarks[0]


def test_uniform_stamps_change_nothing():
    found = even("x", TIME, {"angle": SI["angle"]}, [])
    assert found.signals["angle"] is SI["angle"]
    assert not found.remarks


@pytest.mark.parametrize(
    ("stamp", "said"),
    [
        (TIME[49], "time repeats 0.098 s, in row 51 of numbers; leave out rows that are there twice"),
        (0.0, "time goes back behind 0.098 s, in row 51 of numbers; sort the rows"),
    ],
)
def test_a_stamp_that_does_not_increase_is_named_with_what_to_do(stamp, said):
    at = np.arange(len(TIME))
    time = np.where(at == 50, stamp, TIME)
    if stamp:
        time = np.where((at >= 50) & (at < 150), TIME[at - at % 2 - 1], TIME)
    with pytest.raises(OrthosisError, match=said):
        even("table", time, {"angle": SI["angle"]}, ())


def test_a_few_rows_with_the_stamp_of_the_row_before_are_left_out():
    time, angle = TIME.copy(), SI["angle"].copy()
    time[[50, 51, 200]] = time[[49, 49, 199]]
    found = even("table", time, {"angle": angle}, ())
    assert (
        "3 of 600 rows have the stamp of the row before, the first in row 51 of numbers" in found.remarks[0]
    )
    assert "3 of 600 rows are missing" in found.remarks[1]
    np.testing.assert_allclose(found.signals["angle"], SI["angle"], atol=1e-3)


def test_a_recording_that_a_hole_makes_short_says_so(system):
    one = from_arrays("cut", system, {name: np.delete(x, np.s_[300:320]) for name, x in SI.items()})
    for checked in (lambda: check._check_length(one, 2.0), lambda: check.check_divisible([one], 0.25, 2.0)):
        with pytest.raises(OrthosisError, match=r"cut lasts 0.6 s \(rows are missing after 0.598 s, more"):
            checked()


def test_an_angle_of_the_other_sign_is_refused_with_what_turns_it_round(system, tmp_path):
    table = write(tmp_path / "flipped.csv", {**SI, "angle": -SI["angle"]})
    with pytest.raises(OrthosisError, match=r"or turn its sign round by --columns angle=-COLUMN$"):
        from_csv(table, system)
    mapped = with_columns(system, read_mapping(["angle=-angle"]))
    np.testing.assert_allclose(from_csv(table, mapped).signals["angle"], SI["angle"])


@pytest.mark.parametrize(
    ("column", "mapped", "factor", "said"),
    [
        (
            "extensor_pressure [mbar]",
            [],
            1e-5,
            r" Pa \(2.9 to 3.1 mbar in column {}\) is no absolute pressure",
        ),
        ("p1", ["extensor_pressure=p1:mbar"], 1e-5, r" Pa \(2.9 to 3.1 mbar in column {}\) is no absolute"),
        ("extensor_pressure [bar]", [], 1e-2, r" Pa \(2900 to 3100 bar in column {}\) leaves 80027 to"),
        ("extensor_pressure", [], 1e-5, " is no absolute pressure in Pa .*: in bar, or gauge"),
    ],
)
def test_values_that_cannot_be_are_told_in_the_unit_of_their_column(
    system, tmp_path, column, mapped, factor, said
):
    columns = dict(SI)
    columns[column] = factor * columns.pop("extensor_pressure").round(-4)
    table = write(tmp_path / "x.csv", columns)
    with pytest.raises(
        OrthosisError, match=r"extensor_pressure from \S* to \S*" + said.format(re.escape(column))
    ):
        from_csv(table, with_columns(system, read_mapping(mapped)))


@pytest.mark.parametrize("turned", [(), ("position=-encoder_mm",), ("current=-current",)])
def test_signals_of_the_other_sign_that_nothing_forbids_are_named(tmp_path, turned):
    known = load_system(EXAMPLES / "motor_carriage.py")
    system = with_columns(known, read_mapping([*turned])) if turned else known
    table, gap = Path(motor_bench.write(tmp_path / "carriage.csv", 1, 0.0)), load().gap
    start = beginning.begin(system, [from_csv(table, system)], [], gap)
    words = mistake_words(start.held_out, gap.replay.cross_cutoff)
    for name in ("position", "current"):  # nothing else is driven or drives: each does as well as the other
        asked = f"with {name} of the other sign: turn it round by --columns {name}=-COLUMN"
        assert (asked in words) == bool(turned)
    assert start.mistaken == bool(words) == bool(turned)
    assert [one for one in start.remarks if "fits them" in one] == [words] * bool(turned)
    assert not (turned and start.stamps)


def test_a_replay_that_goes_astray_shows_no_mistake(monkeypatch, tmp_path):
    system = with_columns(load_system(EXAMPLES / "motor_carriage.py"), read_mapping(["current=-current"]))
    table, gap = Path(motor_bench.write(tmp_path / "carriage.csv", 1, 0.0)), load().gap
    start = beginning.begin(system, [from_csv(table, system)], [], gap)
    assert start.mistaken
    monkeypatch.setattr(mistakes, "_follows", lambda *_: False)
    assert not mistake_words(start.held_out, gap.replay.cross_cutoff)
    monkeypatch.undo()
    far = measure.Gap({"position": 1.0}, {"position": 9.0, measure.OVERALL: 9.0})
    assert not mistakes._follows(start.held_out, far), "the carriage moves by much less than 1 m"


def test_too_many_missing_rows_are_refused():
    time = 0.002 * np.delete(np.arange(1000), np.s_[::9])
    with pytest.raises(OrthosisError, match=r"110 of 998 rows are missing.*; at most 5% may be"):
        even("x", time, {"angle": time}, [])


@pytest.mark.parametrize("lost", [0, 20])
def test_late_stamps_are_no_missing_rows(lost):
    places = np.delete(np.arange(2000.0), np.arange(1, lost + 1) * 90)
    places[5::40] += 0.7  # a step of 1.7 periods, then one of 0.3
    found = even("x", 0.002 * places, {"angle": places}, [])
    said = "; ".join(found.remarks)
    assert (f"{lost} of 2000 rows are missing" in said) == bool(lost)
    assert "resampled every 2 ms" in said
    np.testing.assert_allclose(found.signals["angle"], np.arange(2000.0), atol=1e-6)


def test_stamps_that_jitter_are_refused_as_such():
    time = 0.002 * (np.arange(3000) + 0.3 * np.random.default_rng(0).standard_normal(3000)).clip(0)
    time = np.sort(time) + 1e-9 * np.arange(3000)
    with pytest.raises(
        OrthosisError, match=r"its stamps jitter, .*; at most 20% may differ, or all by 20%"
    ) as told:
        even("x", time, {"angle": time}, [])
    assert "missing" not in str(told.value)


def test_pressures_stamped_late_are_found_and_others_are_not(documented):
    status, folder = documented("pam-orthosis example friction --out case")
    assert status == 0
    nominal = load({"valve.dead_band": 0.0, "valve.delay": 0.0})
    system = knee(nominal)
    one = recording(folder / "case" / "training_gait", system)
    assert not skews(system, one), "a missing friction is no skew"
    (skew,) = skews(system, stamped_late(one, 0.004, ("extensor_pressure", "flexor_pressure")))
    assert skew.signals == ("extensor_pressure", "flexor_pressure")
    assert skew.seconds == pytest.approx(0.004, abs=0.001)
    late = {f"effects.{name}_pressure_delay.{key}": value for name in ("extensor", "flexor")
            for key, value in (("enabled", True), ("delay", 0.004))}  # fmt: skip
    known = knee(nominal.changed(late))
    assert not skews(known, stamped_late(one, 0.004, ("extensor_pressure", "flexor_pressure")))


@pytest.mark.parametrize("every", [1, 4])
def test_sound_recordings_show_no_skew_however_far_their_samples_are_apart(every):
    parameters = load(scenario_overrides("person"))
    arrays = ClosedLoop(parameters, 1).run(2400)
    system = knee(parameters)
    assert not skews(system, from_arrays("x", system, {name: arrays[name][::every] for name in SI}))


def stamped_late(one, seconds, names):
    late = round(seconds / one.period)
    return replace(one, signals={k: v[:-late] if k in names else v[late:] for k, v in one.signals.items()})


@pytest.mark.parametrize("name", ["extensor_pressure", "flexor_pressure"])
def test_one_pressure_stamped_late_is_found_and_each_recording_has_its_remark(documented, name):
    status, folder = documented("pam-orthosis example friction --out case")
    assert status == 0
    system = knee(load({"valve.dead_band": 0.0, "valve.delay": 0.0}))
    one, other = (recording(folder / "case" / f"training_{kind}", system) for kind in ("diagnostic", "gait"))
    assert not remarks_on_stamps(system, [one, other])
    (skew,) = skews(system, stamped_late(one, 0.006, (name,)))
    assert skew.signals == (name,)
    assert skew.seconds == pytest.approx(0.006, abs=0.001)
    told = remarks_on_stamps(system, [stamped_late(one, 0.006, (name,)), other])
    assert f"{one.name}: {name} stamped" in told[0]
    stated = f"effects.{name}_delay"
    assert told[0].endswith(f"or state the delay (`{stated}.enabled` and `.delay` in a model file)")
    known = {f"{stated}.enabled": True, f"{stated}.delay": skew.seconds}
    nominal = knee(load({"valve.dead_band": 0.0, "valve.delay": 0.0, **known}))
    assert not skews(nominal, stamped_late(one, 0.006, (name,))), "which is what a user gets who does so"
    assert told[1].startswith(f"{other.name} does not show by itself")
    assert not remarks_on_stamps(system, [stamped_late(one, 0.006, (name,)), other, other])


@pytest.mark.parametrize(
    ("nominal", "true"), [("leg.cogwheel_diameter", 0.14), ("leg.symmetric_angle", None)]
)
def test_a_wrong_dimension_is_no_skew(bench, nominal, true):
    true = true or bench.parameters.flat()[nominal] + 0.3
    one = bench.recording(1, **{nominal.replace(".", "__"): true})
    assert not skews(bench.system, one)
    late = round(0.01 / one.period)  # and does not hide one
    shifted = {k: v[late:] if k == "angle" else v[:-late] for k, v in one.signals.items()}
    (skew,) = skews(bench.system, replace(one, signals=shifted))
    # friction and damping that may be missing resemble a lag and take a part of it, with the right model
    # too (5 ms are read as 3.2): a wrong dimension must not add to that
    assert abs(skew.seconds - 0.01) < STEP


@pytest.mark.parametrize(("ms", "shown", "said"), [(4, 1, False), (4, 2, True), (7, 1, True), (-7, 1, True)])
def test_a_small_skew_is_shown_by_more_than_half_of_the_recordings(monkeypatch, ms, shown, said):
    """Slack muscles, or a strong damping that the model lacks, look like one in some of them."""
    skew = stamps.Skew("angle", ("extensor_pressure",), 0.001 * ms, 0.1)
    monkeypatch.setattr(stamps, "skews", lambda _, one: [skew] if one.name < shown else [])
    recordings = [SimpleNamespace(name=number) for number in range(2)]
    assert bool(remarks_on_stamps(PLAIN, recordings)) is said


@pytest.mark.parametrize(("without", "said"), [(0.007, True), (None, False), (-0.007, False)])
def test_a_skew_that_shows_by_an_effect_of_the_model_alone_is_none(monkeypatch, without, said):
    """A backlash that recordings have not looks like one; a delay that the model has stays in any case."""
    known = ("backlash", "extensor_pressure_delay")
    model = knee(load({f"effects.{name}.enabled": True for name in known}))

    def seen(system, _):
        assert "extensor_pressure_delay" in system.simpler
        seconds = 0.007 if "backlash" in system.simpler else without
        return [stamps.Skew("angle", ("extensor_pressure",), seconds, 0.1)] if seconds else []

    monkeypatch.setattr(stamps, "skews", seen)
    remarks = remarks_on_stamps(model, [SimpleNamespace(name="x"), SimpleNamespace(name="y")])
    assert [one[:1] for one in remarks] == ["x", "y"] * said
    assert all("7.0 ms late" in one for one in remarks)


@pytest.mark.parametrize(
    ("signal", "seconds", "stated"),
    [
        (
            "torque",
            -0.007,
            ", or state the delay (`effects.angle_delay.enabled` and `.delay` in a model file)",
        ),
        ("external_torque", 0.007, ""),
    ],
)
def test_a_remark_on_stamps_says_where_a_machine_states_such_a_delay(monkeypatch, signal, seconds, stated):
    skew = stamps.Skew("angle", (signal,), seconds, 0.1)
    monkeypatch.setattr(stamps, "skews", lambda *_: [skew])
    (remark,) = remarks_on_stamps(knee(load()), [SimpleNamespace(name="x")])
    assert remark.endswith(f"give all signals one clock{stated}")


def test_one_skew_about_the_limit_is_said_of_all_that_show_it_or_of_none(monkeypatch):
    shown = {0: 0.0047, 1: 0.0055}
    found = {name: [stamps.Skew("angle", ("torque",), seconds, 0.1)] for name, seconds in shown.items()}
    monkeypatch.setattr(stamps, "skews", lambda _, one: found.get(one.name, []))
    recordings = [SimpleNamespace(name=number) for number in range(4)]
    told = remarks_on_stamps(PLAIN, recordings)
    assert [line.split(":")[0] for line in told[:2]] == ["0", "1"]
    assert told[0].endswith("give all signals one clock, or state the delay (`late` of a Model)")


@pytest.mark.parametrize(("period", "kept"), [(0.001, False), (0.005, True)])
def test_voltages_of_a_loop_faster_than_the_table_are_left_out_by_name(
    tmp_path, monkeypatch, capsys, period, kept
):
    table = write(tmp_path / "slow.csv", {**SI, "time": 2.5 * TIME})
    model = tmp_path / "nominal.yaml"
    model.write_text(f"scenario.control_period: {period}\n")

    def begun(_system, recordings, *_):
        (one,) = recordings
        assert ("extensor_voltage" in one.signals) == kept
        raise OrthosisError(f"read: {' '.join(one.remarks)}")

    monkeypatch.setattr(beginning, "begin", begun)
    monkeypatch.setattr(workflow, "begin", begun)
    with pytest.raises(OrthosisError, match="read:") as of_library:
        answers.gap([table], model=model)
    assert main(["gap", str(table), "--model", str(model)]) == 2
    words = "change every 1 ms by scenario.control_period and were recorded every 5 ms: left out"
    told = capsys.readouterr().err
    assert str(of_library.value) in in_python(told)
    assert (words in told) != kept
    assert ("record faster, or correct scenario.control_period (of tables by --model)" in told) != kept


def test_what_is_left_out_is_not_called_absent(system):
    one = with_prompt_inputs(from_arrays("x", system, {**SI, "time": 10 * TIME}), system, 0.002)
    assert one.left_out == system.inputs
    remarks = check.check(system, [one.part(0, 600, "part")], 2.0)
    assert not any("has no extensor_voltage" in remark for remark in remarks)


@pytest.mark.parametrize(
    ("stated", "kept", "said"),
    [
        (False, True, "change every 10 rows: the loop's period is taken to be 20 ms"),
        (True, False, "change every 2 ms by scenario.control_period and were recorded every 20 ms: left out"),
    ],
)
def test_voltages_that_are_held_for_rows_tell_the_period_of_the_loop(system, stated, kept, said):
    held = {name: np.repeat(SI[name][::10], 10) for name in system.inputs}
    one = with_loop_of_table(from_arrays("x", system, {**SI, **held}), system, 0.002, stated)
    assert ("extensor_voltage" in one.signals) == kept
    assert said in one.remarks[0]


def test_steps_of_an_experiment_and_coarse_voltages_tell_no_period(system):
    for volts in (np.repeat([5.0, 5.2, 4.9], 200), np.round(SI["extensor_voltage"])):
        arrays = {**SI, "extensor_voltage": volts, "flexor_voltage": volts}
        (remark,) = with_loop_of_table(from_arrays("x", system, arrays), system, 0.002, False).remarks
        assert "the loop's period is assumed to be 2 ms" in remark


@pytest.mark.parametrize(
    ("rows", "model", "said"),
    [
        (2, "", "the loop's period is assumed to be 5 ms; if it is shorter than 4 ms, they are too old"),
        (3, "", "change every 5 ms by the default of scenario.control_period and were recorded every 6 ms"),
        (2, "scenario.control_period: 0.004", ""),
        (3, "scenario.control_period: 0.006", ""),
        (2, "scenario.control_period: 0.002", "change every 2 ms by scenario.control_period and were"),
    ],
)
def test_a_period_of_the_loop_that_is_assumed_is_said_once(bench, tmp_path, rows, model, said):
    runs = {seed: bench.arrays(seed) for seed in (1, 2)}
    tables = [
        write(tmp_path / f"{seed}.csv", {name: arrays[name][::rows] for name in SI})
        for seed, arrays in runs.items()
    ]
    nominal = tmp_path / "nominal.yaml"
    nominal.write_text(f"valve.dead_band: 0.0\nvalve.delay: 0.0\n{model}\n", encoding="utf-8")
    read = read_recordings(Asked(tables, [], nominal), Workers(1))
    remarks = [one for one in check.check(read.nominal.system, read.training, 2.0) if "period" in one]
    assert all(said in one and "scenario.control_period" in one for one in remarks)
    assert len(remarks) == (2 if "change every" in said else bool(said))  # what is left out: of each


@pytest.fixture(scope="module")
def friction(tmp_path_factory):
    return write_example("friction", tmp_path_factory.mktemp("friction") / "case")


GAUGE = {"extensor_pressure": -1.013e5, "flexor_pressure": -1.013e5}
LONG_ENOUGH = 6000  # samples
SEEMS = ": gauge, it seems, where absolute pressure is needed"
MIXED = {"extensor_voltage": "flexor_voltage", "flexor_voltage": "extensor_voltage"}


@pytest.mark.parametrize(
    ("offsets", "columns", "order", "said"),
    [
        ({}, {}, 1, ""),
        (GAUGE, {}, 1, f"with 1.013 bar added to extensor_pressure and flexor_pressure{SEEMS}"),
        ({"extensor_pressure": -1.013e5}, {}, 1, f"with 1.013 bar added to extensor_pressure{SEEMS}"),
        ({"flexor_pressure": -1.013e5}, {}, 1, f"with 1.013 bar added to flexor_pressure{SEEMS}"),
        ({}, MIXED, 1, "with extensor_voltage and flexor_voltage exchanged: are these columns mixed up?"),
        ({}, {}, -1, "with the last row first: does time run backwards, or has an input the other sign?"),
    ],
)
def test_what_seems_wrong_with_recordings_is_named(friction, tmp_path, capsys, offsets, columns, order, said):
    names, files = [name for name in SI if name != "time"], []
    for bag in (friction[0], friction[-1]):
        read = read_bag(bag, names)
        table = {"time": read["angle"].stamp_ns * 1e-9}
        table |= {name: read[columns.get(name, name)].value + offsets.get(name, 0.0) for name in names}
        table = {name: values[:LONG_ENOUGH] for name, values in table.items()}
        table |= {name: table[name][::order] for name in names}
        files.append(str(write(tmp_path / f"{bag.name}.csv", table)))
    (tmp_path / "model.yaml").write_text("valve.dead_band: 0.0\nvalve.delay: 0.0\n", encoding="utf-8")
    model = str(tmp_path / "model.yaml")
    assert main(["gap", files[0], "--held-out", files[1], "--model", model, "--until", "check"]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("CHECK THE RECORDINGS")]
    assert len(lines) == bool(said)
    assert all(line.endswith(said) for line in lines)


def test_what_explains_recordings_that_seem_mistaken_is_no_explanation(bench, tmp_path, capsys, monkeypatch):
    files = []
    for seed in (1, 2):
        arrays = bench.arrays(seed)
        files.append(str(write(tmp_path / f"{seed}.csv", {name: arrays[name] for name in SI})))
    model, mistake = tmp_path / "model.yaml", "CHECK THE RECORDINGS: gauge, it seems"
    model.write_text("valve.dead_band: 0.0\nvalve.delay: 0.0\n", encoding="utf-8")
    asked = ["gap", files[0], "--held-out", files[1], "--model", str(model)]
    assert main([*asked, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["verdict"] in {"none", "recalibrated"}
    monkeypatch.setattr(beginning, "mistake_words", lambda *_: mistake)
    assert main([*asked, "--out", str(tmp_path / "found")]) == 1
    lines = capsys.readouterr().out.splitlines()
    said = json.loads((tmp_path / "found" / "gap.json").read_text(encoding="utf-8"))
    assert (said["verdict"], mistake in said["remarks"]) == ("unexplained", True)
    last = "UNEXPLAINED: the recordings seem to have a mistake (CHECK THE RECORDINGS); recalibration may only"
    assert lines[-1].startswith(last)
    assert lines.count(mistake) == 1
    assert gap_page.MISTAKEN in (tmp_path / "found" / "gap.html").read_text(encoding="utf-8")
    found = answers.gap(files[:1], files[1:], model)  # the library says the same
    assert found.words.splitlines()[-1] == lines[-1]
    assert found.words.startswith(f"the apparatus is assumed: {files[0]} and 1 more")


def test_a_large_skew_that_explains_little_is_none():
    shifts = stamps._shifts()

    def left(skew, gain):
        return 1.0 - gain + gain * ((shifts - skew) / skew) ** 2

    assert stamps._least(left(0.006, 0.1), 0.0025) == pytest.approx((0.006, 0.1), rel=0.03)
    assert stamps._least(left(0.014, 0.2), 0.0025) == pytest.approx((0.014, 0.2), rel=0.03)
    assert stamps._least(left(0.014, 0.14), 0.0025) is None
    assert stamps._least(left(0.006, 0.04), 0.0025) is None
    assert stamps._least(left(0.006, 0.1), 0.01) is None, "less than half a sample of 20 ms"


@pytest.mark.parametrize(
    ("nominal", "delay", "empty"), [(0.0, -0.006, True), (0.0, -0.0005, False), (0.0099, -0.006, False)]
)
def test_a_valve_that_acts_before_its_command_is_none(nominal, delay, empty):
    system = knee(load({"valve.delay": nominal}))
    model = SimpleNamespace(values={"valve_delay.delay": delay})
    assert bool(emptied(system, "valve_delay", model)) == empty


def test_a_voltage_of_the_other_sign_is_refused_with_what_turns_it_round(bench, tmp_path):
    arrays = bench.arrays(1)
    table = {name: arrays[name] for name in SI} | {"extensor_voltage": -arrays["extensor_voltage"]}
    with pytest.raises(OrthosisError, match=r"leaves -2 to 12 V.*--columns extensor_voltage=-COLUMN"):
        recording(write(tmp_path / "minus.csv", table), bench.system)


@pytest.mark.parametrize(
    ("reason", "closes", "told"),
    [
        ("valve_delay would not be what its name says: valve_delay.delay = -0.006", 0.99, True),
        ("valve_delay would not be what its name says: valve_delay.delay = -0.006", 0.3, False),
        ("valve_delay would not be what its name says: valve_delay.delay = 0.05", 0.99, False),
        ("creep would not be what its name says: creep.time_constant = 30", 0.99, False),
        ("held-out recordings do not confirm valve_delay", 0.0, False),
    ],
)
def test_inputs_that_seem_stamped_late_are_told(bench, reason, closes, told):
    remarks = between.stamped_late(bench.system, [SimpleNamespace(reason=reason, closes=closes)])
    assert len(remarks) == told
    assert all("as if extensor_voltage and flexor_voltage were stamped late" in one for one in remarks)


def test_a_lost_cell_is_bridged_before_all_else(bench, tmp_path, capsys):
    files = []
    for seed in (1, 2):
        arrays = bench.arrays(seed)
        table = {name: arrays[name].copy() for name in SI}
        table["angle"][2000] = 0.0
        files.append(str(write(tmp_path / f"{seed}.csv", table)))
    assert main(["gap", files[0], "--held-out", files[1], "--until", "replay"]) == 0
    told = capsys.readouterr().out
    assert told.count("angle jumps by up to") == 2
    noise = next(line for line in told.splitlines() if line.startswith("angle [deg]")).split()[-1]
    assert float(noise) < 0.06


def test_a_wrong_value_of_a_machine_is_refused_in_the_name_of_its_file(tmp_path):
    """Not of the recording that is read with it."""
    file, table = tmp_path / "own.yaml", write(tmp_path / "gait.csv", {"time": TIME, **SI})
    shipped = (config_folder() / "machines" / "ankle.yaml").read_text(encoding="utf-8")
    file.write_text(shipped.replace("values:", "values:\n  valve.delayy: 0.004", 1), encoding="utf-8")
    with pytest.raises(
        OrthosisError, match=r"own\.yaml: values of the machine .* unknown parameter"
    ) as refused:
        read_recordings(Asked([table], [], machine=file), Workers(1))
    assert "gait.csv" not in str(refused.value)
