# SPDX-License-Identifier: Apache-2.0
"""The dead time of the emulated hardware: its parts, and that it acts to the nanosecond."""

import numpy as np
import pytest

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.delay import Line, computing_ns, line_ns
from pam_orthosis.model.parameters import load
from pam_orthosis.model.plant import Plant
from pam_orthosis.model.study import Study

PARTS = ("computing", "converter", "valve", "hose_length")
SENSORS = {f"plant.effects.{muscle}_pressure_delay.enabled": False for muscle in ("extensor", "flexor")}
NONE = {**{f"plant.delay.{part}": 0.0 for part in PARTS}, **SENSORS}
PERIOD_NS = 5_000_000
FINE_NS = 50_000
VOLTAGES = [(6.2, 4.4), (5.9, 4.0), (4.1, 6.0), (5.5, 5.5)]


def moved(plant, voltages=VOLTAGES):
    for pair in voltages:
        plant.advance(*pair)
    return plant.state[:4].copy()


def undelayed(acting):
    """Return the state after as many periods, the voltages being those of (instant ns, pair) in turn."""
    fine = {"scenario.control_period": FINE_NS / 1e9, "plant.simulation.step": FINE_NS / 1e9}
    plant, coming, pair = Plant(load(NONE).substituted(fine)), list(acting), (5.0, 5.0)
    for instant in range(0, len(VOLTAGES) * PERIOD_NS, FINE_NS):
        while coming and coming[0][0] <= instant:
            pair = coming.pop(0)[1]
        plant.advance(*pair)
    return plant.state[:4].copy()


def test_the_shipped_device_loses_about_eight_milliseconds():
    p = load()
    sensors = [getattr(p.plant.effects, f"{muscle}_pressure_delay") for muscle in ("extensor", "flexor")]
    assert all(sensor.enabled for sensor in sensors)
    whole = (computing_ns(p) + line_ns(p)) * 1e-9 + sensors[0].delay
    assert whole == pytest.approx(8e-3, abs=1e-3)
    assert abs(whole - p.valve.delay) == pytest.approx(2e-3, abs=1e-9), "nominal: off by its tolerance"


@pytest.mark.parametrize("part", PARTS)
def test_each_part_counts_with_its_time(part):
    size, time = (2.0, 2 * load().plant.delay.hose_per_metre) if part == "hose_length" else (4e-3, 4e-3)
    p = load({**NONE, f"plant.delay.{part}": size})
    assert computing_ns(p) + line_ns(p) == round(time * 1e9)
    assert (computing_ns(p) > 0) == (part == "computing")


@pytest.mark.parametrize("delay", [0.0, 3.35e-3, 5.0e-3, 8.65e-3])
def test_a_delay_acts_exactly_whatever_its_fraction_of_period_and_step(delay):
    """Half a step (0.05 ms) off would be seen: the same voltages by hand at another instant differ."""
    state = moved(Plant(load({**NONE, "plant.delay.valve": delay})))

    def off(more):
        acting = [(k * PERIOD_NS + round(delay * 1e9) + more, pair) for k, pair in enumerate(VOLTAGES)]
        return np.abs(undelayed(acting) - state).max()

    assert off(0) < 1.0, "Pa"
    assert off(FINE_NS) > 100 * off(0)


def test_voltages_that_come_within_a_period_act_from_there_on():
    plant = Plant(load(NONE))
    came = [(400_000, (6.5, 4.0)), (1_850_000, (4.2, 6.1)), (2_300_000, (7.0, 5.0)), (6_250_000, (5.0, 4.5))]
    for instant, pair in came:
        for line, voltage in enumerate(pair):
            plant.take(line, voltage, instant)
    for _ in VOLTAGES:
        plant.live_on()
    assert np.abs(plant.state[:4] - undelayed(came)).max() < 1.0, "Pa"


def test_voltages_wait_in_line():
    line = Line(5.0, 1000)
    line.put(6.0, 100)
    line.put(7.0, 2500)
    assert [line.at(t) for t in (0, 1099, 1100, 3499, 3500)] == [5.0, 5.0, 6.0, 6.0, 7.0]


def test_a_later_order_counts():
    """A vent that is asked for at an instant takes the place of what came at it or was to come after."""
    line = Line(5.0, 1000)
    line.put(6.0, 300)
    line.put(7.0, 500)
    line.put(0.0, 300)
    assert list(line.changes(10_000)) == [1300]
    assert line.at(1300) == 0.0


def test_what_is_not_finite_is_refused():
    with pytest.raises(OrthosisError, match="not finite"):
        Plant(load()).take(0, float("nan"), 0)


@pytest.mark.parametrize("delay", [0.0, 3.35e-3, 11.0e-3])
def test_a_study_has_the_delay_too(delay):
    p = load({**NONE, "plant.delay.valve": delay})
    voltages = np.array(VOLTAGES * 5)
    told = Study(p, ()).simulate(np.empty((1, 0)), voltages)["measured_extensor_pressure"][0]
    plant, own = Plant(p), []
    for pair in voltages:
        own.append(plant.signals()["measured_extensor_pressure"])
        plant.advance(*pair)
    assert np.ptp(own) > 1e4
    assert np.abs(told - own).max() < 1.0, "Pa"


def test_a_study_has_one_delay_for_all_its_sets():
    with pytest.raises(OrthosisError, match="cannot differ"):
        Study(load(), ["plant.delay.valve"])
