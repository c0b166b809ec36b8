# SPDX-License-Identifier: Apache-2.0
"""`identify` on tables as a real rig gives them: slack rows, noise, hysteresis, repeats, mistakes."""

import json

import numpy as np
import pytest
from muscle_rig import LENGTH, LEVELS, repeat, static_force, write

from pam_orthosis.cli.identify import describe
from pam_orthosis.cli.main import main
from pam_orthosis.discrepancy.answer import patch
from pam_orthosis.errors import OrthosisError
from pam_orthosis.identification.data import read_data
from pam_orthosis.identification.force import fit_force, rms_and_max
from pam_orthosis.identification.groups import grouped
from pam_orthosis.identification.identify import identify, usable
from pam_orthosis.identification.own import own_bench
from pam_orthosis.identification.trust import taut
from pam_orthosis.model.parameters import load


def read(path, **more):
    return read_data([path], "dmsp_20", LENGTH, **more)


def coefficients(fit):
    return np.concatenate([fit.model.a, fit.model.b])


@pytest.fixture(scope="module")
def three(tmp_path_factory):
    """Three repeats in one table."""
    random = np.random.default_rng(1)
    rows = np.vstack([repeat(number, random) for number in range(3)])
    return write(tmp_path_factory.mktemp("rig") / "three.csv", rows)


@pytest.fixture
def static(tmp_path):
    """Return a table of a static map, changed in its pressures (Pa), lengths (m) and forces (N)."""

    def of(change, names="p_Pa_gauge,L_m,F_N"):
        p, x = (one.ravel() for one in np.meshgrid(LEVELS, np.linspace(0.001, 0.075, 9)))
        force = static_force(x, p)
        taut = force > 0
        return write(tmp_path / "map.csv", change(p[taut], LENGTH - x[taut], force[taut]), names)

    return of


def test_rows_of_the_slack_muscle_are_found_and_left_out(three):
    found = identify(read(three))
    (remark,) = (one for one in found.remarks if "slack" in one)
    assert " of 2160 rows left out" in remark
    s = found.training
    taut = static_force(s.contraction, s.pressure) > 0
    assert taut.mean() > 0.99
    assert len(s) > 0.95 * (static_force(*_states(three)) > 0).sum()
    every = read(three).samples
    slack_too = rms_and_max(fit_force(every).model.residual(every))[0]
    assert found.errors(held_out=False)["rms"] < 0.5 * slack_too


def test_few_rows_at_turning_points_do_not_bend_the_fit(tmp_path):
    """By time they are at rest, by a column direction they move: the same muscle."""
    out = np.linspace(0.001, 0.05, 61)
    x, way = np.tile(np.r_[out, out[-2::-1]], 6), np.tile(np.repeat([1.0, -1.0], [61, 60]), 6)
    p, time = np.repeat(LEVELS + 1.5e5, 121), np.arange(726) * 0.1 + np.repeat(np.arange(6), 121) * 60.0
    shown = static_force(x, p) - 20.0 * way
    columns = {"p_Pa_gauge": p, "L_m": LENGTH - x, "F_N": shown, "t_s": time, "direction": way}
    files = [
        write(tmp_path / f"{last}.csv", np.column_stack([columns[n] for n in names]), ",".join(names))
        for last in ("t_s", "direction")
        for names in [("p_Pa_gauge", "L_m", "F_N", last)]
    ]
    timed, marked = (identify(read(file)) for file in files)
    assert 0 < (timed.training.direction == 0).sum() < 0.03 * len(p)
    apart = timed.force.model.towing(x, p) - marked.force.model.towing(x, p)
    assert np.abs(apart).max() < 1.5
    printed = describe(timed)
    assert f" samples: neighbours err alike, they are worth {timed.force.effective:.0f}\n" in printed
    assert "  shortening " in printed
    assert "  rest " not in printed


@pytest.fixture(scope="module")
def rubbing(tmp_path_factory):
    """Three repeats with much friction: the model is off by far more than the load cell's noise."""
    random = np.random.default_rng(8)
    rows = np.vstack([repeat(number, random, hysteresis=90.0, buckling=0.0) for number in range(3)])
    return write(tmp_path_factory.mktemp("rig") / "rubbing.csv", rows)


def test_rows_that_pull_are_not_slack_however_far_off_the_model_is(rubbing):
    data = read(rubbing)
    kept, zero = taut(data.samples, 0.0, (3, 4))
    pulling = data.samples.where(kept)
    assert rms_and_max(fit_force(pulling).model.residual(pulling))[0] > 30
    noise_and_zeros = 12.0  # N: a load cell's noise of 1 N, zeros of the repeats some 3 N apart
    assert data.samples.force[~kept].max() < noise_and_zeros
    assert abs(zero) < noise_and_zeros
    assert (static_force(*_states(rubbing))[~kept] < 100).all()


def test_a_load_cell_whose_zero_is_off_is_a_caution(rubbing, three, tmp_path):
    def zero_off(path, newtons):
        rows = np.loadtxt(path, delimiter=",", skiprows=1)
        rows[:, 3] += newtons
        remarks = identify(read(write(tmp_path / "off.csv", rows))).remarks
        return [one for one in remarks if "is its zero off?" in one]

    (caution,) = zero_off(rubbing, 60.0)
    assert float(caution.split("shows ")[1].split(" N")[0]) == pytest.approx(60.0, abs=4.0)
    assert zero_off(rubbing, -60.0)
    assert not zero_off(rubbing, 0.0)
    assert not zero_off(three, 0.0)


@pytest.mark.parametrize("zero", [120.0, 30.0, -30.0])
def test_few_rows_that_are_hardly_slack_show_a_zero_that_is_off(tmp_path, zero):
    """The smallest forces level off, though the model goes less below zero than it is off."""
    random, largest = np.random.default_rng(11), 0.03  # m: the muscle is slack at the lowest pressure alone
    p, x, way = (one.ravel() for one in np.meshgrid(LEVELS, np.linspace(0.001, largest, 80), [1.0, -1.0]))
    force = static_force(x, p)
    assert 0 < (force < 0).mean() < 0.05
    shown = np.maximum(force - 5e-5 * p * way, 0.0) + zero + 0.5 * random.standard_normal(len(p))
    rows = np.column_stack([p, LENGTH - x, shown, way])
    remarks = identify(read(write(tmp_path / "z.csv", rows, "p_Pa_gauge,L_m,F_N,direction"))).remarks
    (caution,) = (one for one in remarks if "is its zero off? Subtract it" in one)
    assert float(caution.split("shows ")[1].split(" N")[0]) == pytest.approx(zero, abs=3.0)


def _states(path):
    s = read(path).samples
    return s.contraction, s.pressure


def test_scattered_pressures_are_levels_and_swept_ones_are_parts():
    random = np.random.default_rng(2)
    levels = np.repeat(LEVELS, 50) + 800 * random.standard_normal(300)
    found = grouped(levels, 3e3, 3e4, 30)
    assert len(np.unique(found)) == len(LEVELS)
    assert np.abs(np.unique(found) - LEVELS).max() < 400
    assert len(np.unique(grouped(np.linspace(0, 6e5, 5000), 3e3, 3e4, 30))) == 8


def test_the_hysteresis_is_reported(three):
    assert identify(read(three)).hysteresis.mean == pytest.approx(13.0, abs=2.5)


def test_a_direction_column_says_it_without_time(three, tmp_path):
    data = read(three).samples
    rows = np.column_stack([data.pressure, data.contraction, data.force, data.direction])
    other = identify(read(write(tmp_path / "d.csv", rows, "p_Pa_gauge,dL_m,F_N,direction")))
    assert other.hysteresis == pytest.approx(identify(read(three)).hysteresis, abs=0.5)


def test_groups_are_left_out_as_a_whole(three):
    found = identify(read(three)).left_out
    assert {kind: len(errors) for kind, errors in found.items()} == {"level": 6, "length": 8, "repeat": 3}
    ends = [found["length"][at][0] for at in (min(found["length"]), max(found["length"]))]
    assert max(ends) > 1.3 * np.median([e[0] for e in found["length"].values()]), (
        "no neighbour helps at an end"
    )


def test_intervals_of_repeats_hold_for_another_repeat(tmp_path):
    random = np.random.default_rng(4)

    def samples(count):
        rows = np.vstack([repeat(number, random, samples=20) for number in range(count)])
        return usable(read(write(tmp_path / "c.csv", rows)), 0.0, (3, 4))[0]

    others = np.array([coefficients(fit_force(samples(1))) for _ in range(12)])
    fits = [fit_force(samples(4)) for _ in range(6)]
    assert {one.clustered for one in fits} == {"repeats"}
    held = [np.abs(coefficients(one) - others) < one.half_width for one in fits]
    assert np.mean(held) > 0.9


def test_rows_that_the_load_cell_clipped_are_left_out(static):
    found = identify(read(static(lambda p, length, f: np.column_stack([p, length, np.minimum(f, 600.0)]))))
    assert any("exactly 600 N" in one for one in found.remarks)
    clean = identify(read(static(lambda p, length, f: np.column_stack([p, length, f]))))
    assert not clean.remarks
    spoilt, kept, true = (one.model.a[0] for one in (fit_force(found.data.samples), found.force, clean.force))
    assert abs(kept - true) < 0.2 * abs(spoilt - true)


def test_a_clipped_load_cell_with_noise_is_seen(three, tmp_path):
    rows = np.loadtxt(three, delimiter=",", skiprows=1)
    noise = 0.3 * np.random.default_rng(9).standard_normal(len(rows))
    ends = rows[:, 3] > 900
    rows[ends, 3] = 900 + noise[ends]
    found = identify(read(write(tmp_path / "clipped.csv", rows)))
    (remark,) = (one for one in found.remarks if "the load cell or its amplifier ends there" in one)
    assert float(remark.split("about ")[1].split(" N")[0]) == pytest.approx(900, abs=0.1)
    assert ends.sum() <= int(remark.split()[0]) < 1.1 * ends.sum()
    assert not any("amplifier ends" in one for one in identify(read(three)).remarks)


@pytest.mark.parametrize("force", [lambda f: -0.05 * f, lambda f: 0.0 * f, lambda f: 0.0 * f + 5.0])
def test_forces_that_are_no_pull_are_refused(static, force):
    with pytest.raises(OrthosisError, match="a pull is positive, and not always the same"):
        identify(read(static(lambda p, length, f: np.column_stack([p, length, force(np.abs(f))]))))


def test_weights_that_hang_on_the_muscle_are_no_end_of_the_load_cell(tmp_path):
    random = np.random.default_rng(10)
    p, x = (one.ravel() for one in np.meshgrid(np.linspace(1e5, 6e5, 400), np.linspace(0.001, 0.075, 300)))
    force = static_force(x, p)
    weights = np.array([100.0, 250.0, 400.0, 550.0, 700.0, 850.0])
    held = np.abs(force[:, None] - weights).min(axis=1) < 1.0
    rows = np.column_stack([p, LENGTH - x, force + 0.3 * random.standard_normal(len(p))])[held]
    remarks = identify(read(write(tmp_path / "weights.csv", rows, "p_Pa_gauge,L_m,F_N"))).remarks
    assert not any("amplifier ends" in one for one in remarks)


@pytest.mark.parametrize(
    ("change", "names", "words"),
    [
        (lambda p, x, f: (p + 1.013e5, x, f), "p_Pa_gauge,L_m,F_N", "absolute and named gauge"),
        (lambda p, x, f: (p, x, f), "p_Pa_abs,L_m,F_N", "gauge and named absolute"),
    ],
)
def test_gauge_and_absolute_pressure_mixed_up_are_a_caution(static, change, names, words):
    found = identify(read(static(lambda *rows: np.column_stack(change(*rows)), names)))
    assert any(words in one for one in found.remarks)


def test_a_wrong_nominal_length_is_no_muscle(static):
    path = static(lambda p, length, f: np.column_stack([p, length, f]))
    with pytest.raises(OrthosisError, match="as no muscle does; check --nominal-length-m"):
        identify(read_data([path], "dmsp_20", 0.328))


def test_one_noisy_pressure_is_one_pressure(static):
    random = np.random.default_rng(3)

    def only(p, length, f):
        kept = p == LEVELS[3]
        many = np.tile(np.column_stack([p, length, f])[kept], (20, 1))
        return many + [800.0, 0.0, 1.0] * random.standard_normal(many.shape)

    with pytest.raises(OrthosisError, match="at 1 pressures"):
        identify(read(static(only)))


def test_a_nominal_length_that_was_assumed_is_said(static, capsys):
    path = static(lambda p, length, f: np.column_stack([p, length, f]))
    assert main(["identify", str(path), "--muscle", "dmsp_20"]) == 0
    assert "the nominal length, 0.3 m, is that of the dmsp_20 in config/" in capsys.readouterr().out


def test_a_muscle_of_any_size_by_its_own_geometry(static, tmp_path, capsys):
    path = static(lambda p, length, f: np.column_stack([p, length, 4 * f]))
    assert main(["identify", str(path), "--muscle", "dmsp_20"]) == 2
    assert "give its geometry by --muscle FILE" in capsys.readouterr().err
    own, out = tmp_path / "own.yaml", tmp_path / "rows.yaml"
    own.write_text("length: 0.3\ndiameter: 0.04\n")
    assert main(["identify", str(path), "--muscle", str(own), "--out", str(out), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    read_back = load(patch.read(out)).muscle.dmsp_20
    assert read_back.force.a[0] == pytest.approx(found["a"][0])
    assert (read_back.geometry.diameter, read_back.length) == (0.04, 0.3)


@pytest.mark.parametrize("nearest", [0.0, 0.02])
@pytest.mark.parametrize("times", [0.5, 1.0, 2.0])
def test_a_force_that_no_muscle_of_the_size_has_is_a_caution(static, nearest, times):
    def scaled(p, length, f):
        rows = np.column_stack([p, length, times * f])
        return rows[length < LENGTH - nearest]

    said = [one for one in identify(read(static(scaled))).remarks if "of a braid of 20 mm" in one]
    assert len(said) == (times != 1.0)
    assert all("units of force" in one and "--muscle FILE" in one for one in said)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("diameter: 0.04", "no length"),
        ("length: 0.3\ndiameter: 40", "diameter"),
        (
            "length: 0.3\ndiameter: 0.04\nfiber_angle: 0.5",
            "has no .fiber_angle.; did you mean fibre_angle?",
        ),
    ],
)
def test_an_unusable_geometry_says_why(tmp_path, text, words):
    path = tmp_path / "own.yaml"
    path.write_text(text)
    with pytest.raises(OrthosisError, match=words.replace("?", r"\?")):
        own_bench(path)


def test_decay_and_volume_come_from_tables_too(static, tmp_path):
    force = static(lambda p, length, f: np.column_stack([p, length, f]))
    time = 0.002 * np.arange(1500)
    mass, damping, stiffness = 70.0, 250.0, 2.0e4
    rate = np.sqrt(stiffness / mass - (damping / (2 * mass)) ** 2)
    swing = 0.012 * np.exp(-damping / (2 * mass) * time)
    x = 0.03 + swing * np.cos(rate * time)
    v = np.gradient(x, time)
    pull = 687.0 - stiffness * (x - 0.03) - damping * v
    decay = np.column_stack([time, np.full(1500, 3e5), x, pull, np.full(1500, mass)])
    write(tmp_path / "decay.csv", decay, "t_s,p_Pa_gauge,dL_m,F_N,m_kg")
    p, x = (one.ravel() for one in np.meshgrid([1e5, 3e5, 5e5], [0.0, 0.02, 0.04, 0.06]))
    volume = np.column_stack([p, x, 94.0 * (1 + 14 * x - 60 * x**2) * (1 + 4e-8 * p)])
    write(tmp_path / "volume.csv", volume, "p_Pa_gauge,dL_m,V_cm3")
    paths = [force, tmp_path / "decay.csv", tmp_path / "volume.csv"]
    found = identify(read_data(paths, "dmsp_20", LENGTH))
    assert found.damping.decrement == pytest.approx(damping, rel=0.03)
    assert found.volume.v == pytest.approx(94e-6 * np.array([1, 14, -60]), rel=0.01)


def as_they_are(*rows):
    return np.column_stack(rows)


def test_a_row_far_from_the_rest_is_named(static):
    def off(p, length, force):
        force[20] += 600.0
        return np.column_stack([p, length, force])

    (remark,) = (one for one in identify(read(static(off))).remarks if "far from the rest" in one)
    assert remark.startswith("caution: 1 of ")
    assert float(remark.split("off by ")[1].split(" N")[0]) > 300
    assert not any("far from" in one for one in identify(read(static(as_they_are))).remarks)


@pytest.mark.parametrize("appended", [True, False])
def test_copies_that_have_a_time_count_once_too(three, tmp_path, appended):
    rows = np.loadtxt(three, delimiter=",", skiprows=1)
    twice = np.tile(rows, (2, 1)) if appended else np.repeat(rows, 2, axis=0)
    found = read(write(tmp_path / "twice.csv", twice))
    assert len(found.samples) == len(rows)
    assert f"{len(rows)} rows left out: they repeat an earlier one" in found.assumed[-1]
    assert not read(three).assumed


def test_a_table_without_directions_tells_no_errors_of_rows_at_rest(static):
    assert "  rest " not in describe(identify(read(static(as_they_are))))


def test_the_printed_box_begins_where_the_data_do(static):
    def stretched(p, length, force):
        return np.column_stack([p, length + 0.007, force])

    assert "contraction -6.0 .. " in describe(identify(read(static(stretched))))


def test_rows_that_are_copies_count_once(static):
    once = identify(read(static(as_they_are)))
    twice = identify(read(static(lambda *rows: np.tile(np.column_stack(rows), (2, 1)))))
    rows = len(once.training)
    assert f"{rows} of {2 * rows} rows left out: they repeat an earlier one" in "\n".join(twice.remarks)
    assert twice.force.half_width == pytest.approx(once.force.half_width)
    assert not any("repeat an earlier" in one for one in once.remarks)
