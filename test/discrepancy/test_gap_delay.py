# SPDX-License-Identifier: Apache-2.0
"""The delay of the loop: the nominal one is in the model, and a recording gives by how much it is off."""

import numpy as np
import pytest

from pam_orthosis.control.effects import command_lag
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.discrepancy import beginning
from pam_orthosis.discrepancy.data import from_arrays
from pam_orthosis.discrepancy.fit import fit_tempered
from pam_orthosis.discrepancy.free import free_parameters
from pam_orthosis.discrepancy.knee import knee
from pam_orthosis.discrepancy.replay import Replay
from pam_orthosis.errors import OrthosisError
from pam_orthosis.improvement import learned
from pam_orthosis.model.parameters import load

TRUE = 4.3e-3  # s, no whole number of periods
SECONDS = 14.0
EFFECT = ("valve_delay",)


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


def test_the_nominal_delay_is_in_the_model(bench, runs):
    gas = [problem(bench, runs, nominal) for nominal in (TRUE, 0.0)]
    left, without = (np.std(p.residuals((), p.replay.defaults(()))["gas"]) for p in gas)
    assert left < 0.7 * without


def test_what_was_learned_goes_into_the_nominal_model():
    parameters = load({"valve.delay": 9e-3})
    taught = parameters.changed(learned.named(parameters, EFFECT, {"valve_delay.delay": -2.5e-3}))
    assert command_lag(taught.belief()) == pytest.approx(6.5e-3)
    assert knee(taught).late == pytest.approx(6.5e-3)
    assert "valve_delay" not in knee(taught).catalogue


def test_hardware_is_never_early():
    early = {"plant.effects.valve_delay.enabled": True, "plant.effects.valve_delay.delay": -1e-3}
    with pytest.raises(OrthosisError, match="never early"):
        load(early)
