# SPDX-License-Identifier: Apache-2.0
"""Stretches of a recording replayed side by side against the recording replayed from its beginning."""

import numpy as np
import pytest

from pam_orthosis.discrepancy.replay.kernel import Kernel
from pam_orthosis.discrepancy.replay.lanes import LANES, WARM_SECONDS, Lanes
from pam_orthosis.discrepancy.replay.run import Run

CUTOFF = 40.0


@pytest.fixture(scope="module")
def run(bench):
    return Run(bench.system, bench.recording(1), CUTOFF)


@pytest.mark.parametrize("rows", [1, 7, 60, 61, 1000])
@pytest.mark.parametrize("warm", [0, 10, 60])
def test_cut_rows_are_found_and_joined_again(rows, warm):
    z = np.arange(3.0 * rows).reshape(rows, 3)
    cut = Lanes.cut(z, warm)
    assert cut.z.shape == (cut.warm + cut.length, 3, LANES)
    assert cut.at(np.arange(rows)) == pytest.approx(z)
    assert cut.joined(cut.z) == pytest.approx(z)
    first = cut.z[0].T
    assert first == pytest.approx(z[cut.starts])


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize(("effects", "forgets"), [((), True), (("creep",), False)])
def test_stretches_are_the_recording_replayed_from_its_beginning(bench, run, monkeypatch, effects, forgets):
    passes = []
    passed = Kernel._passed
    monkeypatch.setattr(Kernel, "_passed", lambda *args: (passes.append(1), passed(*args))[1])
    values = bench.replay.defaults(effects) | {f"{name}.share": 0.3 for name in effects}
    (equation,) = (one for one in bench.system.equations if one.name == "torque")
    (part,) = bench.replay.parts(equation, effects)
    theta = np.array([values[name] for name in part.parameters])
    z = run.data(part.channels)
    for wrt in ((), part.parameters[:3]):
        kernel = Kernel(part, wrt)
        kernel.build()
        assert kernel.built, "the virtual machine knows no stretches"
        found = []
        for warm in (len(z), round(WARM_SECONDS / run.period)):
            passes.clear()
            rows = Lanes.cut(z, warm)
            found.append(kernel(rows, theta, run.states(part, rows.starts), run.period, 2))
        assert (len(passes) == 1) == forgets
        whole, stretched = found
        for i in range(1 + len(wrt)):
            one, other = (result[:, :, i] if wrt else result for result in (whole, stretched))
            assert np.abs(one - other).max() < 1e-5 * np.abs(one).max()


def test_what_no_observer_forgets_is_exact_after_as_many_passes_as_stretches():
    steps = np.random.default_rng(1).standard_normal((100, 1))
    rows = Lanes.cut(steps, 5)

    def summed(some, first, results):
        states = first + np.cumsum(some.z[:, 0], axis=0)
        results[:, 0] = states
        before = np.vstack([first, states])
        return before[None, some.warm], before[None, -1]

    found = rows.replayed(summed, np.zeros((1, LANES)), 1, 0)
    assert found == pytest.approx(np.cumsum(steps, axis=0))


def test_a_replay_that_diverges_ends_at_once():
    rows, passes = Lanes.cut(np.zeros((100, 1)), 5), []

    def diverging(_, first, results):
        passes.append(1)
        results[:] = np.inf
        return tuple(np.full((1, LANES), np.inf) for _ in range(2))

    assert not np.isfinite(rows.replayed(diverging, np.zeros((1, LANES)), 1, 0)).any()
    assert len(passes) == 1
