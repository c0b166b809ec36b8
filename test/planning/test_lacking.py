# SPDX-License-Identifier: Apache-2.0
"""A plan that knows what a run showed: the torque that the model lacked, by the phase of the gait."""

from pathlib import Path

import numpy as np
import pytest

from pam_orthosis.cli.main import main
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.discrepancy import patch
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import load, scenario_overrides
from pam_orthosis.model.plant import with_belief
from pam_orthosis.planning.lacking import lacking_in, lacking_torque
from pam_orthosis.planning.plan import make_plan

WALK = Path(__file__).parents[2] / "bags" / "walk"
LOW_SUPPLY = 5.2e5  # Pa
STEPS = 1400
PHASES = np.arange(50) / 50


def torque(phase):
    """A torque towards flexion that comes again in each cycle."""
    return 0.4 - 1.5 * np.cos(2 * np.pi * phase) + 0.3 * np.sin(2 * np.pi * 7 * phase)


def test_what_comes_again_in_each_cycle_is_found_at_its_phase():
    p = load()
    s = p.scenario
    time = np.arange(STEPS) * s.control_period
    ramp_ends = s.start_hold + s.start_ramp
    phase = (time - ramp_ends + 0.5 * s.start_ramp) / s.cycle_time
    noise = np.random.default_rng(1).normal(0.0, 0.2, STEPS)
    found = lacking_torque(time, np.where(time < ramp_ends, 50.0, -torque(phase)) + noise, p)
    assert found(PHASES) == pytest.approx(torque(PHASES), abs=0.12)


def weak_and_unknown():
    """A person on hardware of too low a supply; of its effects nothing is known but that supply."""
    hardware = load(scenario_overrides("person") | {"plant.deviation.supply_pressure": LOW_SUPPLY / 7e5})
    return with_belief(
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
    lacking = lacking_torque(run["time"], run["disturbance"], weak)
    after = walked(weak.changed(make_plan(weak, lacking=lacking).overrides))[1]
    assert blind > 3.0
    assert before > 3.0
    assert after < min(3.0, 0.6 * blind)


def test_a_run_without_a_whole_cycle_is_refused():
    time = np.arange(900) * 0.005  # 3 s until full cadence, a cycle of 2 s
    with pytest.raises(OrthosisError, match="no whole cycle at full cadence"):
        lacking_torque(time, np.zeros(900), load())


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"scenario.cycle_time": 3.0}, "shows another motion"),
        ({"leg.shank.mass": 0.95}, "of another model: leg.shank.mass was"),
    ],
)
def test_a_run_of_something_else_is_refused(changes, told):
    with pytest.raises(OrthosisError, match=told):
        lacking_in(WALK, load(scenario_overrides("default") | changes))


def test_the_verb_takes_a_bag_of_the_graph(tmp_path, capsys):
    out = tmp_path / "plan.yaml"
    assert main(["plan", "--scenario", "default", "--after", str(WALK), "--out", str(out)]) == 0
    assert "torque not explained" in capsys.readouterr().out
    assert load(patch.read(out)).scenario.plan.enabled
    assert main(["plan", "--after", str(tmp_path / "none"), "--out", str(tmp_path / "b.yaml")]) == 2
    assert capsys.readouterr().err.strip().splitlines()[-1].endswith(f"no bag at {tmp_path / 'none'}")
