# SPDX-License-Identifier: Apache-2.0
"""The delay of the loop: the nominal one is in the model, and a recording gives by how much it is off."""

import numpy as np
import pytest

from pam_orthosis.control.effects import command_lag
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.discrepancy.fitting.fit import fit_tempered
from pam_orthosis.discrepancy.fitting.free import free_parameters
from pam_orthosis.discrepancy.preparation import beginning
from pam_orthosis.discrepancy.recordings.data import from_arrays
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.systems.knee import knee
from pam_orthosis.discrepancy.workflow import find_gap
from pam_orthosis.errors import OrthosisError
from pam_orthosis.improvement import learned
from pam_orthosis.model.delay import NANOSECONDS, computing_ns, line_ns
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load

TRUE = 4.3e-3  # s, no whole number of periods
SECONDS = 14.0
EFFECT = ("valve_delay",)
# the delay, what looks like it, and what the shipped hardware has beside it
AMONG = (*EFFECT, "valve_lag", "valve_dead_band", "joint_friction", "muscle_hysteresis")


def delayed(bench, nominal):
    return bench.parameters.changed({"plant.delay.valve": TRUE, "valve.delay": nominal})


@pytest.fixture(scope="module")
def runs(bench):
    p = delayed(bench, TRUE)
    return [ClosedLoop(p, seed).run(round(SECONDS / p.scenario.control_period)) for seed in (1, 2)]


def problem(bench, runs, nominal):
    p = delayed(bench, nominal)
    system = knee(p)
    recorded = [from_arrays(f"run {number}", system, run) for number, run in enumerate(runs)]
    return beginning.prepared(Replay(system), recorded[:1], recorded[1:], p.gap)[0]


@pytest.mark.parametrize("nominal", [TRUE - 2e-3, TRUE + 2e-3])
def test_a_recording_gives_by_how_much_the_nominal_delay_is_off(bench, runs, nominal):
    posed = problem(bench, runs, nominal)
    start = {**posed.replay.defaults(EFFECT), "valve_delay.delay": 1e-3}
    found = fit_tempered(posed, EFFECT, start, free_parameters(posed.system, EFFECT))[1]
    assert nominal + found.values["valve_delay.delay"] == pytest.approx(TRUE, abs=1e-4)


def seen_delay(p):
    """Return the time from a sample to the measured pressure that answers it: line, spool, sensor, s."""
    spool = p.plant.effects.valve_lag
    lag = spool.damping_ratio / (np.pi * spool.natural_frequency)
    return (computing_ns(p) + line_ns(p)) / NANOSECONDS + lag + p.plant.effects.extensor_pressure_delay.delay


def test_a_whole_search_finds_the_delay_of_the_shipped_hardware_that_the_nominal_model_has_twice():
    p = load({"valve.delay": 15e-3})
    system = knee(p, {name: KNEE.catalogue[name] for name in AMONG})
    run = ClosedLoop(p, 1).run(round(SECONDS / p.scenario.control_period))
    outcome = find_gap(system, [from_arrays("run", system, run)], [], p.gap)
    names = [one.name for one in outcome.effects]
    taught = p.changed(learned.named(p, names, outcome.selection.final.values))
    assert command_lag(taught.nominal()) == pytest.approx(seen_delay(p), abs=5e-4)


def test_the_nominal_delay_is_in_the_model(bench, runs):
    gas = [problem(bench, runs, nominal) for nominal in (TRUE, 0.0)]
    left, without = (np.std(p.residuals((), p.replay.defaults(()))["gas"]) for p in gas)
    assert left < 0.7 * without


def test_what_was_learned_goes_into_the_nominal_model():
    parameters = load({"valve.delay": 9e-3})
    taught = parameters.changed(learned.named(parameters, EFFECT, {"valve_delay.delay": -2.5e-3}))
    assert command_lag(taught.nominal()) == pytest.approx(6.5e-3)
    assert knee(taught).late == pytest.approx(6.5e-3)
    assert "valve_delay" not in knee(taught).catalogue


def test_hardware_is_never_early():
    early = {"plant.effects.valve_delay.enabled": True, "plant.effects.valve_delay.delay": -1e-3}
    with pytest.raises(OrthosisError, match="never early"):
        load(early)
