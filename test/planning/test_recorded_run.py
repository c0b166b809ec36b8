# SPDX-License-Identifier: Apache-2.0
"""A plan that knows what a run showed: torque that the model lacked, the cycle made, how it fell short."""

from pathlib import Path

import numpy as np
import pytest

from pam_orthosis.cli.main import main
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.discrepancy.answer import patch
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import load, scenario_overrides
from pam_orthosis.model.truth import with_nominal
from pam_orthosis.planning import plan
from pam_orthosis.planning.plan import make_plan
from pam_orthosis.planning.problem import NotFound
from pam_orthosis.planning.recorded import Recorded, recorded, recorded_in

WALK = Path(__file__).parents[2] / "bags" / "walk"
LOW_SUPPLY = 5.25e5  # Pa
SIGNALS = (
    "reference_angle", "disturbance", "angle", "extensor_pressure", "flexor_pressure", "followed_angle",
)  # fmt: skip
STEPS = 1400
PHASES = np.arange(50) / 50


def torque(phase):
    """A torque towards flexion that comes again in each cycle."""
    return 0.4 - 1.5 * np.cos(2 * np.pi * phase) + 0.3 * np.sin(2 * np.pi * 7 * phase)


def run_of(time, signals):
    """A run that shows these signals, by the phase, at full cadence, noise, and something else before."""
    p, draw = load(), np.random.default_rng(1)
    s = p.scenario
    ramp_ends = s.start_hold + s.start_ramp
    phase = (time - ramp_ends + 0.5 * s.start_ramp) / s.cycle_time
    told = {
        name: np.where(time < ramp_ends, 50.0 * size, signal(phase)) + draw.normal(0.0, 0.2 * size, len(time))
        for name, (signal, size) in signals.items()
    }
    return recorded(time, {"reference_angle": told["angle"]} | told, p)


def test_what_comes_again_in_each_cycle_is_found_at_its_phase():
    time = np.arange(STEPS) * load().scenario.control_period
    shown = {
        "disturbance": (lambda phase: -torque(phase), 1.0),
        "angle": (lambda phase: 0.01 * torque(phase), 0.01),
        "extensor_pressure": (lambda phase: 3e5 + 1e5 * torque(phase), 1e5),
        "flexor_pressure": (lambda phase: 4e5 - 1e5 * torque(phase), 1e5),
        "followed_angle": (lambda phase: 0.02 * torque(phase), 0.02),
    }
    found = run_of(time, shown)
    wanted = torque(PHASES)
    assert found.missing(PHASES) == pytest.approx(wanted, abs=0.12)
    assert found.position(PHASES) == pytest.approx(0.01 * wanted, abs=0.0012)
    assert found.pressures[0](PHASES) == pytest.approx(3e5 + 1e5 * wanted, abs=0.12e5)
    assert found.pressures[1](PHASES) == pytest.approx(4e5 - 1e5 * wanted, abs=0.12e5)
    assert found.followed(PHASES) == pytest.approx(0.02 * wanted, abs=0.0024)
    assert found.planned


def weak_and_unknown():
    """A person on hardware of too low a supply; of its effects nothing is known but that supply."""
    hardware = load(scenario_overrides("person") | {"plant.deviation.supply_pressure": LOW_SUPPLY / 7e5})
    return with_nominal(
        hardware,
        {"valve.supply_pressure": LOW_SUPPLY, "control.position.maximum_pressure": LOW_SUPPLY - 1.5e4},
    )


def walked(parameters):
    run = ClosedLoop(parameters, 1).run(STEPS)
    return run, np.degrees(np.abs(run["reference_angle"] - run["angle"]).max())


def test_a_plan_after_one_run_gains_what_a_plan_by_the_model_alone_does_not():
    weak = weak_and_unknown()
    run, before = walked(weak)
    blind = walked(weak.changed(make_plan(weak).overrides))[1]
    after = walked(weak.changed(make_plan(weak, recorded=recorded(run["time"], run, weak)).overrides))[1]
    assert blind > 3.0
    assert before > 3.0
    assert after < min(3.0, 0.6 * blind)


def cycle_seen(planned):
    """What was recorded of a knee that fell short of what it followed, and in what shapes."""

    def shape(size):
        return lambda phase: size * (1 + torque(phase) / 10)

    return Recorded(np.zeros_like, shape(0.4), (shape(3e5), shape(4e5)), shape(0.44), planned=planned)


def test_the_search_begins_at_the_recorded_cycle_and_elsewhere_if_that_leads_nowhere(monkeypatch):
    p, at = load(scenario_overrides("person")), np.arange(plan.NODES) / plan.NODES
    starts, seen = [], cycle_seen(planned=False)

    def search(_nominal, start, *_):
        starts.append(start)
        if len(starts) == 1:
            raise NotFound("nothing from here")
        return start

    monkeypatch.setattr(plan, "nearest_cycle", search)
    plan.make_plan(p, recorded=seen)
    assert starts[0].position == pytest.approx(seen.position(at))
    assert starts[0].pressures == pytest.approx(np.array([series(at) for series in seen.pressures]))
    plan.make_plan(p)
    assert starts[1].pressures == pytest.approx(starts[-1].pressures)
    assert starts[1].pressures != pytest.approx(starts[0].pressures, rel=0.01)


def test_by_what_the_knee_fell_short_of_a_plan_more_is_asked_for_a_little_earlier(monkeypatch):
    p, at = load(scenario_overrides("person")), np.arange(plan.NODES) / plan.NODES
    monkeypatch.setattr(plan, "nearest_cycle", lambda _nominal, start, *_: start)
    after_one, after_none = (plan.make_plan(p, recorded=cycle_seen(planned)) for planned in (True, False))
    more, later = after_one.asked - after_one.cycle.position, at + plan.LEAD / p.scenario.cycle_time
    in_motion = (at > 0.25) & (at < 0.75)
    assert more[in_motion] == pytest.approx(0.04 * (1 + torque(later[in_motion]) / 10), rel=1e-2)
    assert more[0] == 0.0  # where the knee rests
    assert 0.0 < more[:20].max() <= 0.05
    assert np.array_equal(after_none.asked, after_none.cycle.position)
    cosine = after_one.overrides["scenario.plan.angle.cosine"]
    assert cosine[0] == pytest.approx((after_one.asked - after_one.wanted).mean(), abs=1e-5)


def test_a_run_without_a_whole_cycle_is_refused():
    time = np.arange(900) * 0.005  # 3 s until full cadence, a cycle of 2 s
    with pytest.raises(OrthosisError, match="no whole cycle at full cadence"):
        recorded(time, dict.fromkeys(SIGNALS, np.zeros(900)), load())


def test_a_run_that_lacks_a_part_of_each_cycle_is_refused():
    time = np.arange(STEPS) * load().scenario.control_period
    time = time[(time < 3.2) | (time > 6.8)]
    with pytest.raises(OrthosisError, match="part of each is missing"):
        recorded(time, dict.fromkeys(SIGNALS, np.zeros(len(time))), load())


def test_a_knee_that_did_not_make_the_motion_tells_nothing_of_it():
    time = np.arange(STEPS) * load().scenario.control_period
    signals = dict.fromkeys(SIGNALS, np.zeros(STEPS))
    recorded(time, signals | {"angle": np.full(STEPS, 0.34)}, load())
    with pytest.raises(OrthosisError, match="the knee was 21 deg away"):
        recorded(time, signals | {"angle": np.full(STEPS, 0.36)}, load())


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"scenario.cycle_time": 3.0}, "shows another motion"),
        ({"leg.shank.mass": 0.95}, "of another model: leg.shank.mass was"),
    ],
)
def test_a_run_of_something_else_is_refused(changes, told):
    with pytest.raises(OrthosisError, match=told):
        recorded_in(WALK, load(scenario_overrides("default") | changes))


def test_the_verb_takes_a_bag_of_the_graph(tmp_path, capsys):
    out = tmp_path / "plan.yaml"
    assert main(["plan", "--scenario", "default", "--after", str(WALK), "--out", str(out)]) == 0
    assert "unexplained torque" in capsys.readouterr().out
    assert load(patch.read(out)).scenario.plan.enabled
    assert main(["plan", "--after", str(tmp_path / "none"), "--out", str(tmp_path / "b.yaml")]) == 2
    assert capsys.readouterr().err.strip().splitlines()[-1].endswith(f"no bag at {tmp_path / 'none'}")
