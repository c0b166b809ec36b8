# SPDX-License-Identifier: Apache-2.0
"""The paper's results again: what is measured is measured right, and the committed figures are these."""

import json
import re
from base64 import b64decode
from html import unescape
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from pam_orthosis.identification.data import read_data
from pam_orthosis.identification.identify import identify
from pam_orthosis.model.components.muscle import towing_force
from pam_orthosis.model.parameters import load
from pam_orthosis.model.truth import as_modelled
from pam_orthosis.report.pages import paper as pages
from pam_orthosis.report.paper import by_hand, drawings, force_rate, inertia, observer, table, tracking

ROOT = Path(__file__).resolve().parents[2]
BEGINNING = "steady-state error at the beginning of the step"
ROWS = json.loads((ROOT / "benchmarks" / "results" / "paper.json").read_text(encoding="utf-8"))["rows"]


@pytest.fixture(scope="module")
def simulated():
    return observer.observe()


@pytest.fixture(scope="module")
def on_hardware():
    return observer.observe(exact=False)


@pytest.fixture(scope="module")
def walked():
    return tracking.track()


def shown(result, unit):
    """Return the first number with a unit of a committed result."""
    (row,) = (row for row in ROWS if row["result"] == result)
    return float(re.search(rf"([\d.]+) {unit}", row["here"])[1])


@pytest.fixture
def identified(tmp_path):
    """What is identified from the forces of a muscle by its rows in `config/`, one pressure held out."""
    m, lines = load().muscle.dmsp_20, ["p_Pa_gauge,dL_m,F_N"]
    for pressure, contraction in product(np.arange(1, 7) * 1e5, np.linspace(0.0, 0.2, 12) * m.map_length):
        force = float(towing_force(contraction * m.length / m.map_length, pressure, m))
        lines += [f"{pressure},{contraction},{force}"] if force > 0 else []
    (tmp_path / "dmsp20.csv").write_text("\n".join(lines), encoding="utf-8")
    return identify(read_data([tmp_path / "dmsp20.csv"]), [3e5])


def test_lag_and_gain_are_found_beside_noise_and_another_frequency():
    time = np.arange(0, 10, 0.005)
    noise = 0.2 * np.random.default_rng(3).standard_normal(len(time))
    other = 1.5 * np.sin(2 * np.pi * 0.5 * time + 0.3)
    true = 2 * np.sin(2 * np.pi * 0.8 * time) + other
    late = 1.8 * np.sin(2 * np.pi * 0.8 * (time - 0.018)) + other + noise
    lag, gain = observer.lag_and_gain(time, true, time, late, (0.8, 0.5))
    assert lag == pytest.approx(0.018, abs=0.001)
    assert gain == pytest.approx(0.9, abs=0.01)


def test_the_disturbance_is_estimated_within_20_ms(simulated, on_hardware):
    settings = simulated.parameters.control.observer
    sensor = on_hardware.parameters.plant.effects.extensor_pressure_delay.delay  # pressures come late there
    for run, late in ((simulated, 0.0), (on_hardware, sensor)):
        assert run.lag <= 0.020
        assert run.lag == pytest.approx((1 + 2 * settings.damping) / settings.pole + late, abs=0.001)
        assert run.gain == pytest.approx(1.0, abs=0.02)


def test_the_pattern_of_the_poles_saves_lag_at_the_same_noise(simulated):
    equal = observer.observe({observer.DAMPING: 1.0})
    assert equal.lag > 1.4 * simulated.lag
    assert simulated.velocity_noise == pytest.approx(equal.velocity_noise, rel=0.15)


def test_what_the_equation_of_motion_lacks_is_the_torque_where_nothing_else_disturbs():
    """The measure of the emulated hardware's disturbance, tried where the answer is known."""
    found = observer.observe(as_modelled(load()), exact=False)
    middle = found.signals["time"] - found.parameters.scenario.control_period / 2
    frequencies = found.parameters.plant.external_frequency, 1 / found.parameters.scenario.cycle_time
    known = -found.signals["true_torque"]
    settled = middle > observer.SETTLING
    late = found.disturbance_time[settled], found.disturbance[settled]
    lag, gain = observer.lag_and_gain(middle[settled], known[settled], *late, frequencies)
    assert abs(lag) < 0.0005
    assert gain == pytest.approx(1.0, abs=0.01)


def test_the_committed_figures_are_those_that_are_measured(simulated, on_hardware, walked):
    near = {"rel": 0.1}
    assert shown("lag of the estimated disturbance", "ms") == pytest.approx(simulated.lag * 1e3, **near)
    assert shown("the same on the emulated hardware", "ms") == pytest.approx(on_hardware.lag * 1e3, **near)
    noise = np.degrees(simulated.velocity_noise)
    assert shown("noise of the estimated velocity", "deg/s") == pytest.approx(noise, **near)
    assert shown("maximum tracking error", "deg") == pytest.approx(walked.largest, **near)
    assert shown(BEGINNING, "deg") == pytest.approx(walked.beginnings.max(), **near)
    assert shown("the same, steps from rest to rest", "deg") == pytest.approx(walked.rests.max(), **near)
    assert shown("force model, DMSP-20", "N maximum") <= 30.0
    assert walked.largest <= 3.0
    assert walked.beginnings.max() < 1.0
    assert walked.rests.max() < 1.0
    assert len(walked.beginnings) == tracking.CYCLES - 1
    assert len(walked.rests) >= 2 * tracking.CYCLES - 2


def test_the_page_shows_what_was_measured(identified, simulated, on_hardware, walked, tmp_path, page_fits):
    points = [
        observer.TradeOff(pole, damping, 2 / pole, 0.001 * pole, 0.8, 0.01 * pole, pole)
        for damping in observer.PATTERNS
        for pole in (50.0, 100.0)
    ]
    moved = by_hand.Moved("knee", False, "slow", *np.random.default_rng(1).standard_normal((5, 9)))
    held = force_rate.ForceRate("observed", 3.0, 0.04, 50.0, 2.0, 1e-4)
    found = table.Results(
        identified, simulated, on_hardware, points, walked, [(moved, moved)], [held], inertia.compared()
    )
    page = tmp_path / "paper.html"
    page.write_text(pages.page(found, drawings.schemes()), encoding="utf-8")
    page_fits(page)
    text = unescape(page.read_text(encoding="utf-8"))
    assert f"Tracking: {walked.largest:.2f} deg at most" in text
    for row in table.rows(found):
        assert f"<td>{row.result}</td><td>{row.paper}</td><td>{row.here}</td>" in text
    for one in table.tables(found.as_dict()):
        assert one.words in text
        for row in one.rows:
            assert "".join(f"<td>{cell}</td>" for cell in row) in text
    assert text.count("data:image/png;base64,") == len(drawings.SCHEMES)
    curves = [one for plot in re.findall(r'data-plot="([^"]*)"', page.read_text(encoding="utf-8"))
              for one in json.loads(unescape(plot))["data"]]  # fmt: skip
    drawn = {one["name"]: np.frombuffer(b64decode(one["y"]["bdata"])) for one in curves}
    error = walked.reference - walked.angle
    assert np.nanmax(drawn["error"]) == pytest.approx(error[~np.isnan(walked.phase)].max(), abs=1e-9)
    over_time = next(np.frombuffer(b64decode(one["y"]["bdata"])) for one in curves if one["name"] == "error")
    assert over_time.max() == pytest.approx(error.max(), abs=1e-9)
    assert over_time.min() == pytest.approx(error.min(), abs=1e-9)
    for name in observer.PATTERNS.values():
        assert drawn[name].tolist() == [0.5, 1.0]  # of the last panel
