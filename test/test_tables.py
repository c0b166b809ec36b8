# SPDX-License-Identifier: Apache-2.0
"""One reader of CSV tables, with the same hints for whoever reads them."""

import numpy as np
import pytest

from pam_orthosis.cli.main import main
from pam_orthosis.errors import OrthosisError
from pam_orthosis.identification.data import read_data
from pam_orthosis.tables import read_numbers

MUSCLE = [
    "p_Pa_gauge,L_m,F_N",
    *(f"{bar}00000,{0.29 - 0.01 * k},{100 * bar}" for bar in (2, 3) for k in (0, 1, 2)),
]
KNEE = ["time,angle,extensor_pressure,flexor_pressure", *(f"{0.002 * k:.3f},0.6,3e5,3e5" for k in range(6))]


def spreadsheet(lines):
    """Return a table as a spreadsheet writes it, with a comment of its user and rows that were cleared."""
    empty = "," * lines[0].count(",")
    return b"\xef\xbb\xbf" + "\r\n".join(["# measured today", *lines, empty, "  ", ""]).encode()


@pytest.mark.parametrize("lines", [MUSCLE, KNEE])
def test_what_spreadsheets_write_is_what_scripts_write(lines, tmp_path):
    plain, sheet = tmp_path / "plain.csv", tmp_path / "SHEET.CSV"
    plain.write_text("\n".join(lines))
    sheet.write_bytes(spreadsheet(lines))
    one, other = read_numbers(plain), read_numbers(sheet)
    assert list(one) == list(other) == lines[0].split(",")
    assert all(np.array_equal(one[name], other[name]) for name in one)
    assert len(one[lines[0].split(",")[0]]) == 6


@pytest.mark.parametrize("parting", [";", "\t"])
@pytest.mark.parametrize("lines", [MUSCLE, KNEE])
def test_semicolons_and_tabs_part_columns_as_commas_do(lines, parting, tmp_path):
    plain, other = tmp_path / "plain.csv", tmp_path / "other.csv"
    plain.write_text("\n".join(lines))
    other.write_text("\n".join(['"# one, of; many"', *(line.replace(",", parting) for line in lines)]))
    one, same = read_numbers(plain), read_numbers(other)
    assert list(one) == list(same)
    assert all(np.array_equal(one[name], same[name]) for name in one)


@pytest.mark.parametrize("parting", [";", "\t"])
@pytest.mark.parametrize("lines", [MUSCLE, KNEE])
def test_decimal_commas_are_read_where_no_commas_part_the_columns(lines, parting, tmp_path):
    plain, german = tmp_path / "plain.csv", tmp_path / "german.csv"
    plain.write_text("\n".join(lines))
    german.write_text("\n".join(line.replace(",", parting).replace(".", ",") for line in lines))
    one, same = read_numbers(plain), read_numbers(german)
    assert list(one) == list(same)
    assert all(np.array_equal(one[name], same[name]) for name in one)


def test_columns_that_nobody_chooses_hold_what_they_like(tmp_path):
    file = tmp_path / "remarks.csv"
    file.write_text("t;remark;q;;\n0;;1,5;;\n1;valve opened, 5.0 V;2;;\n")
    found = read_numbers(file, lambda names: [name for name in names if name in {"t", "q"}])
    assert {name: values.tolist() for name, values in found.items()} == {"t": [0.0, 1.0], "q": [1.5, 2.0]}
    with pytest.raises(OrthosisError, match="line 2, column remark: the cell is empty"):
        read_numbers(file)


def test_identify_reads_what_a_spreadsheet_wrote(tmp_path):
    plain = tmp_path / "plain.csv"
    plain.write_text("\n".join(MUSCLE))
    folder = tmp_path / "measured"
    folder.mkdir()
    (folder / "DMSP-20.CSV").write_bytes(spreadsheet(MUSCLE))
    samples = read_data([folder], "dmsp_20").samples
    assert np.array_equal(samples.force, read_data([plain], "dmsp_20").samples.force)


def second_cell(rows, text):
    """Return a table with another text in the second cell of its second row of numbers."""
    first, _, *rest = rows[2].split(",")
    return [*rows[:2], ",".join([first, text, *rest]), *rows[3:]]


BROKEN = {
    "line 3, column {second}: 'one' is no number": lambda rows: second_cell(rows, "one"),
    "line 3, column {second}: '1_5' is no number": lambda rows: second_cell(rows, "1_5"),
    "line 3, column {second}: 'inf' is not finite": lambda rows: second_cell(rows, "inf"),
    "line 2: {more} cells below {count} names": lambda rows: [rows[0], f"{rows[1]},1"],
    "two columns give '{first}'; leave one": lambda rows: [f"{rows[0]},{rows[0].split(',')[0]}", *rows[1:]],
    "line 2, column {second}: '0,6' is no number; write a point in place of the comma": lambda rows: [
        rows[0],
        ",".join(["0", '"0,6"', *rows[1].split(",")[2:]]),
    ],
    "line 2, column {second}: '1.234,5' is no number; write no sign between thousands": lambda rows: [
        rows[0].replace(",", ";"),
        ";".join(["0", "1.234,5", *rows[1].split(",")[2:]]),
    ],
    "line 3, column {second}: '0,6' has a comma, numbers before it have a point; write": lambda rows: [
        *(row.replace(",", ";") for row in rows[:2]),
        ";".join(["0", "0,6", *rows[2].split(",")[2:]]),
    ],
    "no rows of numbers below its row of names": lambda rows: rows[:1],
    "is empty": lambda _: [],
}


@pytest.mark.parametrize("said", BROKEN)
@pytest.mark.parametrize(("verb", "rows"), [("identify", MUSCLE), ("gap", KNEE)])
def test_both_verbs_give_the_same_hint(verb, rows, said, tmp_path, capsys):
    file = tmp_path / "dmsp20.csv"
    file.write_text("\n".join(BROKEN[said](rows)))
    names = rows[0].split(",")
    wanted = said.format(second=names[1], first=names[0], count=len(names), more=len(names) + 1)
    assert main([verb, str(file)]) == 2
    told = capsys.readouterr().err.splitlines()[-1]
    assert str(file) in told
    assert wanted in told


@pytest.mark.parametrize(
    ("cell", "said"), [(" ", "the cell is empty; write a number"), ("nan", "not finite")]
)
def test_a_cell_without_a_number_is_nan_only_where_that_is_asked_for(cell, said, tmp_path, capsys):
    file = tmp_path / "dmsp20.csv"
    file.write_text("\n".join(second_cell(MUSCLE, cell)))
    assert main(["identify", str(file)]) == 2
    assert said in capsys.readouterr().err
    lengths = read_numbers(file, lost=True)["L_m"]
    assert np.isnan(lengths).tolist() == [False, True, False, False, False, False]


MISSING = "'n/a' is no number; leave the cell empty, or write NaN, if the value is missing"
STAMP = "2026-11-02T10:00:00.000000"


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("0.002,n/a,1e5", f"line 3, column angle [deg]: {MISSING}"),
        (
            f"{STAMP},30,1e5",
            f"line 3, column time: '{STAMP}' is no number; write time in seconds, as a number",
        ),
        ("10:00:00,30,1e5", "'10:00:00' is no number; write time in seconds"),
        ("2026-11-02 10:00:00,30,1e5", "write time in seconds"),
    ],
)
@pytest.mark.parametrize("first", ["0,30,1e5", ""])
def test_a_cell_that_is_no_number_says_what_to_write(first, row, said, tmp_path):
    file = tmp_path / "x.csv"
    file.write_text(f"time,angle [deg],p\n{first or '#'}\n{row}\n", encoding="utf-8")
    with pytest.raises(OrthosisError) as refused:
        read_numbers(file, lost=True)
    assert said in str(refused.value)


def _dates(file, *stamps):
    rows = "\n".join(f'"{one}";1' for one in stamps)
    file.write_text(f"t;a\n{rows}\n", encoding="utf-8")
    return read_numbers(file, lost=True, dated=lambda names: names[:1])["t"]


@pytest.mark.parametrize(
    "stamps",
    [
        ("2026-11-02T10:00:59.998", "2026-11-02T10:01:00", "2026-11-02T10:01:00.002"),
        ("2026-12-31 23:59:59,9980", "2027-01-01 00:00:00,0000", "2027-01-01 00:00:00,0020"),
        ("10:00:59.998000", "10:01:00.000000", "10:01:00.002000"),
        ("2026-10-25T02:59:59.998+02:00", "2026-10-25T02:00:00+01:00", "2026-10-25T02:00:00.002+01:00"),
        ("2026-11-02T10:00:59.998Z", "2026-11-02T10:01:00Z", "2026-11-02T10:01:00.002Z"),
    ],
)
def test_dates_and_times_of_the_day_are_seconds_since_the_first(stamps, tmp_path):
    assert _dates(tmp_path / "x.csv", *stamps) == pytest.approx([0.0, 0.002, 0.004], abs=1e-9)


def test_a_stamp_that_is_missing_is_nan(tmp_path):
    read = _dates(tmp_path / "x.csv", "", "10:00:00", "nan", "10:00:01")
    assert read == pytest.approx([np.nan, 0, np.nan, 1], nan_ok=True)


@pytest.mark.parametrize(
    ("stamps", "said"),
    [
        (("10:00:00", "1.5"), "line 3, column t: '1.5' is a number below dates"),
        (("1.5", "", "10:00:00"), "'10:00:00' is no number; write time in seconds"),
        (("10:00:00", STAMP), f"'{STAMP}' is not written as the dates above"),
        ((STAMP, f"{STAMP}Z"), f"'{STAMP}Z' is not written as the dates above"),
        (("2026-13-02 10:00:00",), "there is no such time: month must be in 1..12"),
        (("10:60:00",), "there is no such time: minute must be in 0..59"),
        (("23:59:59.9", "00:00:00.1"), "line 3, column t: the clock passes midnight: write the dates too"),
        (("10:00:00 Uhr",), "is no number; write time in seconds"),
    ],
)
def test_stamps_that_are_unlike_those_before_them_are_refused(stamps, said, tmp_path):
    with pytest.raises(OrthosisError) as refused:
        _dates(tmp_path / "x.csv", *stamps)
    assert said in str(refused.value)


def test_a_value_that_is_missing_where_none_may_be_leaves_the_row_out(tmp_path):
    file = tmp_path / "x.csv"
    file.write_text("a,b\n1,n/a\n", encoding="utf-8")
    with pytest.raises(OrthosisError, match="'n/a' is no number; leave the row out if the value is missing"):
        read_numbers(file)


@pytest.mark.parametrize("units", ["ms,deg,bar", "[ms],°,bar gauge", ",deg,", "s,rad,m/s^2"])
@pytest.mark.parametrize(("lost", "example"), [(True, ", as `time [ms]`,"), (False, "")])
def test_a_row_of_units_is_told_from_numbers(units, lost, example, tmp_path):
    file, first = tmp_path / "x.csv", units.strip(",").partition(",")[0]
    file.write_text(f"time,angle,p\n{units}\n0,30,1\n", encoding="utf-8")
    with pytest.raises(OrthosisError) as refused:
        read_numbers(file, lost=lost)
    told = f"if this is a row of units, leave it out and write them in the names{example} above"
    assert str(refused.value) == f"{file}, line 2: '{first}' is no number; {told}"


@pytest.mark.parametrize("first", ["nan,NaN,nan", ",,0", "-1,.5,+.5", ",nan,"])
def test_a_first_row_of_numbers_is_no_row_of_units(first, tmp_path):
    file = tmp_path / "x.csv"
    file.write_text(f"time,angle,p\n{first}\n0,30,1\n", encoding="utf-8")
    assert len(read_numbers(file, lost=True)["time"]) == 2


def test_names_are_checked_before_a_long_table_is_read(tmp_path):
    file = tmp_path / "x.csv"
    file.write_text("a,b\nno,numbers\n")

    def refuse(names):
        raise OrthosisError(f"not {names}")

    with pytest.raises(OrthosisError, match=r"not \['a', 'b'\]"):
        read_numbers(file, refuse)
