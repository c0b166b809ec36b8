# SPDX-License-Identifier: Apache-2.0
"""Tables: units in the columns' names, and what is wrong with a table is said."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pam_orthosis.cli.main import main
from pam_orthosis.errors import OrthosisError
from pam_orthosis.identification.data import read_data
from pam_orthosis.identification.identify import identify
from pam_orthosis.identification.table import read_table

MEASURED = Path(__file__).resolve().parents[3] / "shared" / "data" / "muscle"
AMBIENT = 1.013e5
GOOD = ["p_Pa_gauge,L_m,F_N,slack", "200000,0.29,300,0", "300000,0.27,250,0", "200000,0.22,0,1"]


def table(tmp_path, lines):
    path = tmp_path / "t.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize(
    "other",
    [
        ["p_bar_abs,L_mm,F_kN", "3.013,290,0.3", "4.013,270,0.25"],
        ["p [psig],L [in],F [lbf]", "29.007548,11.4173228,67.4426827", "43.5113220,10.6299213,56.2022356"],
        ["p_MPa_gauge,L_cm,F_kgf", "0.2,29,30.5914865", "0.3,27,25.4929054"],
    ],
)
def test_the_same_data_in_other_units_are_the_same(tmp_path, other):
    si = read_table(table(tmp_path, GOOD), AMBIENT)
    read = read_table(table(tmp_path, other), AMBIENT)
    assert read.pressure == pytest.approx(si.pressure[:2])
    assert read.length == pytest.approx(si.length[:2])
    assert read.force == pytest.approx(si.force[:2])


def test_contractions_in_either_unit_are_the_same(tmp_path):
    metres = read_table(
        table(tmp_path, ["p_Pa_gauge,dL_m,F_N", "200000,0.01,300", "300000,0.03,250"]), AMBIENT
    )
    other = read_table(table(tmp_path, ["p_kPa_gauge,dL_mm,F_N", "200,10,300", "300,30,250"]), AMBIENT)
    assert metres.contraction.tolist() == [0.01, 0.03]
    assert other.contraction == pytest.approx(metres.contraction)
    assert other.pressure == pytest.approx(metres.pressure)


@pytest.mark.parametrize(("unit", "metres_a_second"), [("m_s", 1.0), ("mm_s", 1e-3)])
def test_rates_and_deviations_name_their_unit_too(tmp_path, unit, metres_a_second):
    rows = [f"2,0.29,0.3,0.004,{0.05 / metres_a_second}", f"3,0.27,0.25,0.005,{-0.05 / metres_a_second}"]
    read = read_table(table(tmp_path, [f"p_bar_gauge,L_m,F_kN,sigma_F_kN,v_{unit}", *rows]), AMBIENT)
    assert read.rate == pytest.approx([0.05, -0.05])
    assert read.sigma == pytest.approx([4.0, 5.0])
    assert read.pressure == pytest.approx([2e5, 3e5])


def test_absolute_pressures_are_reduced_by_the_ambient_one(tmp_path):
    lines = ["p_bar_abs,L_mm,F_kN", "3.013,290,0.3", "4.013,270,0.25"]
    assert read_table(table(tmp_path, lines), 9.0e4).pressure == pytest.approx([211300, 311300])


@pytest.mark.parametrize(
    ("names", "rows"),
    [
        ("pressure [bar gauge],length [mm],force [kN]", ["2,290,0.3", "3,270,0.25"]),
        ("Pressure (psi abs),Contraction (cm),Force (N)", ["43.7003,1,300", "58.2041,3,250"]),
        ("p [MPa a],L (cm),F [N]", ["0.3013,29,300", "0.4013,27,250"]),
        ("p_mbar_rel,L_m,F_N", ["2000,0.29,300", "3000,0.27,250"]),
        ("p [barg],L_m,F_N", ["2,0.29,300", "3,0.27,250"]),
    ],
)
def test_units_may_be_spelled_as_for_gap(tmp_path, names, rows):
    read = read_table(table(tmp_path, [names, *rows]), AMBIENT)
    contraction = 0.3 - read.length if read.contraction is None else read.contraction
    assert read.pressure == pytest.approx([2e5, 3e5], rel=1e-4)
    assert contraction == pytest.approx([0.01, 0.03])
    assert read.force == pytest.approx([300, 250])


def test_marks_may_begin_with_a_capital(tmp_path):
    read = read_table(table(tmp_path, ["p_bar_g,L_m,F_N,Direction,Slack", "2,0.29,300,-1,0"]), AMBIENT)
    assert (read.direction.tolist(), read.marked) == ([-1], True)


def test_a_column_that_holds_no_quantity_is_left_unread_and_named(tmp_path):
    remarked = [f"{line},{text}" for line, text in zip(GOOD[:3], ("remark", "cold", ""), strict=True)]
    path = table(tmp_path, remarked)
    assert read_table(path, AMBIENT).force.tolist() == [300, 250]
    (said,) = read_data([path], "dmsp_20", 0.3).assumed
    assert said.endswith(": remark")
    assert not read_data([table(tmp_path, GOOD)], "dmsp_20", 0.3).assumed


def test_slack_rows_are_left_out_but_for_the_force_free_end(tmp_path):
    lines = [*GOOD, "300000,0.22,0,1", "200000,0.25,0,1"]
    read = read_table(table(tmp_path, lines), AMBIENT)
    assert read.pressure.tolist() == [200000, 300000, 300000]
    assert read.force.tolist() == [300, 250, 0]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["p_Pa_gauge,L_m,F_N,slack", "200000,0.29,0,1", "300000,0.28,0,1"], "slack in every row"),
        (["p,L_m,F_N", "2,0.29,0"], "no column for the pressure; name it e.g. p_Pa_gauge; not read: p"),
        (
            ["p,L,F", "2,0.29,0"],
            "units are Pa, hPa, kPa, MPa, bar, mbar, psi, m, mm, cm, in, N, kN, kgf, lbf",
        ),
        (["p_bar,L_m,F_N", "2,0.29,0"], "write p_bar_gauge or p_bar_abs"),
        (["pressure [bar],L_m,F_N", "2,0.29,0"], "write pressure_bar_gauge or pressure_bar_abs"),
        (["p_bar_abs,p (bar gauge),L_m,F_N", "3,2,0.29,0"], "two columns give the pressure"),
        (["p_Pa_gauge,p_bar_gauge,L_m,F_N", "200000,2,0.29,0"], "two columns"),
        (["p_Pa_gauge,L_m,F_N", "2,0.29,300", "3,0.29,400"], "is the unit bar"),
        (["p_Pa_gauge,L_m,F_N", "200000,0.29,300", "3,0.29,400"], "different units"),
        (["p_Pa_gauge,L_m,F_N", "200000,290,300"], "implausible"),
        (["p_Pa_gauge,L_m,F_N", "200000,0.29,nan"], "not finite"),
        (["p_Pa_gauge,L_m,F_N", "200000,0.29,many"], "many"),
        (["p_Pa_gauge,L_m,F_N", "200000,0.29"], "3 names"),
        (["p_Pa_gauge,L_m,F_N"], "no rows of numbers"),
        (["p_Pa_gauge,F_N", "200000,3"], "length"),
        (["p_Pa_gauge,L_m", "200000,0.29"], "force"),
        ([""], "empty"),
    ],
)
def test_an_unusable_table_says_why(tmp_path, lines, message):
    with pytest.raises(OrthosisError, match=message):
        read_table(table(tmp_path, lines), AMBIENT)


def test_contractions_that_begin_far_off_are_no_wrong_nominal_length(tmp_path):
    rows = ["200000,{},300", "300000,{},250"]
    given = table(tmp_path, ["p_Pa_gauge,dL_m,F_N", *(row.format(0.05) for row in rows)])
    assert read_data([given], "dmsp_20", 0.3).samples.contraction.tolist() == [0.05, 0.05]
    lengths = table(tmp_path, ["p_Pa_gauge,L_m,F_N", *(row.format(0.25) for row in rows)])
    with pytest.raises(OrthosisError, match="do not fit a nominal length"):
        read_data([lengths], "dmsp_20", 0.3)


RAMP = np.linspace(0.0, 6.0e5, 50)


@pytest.mark.parametrize(
    "pressure",
    [
        RAMP + 300.0 * np.random.default_rng(0).standard_normal(50),
        np.concatenate([[1.5], RAMP[1:]]),
        np.concatenate([[40.0, 250.0, 310.0], RAMP[20:]]),
    ],
    ids=["noise", "one near zero", "steps from a zero that is off"],
)
def test_a_ramp_from_zero_is_in_one_unit(tmp_path, pressure):
    rows = [f"{p:.3f},0.29,{max(p - 3e4, 0) * 1e-3:.3f}" for p in pressure]
    assert len(read_table(table(tmp_path, ["p_Pa_gauge,L_m,F_N", *rows]), AMBIENT).pressure) == len(pressure)


@pytest.mark.parametrize("factor", [1e-5, 1e-3])
@pytest.mark.parametrize("names", ["p_Pa_gauge,L_m,F_N", "p_Pa_gauge,dL_m,V_l"])
def test_rows_in_different_units_are_refused(tmp_path, factor, names):
    pressure = np.linspace(1e5, 6e5, 12)
    pressure[::3] *= factor
    rows = [f"{p:.8g},0.29,0.3" for p in pressure]
    with pytest.raises(OrthosisError, match=r"pressure from .* rows in different units"):
        read_table(table(tmp_path, [names, *rows]), AMBIENT)


def test_a_table_of_another_nominal_length_is_refused(tmp_path):
    path = table(tmp_path, ["p_Pa_gauge,L_m,F_N", "200000,0.20,300", "300000,0.19,200"])
    with pytest.raises(OrthosisError, match="nominal length"):
        read_data([path], "dmsp_20")


def measured(name):
    if not MEASURED.is_dir():
        pytest.skip("the measured tables lie in ../shared, which is not there")
    return read_data([MEASURED / f"{name}_static_FLP.csv"])


def test_the_measured_map_of_a_dmsp_20_gives_the_published_fit():
    found = identify(measured("dmsp20_300"))
    assert len(found.training) == 61
    told = found.errors(held_out=False)
    assert told["rms"] == pytest.approx(3.5, abs=0.1)
    assert told["max"] == pytest.approx(9.5, abs=0.2)
    assert found.force.model.a[0] == pytest.approx(2.763e-3, rel=2e-3)


def test_nine_coefficients_on_six_lengths_interpolate_and_that_is_said():
    found = identify(measured("dmsp20_300"))
    rms = {round(x * 1e3): e[0] for x, e in found.left_out["length"].items()}
    inside = [rms[x] for x in (18, 33, 50, 63)]
    assert 10 < min(inside) <= max(inside) < 30
    assert min(rms[4], rms[78]) > 60, "the ends are not predicted by the rest"
    assert found.box.minimum_contraction == pytest.approx(0.004)
    assert found.box.maximum_contraction == pytest.approx(0.078)


def test_both_muscles_at_once_are_refused():
    measured("dmsp20_300")
    with pytest.raises(OrthosisError, match="one muscle"):
        read_data([MEASURED])


def test_the_measured_map_of_a_dmsp_10_needs_its_force_free_end_for_nine_coefficients():
    data = measured("dmsp10_250")
    assert data.length == 0.25
    assert identify(data).force.rank == 9
    with pytest.raises(OrthosisError, match="only 8 of 9"):
        identify(replace(data, samples=data.samples.where(data.samples.force > 0)))
    assert np.isclose(identify(data, degrees=(3, 3)).force.rank, 8)


def test_data_that_cannot_be_fitted_are_named(tmp_path, capsys):
    rows = (f"{bar}00000,0.01,{100 * bar}" for bar in range(1, 7) for _ in range(3))
    lines = ["p_Pa_gauge,dL_m,F_N", *rows]
    path = table(tmp_path, lines)
    assert main(["identify", str(path), "--muscle", "dmsp_20", "--damping", "240"]) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith(f"pam-orthosis: error: {path}: ")


@pytest.mark.parametrize(
    ("names", "rows", "words"),
    [
        ("t_s,p_Pa_gauge,dL_m,m_kg", [f"{i / 100:g},3e5,0.03,40" for i in range(200)], "swings; at least"),
        ("p_Pa_gauge,dL_m,V_l", [f"{p}e5,{x / 100},0.1" for p in (1, 2) for x in range(4)], "few pressures"),
    ],
)
def test_of_several_tables_the_one_that_is_refused_is_named(tmp_path, capsys, names, rows, words):
    force, other = tmp_path / "force.csv", tmp_path / "other.csv"
    p, x = (one.ravel() for one in np.meshgrid(np.linspace(1e5, 6e5, 6), np.linspace(0.001, 0.05, 9)))
    fitted = np.column_stack([p, x, p * 2.7e-3 * (1 - 7 * x) - 9e3 * x + 1e5 * x**2])
    np.savetxt(force, fitted, delimiter=",", header="p_Pa_gauge,dL_m,F_N", comments="")
    other.write_text("\n".join([names, *rows]) + "\n")
    assert main(["identify", str(force), str(other), "--muscle", "dmsp_20"]) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert said.startswith(f"pam-orthosis: error: {other}: ")
    assert words in said


STEPS = range(1, 101)


@pytest.mark.parametrize(
    ("pressure_name", "row", "words"),
    [
        ("p_Pa_gauge", lambda i: (1e5 + i, 0.29, -10.0 * i), "other sign: a pull is positive"),
        ("p_Pa_abs", lambda i: (6e4 + 1e3 * i, 0.29, 3.0 * i), "named absolute hold gauge values"),
        (
            "p_Pa_gauge",
            lambda i: (1e5, 0.29, 9e9 if i in (7, 80) else 300),
            r"2 of 100 rows, first row 7 \(9e",
        ),
        ("p_Pa_gauge", lambda i: (1e5, 0.29, 3e4 * i), "check the unit in the column's name"),
    ],
)
def test_what_makes_a_column_implausible_is_said(tmp_path, pressure_name, row, words):
    rows = [",".join(f"{one:g}" for one in row(i)) for i in STEPS]
    with pytest.raises(OrthosisError, match=f"is implausible; .*{words}"):
        read_table(table(tmp_path, [f"{pressure_name},L_m,F_N", *rows]), AMBIENT)


def test_a_direction_of_ones_and_zeros_is_refused(tmp_path):
    def read(codes):
        rows = [f"2e5,0.29,300,{codes[i % 2]}" for i in STEPS]
        return read_table(table(tmp_path, ["p_Pa_gauge,L_m,F_N,direction", *rows]), AMBIENT).direction

    with pytest.raises(OrthosisError, match="direction is 1 or 0: write -1 where"):
        read((1, 0))
    for codes in ((1, -1), (0, -1), (1, 1)):
        assert set(read(codes)) == set(codes)


HELD = "t_s,p_Pa_gauge,L_m,F_N,repeat"


@pytest.mark.parametrize(
    ("time", "repeat", "message"),
    [
        (lambda i: i // 5 * 0.5, lambda i: 0, "two rows have the time 0 s; write it with more digits"),
        (lambda i: i % 2, lambda i: 0, r"600 runs .*, 300 at most; sort the rows"),
        (lambda i: i, lambda i: i, "1200 repeats, 300 at most; number whole measurements"),
    ],
)
def test_a_time_or_repeats_that_give_each_row_a_run_are_refused(tmp_path, time, repeat, message):
    def read(time, repeat):
        rows = [f"{time(i)},{200000 + i},{0.29 - 1e-5 * i},300,{repeat(i)}" for i in range(1200)]
        return read_data([table(tmp_path, [HELD, *rows])], "dmsp_20")

    with pytest.raises(OrthosisError, match=message):
        read(time, repeat)
    assert len(read(lambda i: i, lambda i: i // 600).samples) == 1200
