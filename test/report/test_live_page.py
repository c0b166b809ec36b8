# SPDX-License-Identifier: Apache-2.0
"""What the live view shows of a leg is what was measured, an instant at a time."""

from pathlib import Path

import numpy as np
import pytest

from pam_orthosis.bag.read import read_bag
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load
from pam_orthosis.report.live import LiveLeg, inputs, live_page
from pam_orthosis.scene.messages import PERIOD_NS
from pam_orthosis.scene.shapes import shape_of

WALK = Path(__file__).resolve().parents[2] / "bags" / "walk"
SIGNALS = {
    "joint_states": "angle",
    "extensor/pressure": "extensor_pressure",
    "flexor/pressure": "flexor_pressure",
    "reference": "reference_angle",
}


@pytest.fixture(scope="module")
def bag():
    return read_bag(WALK, list(SIGNALS.values()))


def fed(leg, bag, shift_ns=0):
    """Return what a leg shows of a bag whose messages come by their stamps."""
    said = sorted(
        (stamp, topic, value)
        for topic, name in SIGNALS.items()
        for stamp, value in zip(*bag[name], strict=True)
    )
    shifted = ((topic, stamp + shift_ns, value) for stamp, topic, value in said)
    shown = (leg.add(*one) for one in shifted if leg.due(one[1]))
    return [one for one in shown if one]


def test_the_inputs_are_in_the_order_of_the_picture():
    assert [one.topic for one in inputs(KNEE)] == list(SIGNALS)


def test_it_shows_the_first_whole_sample_of_each_period(bag):
    shown = fed(LiveLeg(load()), bag)
    time = np.array([one["time"] for one in shown])
    assert np.diff(time) == pytest.approx(PERIOD_NS / 1e9, abs=1e-3)
    stamps = np.round(time * 1e9).astype(int)
    for name, signal in (("measured", "angle"), ("reference", "reference_angle")):
        series = bag[signal]
        true = np.degrees(series.value[np.searchsorted(series.stamp_ns, stamps)])
        assert [one[name] for one in shown] == pytest.approx(true, abs=1e-3)
    error = [one["reference"] - one["measured"] for one in shown]
    assert [one["error"] for one in shown] == pytest.approx(error, abs=2e-4)
    pressures = bag["flexor_pressure"]
    bars = pressures.value[np.searchsorted(pressures.stamp_ns, stamps)] / 1e5
    assert [one["actuators"]["flexor"]["bar"] for one in shown] == pytest.approx(bars, abs=1e-3)


def test_the_leg_is_drawn_where_it_is(bag):
    shown = fed(LiveLeg(load()), bag)
    sketch = shape_of(load()).sketch(np.radians([one["measured"] for one in shown]))
    assert np.array([one["body"] for one in shown]) == pytest.approx(sketch.body, abs=2e-4)
    lower = np.array([one["actuators"]["extensor"]["lower"] for one in shown])
    assert lower == pytest.approx(sketch.actuators["extensor"].lower, abs=2e-4)


def test_what_a_leg_cannot_have_is_not_shown():
    leg = LiveLeg(load())
    for step, angle in enumerate((0.5, float("nan"), 40.0, 0.6)):
        shown = [leg.add(topic, step * PERIOD_NS, 2e5 if "pressure" in topic else angle) for topic in SIGNALS]
        assert shown[:-1] == [None, None, None]
        assert bool(shown[-1]) == (angle < 1.0)


def test_another_run_begins_anew(bag):
    leg = LiveLeg(load())
    assert len(fed(leg, bag, 10**12)) == len(fed(leg, bag)) > 100


def test_messages_that_never_become_whole_are_forgotten():
    leg = LiveLeg(load())
    for step in range(1000):
        assert leg.add("joint_states", step * PERIOD_NS, 0.1) is None
    assert len(leg._waiting) <= 51


def test_each_leg_has_its_drawing():
    page = live_page(LiveLeg(load()), ("left", "right"))
    assert page.count("data-live=") == 2
    assert '<section data-leg="right">' in page
