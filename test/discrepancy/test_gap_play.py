# SPDX-License-Identifier: Apache-2.0
"""Play: where the knee rests in it is chance, and no other effect's doing."""

from types import SimpleNamespace

import numpy as np
import pytest

from pam_orthosis.discrepancy.answer import noise_floor
from pam_orthosis.discrepancy.fitting import measure, structure
from pam_orthosis.discrepancy.fitting.fit import fit_tempered
from pam_orthosis.discrepancy.fitting.free import free_parameters
from pam_orthosis.discrepancy.preparation import beginning
from pam_orthosis.discrepancy.recordings.data import from_arrays
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.replay.run import Run
from pam_orthosis.discrepancy.search import findings
from pam_orthosis.discrepancy.search.selection import Selection
from pam_orthosis.discrepancy.systems.knee import knee
from pam_orthosis.testing import case as cases

HALF_WIDTH = 6.0e-3  # rad


def judged(bench, effect, training, held_out):
    """Return the rms over the noise that a fitted model expects of the angle and what it leaves.

    First in all samples, then in those that chance does not decide; last, which these are.
    """
    settings = bench.parameters.gap
    problem, judge, _ = beginning.prepared(bench.replay, [training], [held_out], settings)
    free = free_parameters(bench.system, (effect,))
    weighted, model = fit_tempered(problem, (effect,), bench.replay.defaults((effect,)), free)
    spread, runs = findings.covariance(weighted, model), [one.run for one in weighted.scored]
    noise = beginning.residual_noise(bench.replay, runs, settings, model.effects, model.values)
    squares = noise_floor.expected_squares(judge, model, spread, noise, settings.replay.cross_cutoff)
    masks = noise_floor.decided(judge, squares)
    key = judge.scored[0].run.serial, "angle"
    reported = [np.sqrt(np.mean(squares[key])), np.sqrt(np.mean(squares[key][masks[key]]))]
    seen = [measure.gap(judge, model, one).white["angle"] for one in (None, masks)]
    return reported, seen, masks[key]


@pytest.fixture(scope="module")
def experiments(diagnostics):
    """Diagnostic experiments with a play, to fit and to judge: the knee rests, swings, is driven."""
    system, *recordings = diagnostics(51515100000, "clean", "large", ["backlash"])
    known = SimpleNamespace(parameters=cases.nominal(), system=system, replay=Replay(system))
    return known, *recordings


def test_a_lasting_correction_of_the_angle_does_not_wind_the_play(bench):
    """A knee at rest that is measured a little aside: the play must not answer by going to its end.

    The correction moves the angle, the model's velocity is opposite to it, and both together stand still.
    """
    torque = bench.system.equations[0]
    (part,) = bench.replay.parts(torque, ("backlash",))
    values = bench.replay.defaults(("backlash",)) | {"backlash.half_width": HALF_WIDTH}
    theta = np.array([values[name] for name in part.parameters])
    run = Run(bench.system, bench.recording(1), 40.0)
    row, state = run.data(torque.channels)[1000], run.states(part, np.array([1000]))[0]
    angle, velocity, play = (part.own.index(name) for name in ("angle", "velocity", "cogwheel_play"))
    gain = torque.gains["angle"]

    def wound(rate):
        state[velocity], state[play] = rate, 0.3
        corrected, residual = (np.array(one)[:, 0] for one in part.observe(state, row, theta, run.period))
        moved = float(corrected[play] - 0.3) - run.period * gain["cogwheel_play"] * residual[0]
        return moved / run.period + float(part.rates(state, row, theta, run.period, 0.0)[play]), residual[0]

    _, aside = wound(0.0)
    state[angle] += aside - 2e-3  # rad, now by so much
    still, residual = wound(-gain["angle"] * 2e-3)
    assert residual == pytest.approx(2e-3, rel=1e-6)
    assert abs(still) < 1e-5
    assert wound(0.0)[0] > 1.0  # 1/s: without the model's velocity the correction alone winds it


def test_where_chance_does_not_decide_a_model_with_play_leaves_noise(experiments):
    (reported, alone_there), (seen, seen_there), decided = judged(
        experiments[0], "backlash", *experiments[1:]
    )
    assert reported > 1.15
    assert seen > 1.3
    assert alone_there < 1.15
    assert seen_there < alone_there  # no more than the model expects
    assert 0.2 < decided.mean() < 0.8


def test_where_nothing_is_chance_a_model_expects_noise_alone(bench):
    """Viscosity and damping make up for each other: what both do together is known all the same."""
    friction = {"plant__effects__viscous_friction__enabled": True}
    runs = (bench.recording(seed, **friction) for seed in (1, 2))
    reported, seen, decided = judged(bench, "viscous_friction", *runs)
    assert reported == pytest.approx([1.0, 1.0], abs=0.05)
    assert seen == pytest.approx([1.0, 1.0], abs=0.05)
    assert decided.all()


def test_too_few_samples_that_chance_does_not_decide_are_none_to_judge_by():
    scored = [SimpleNamespace(run=SimpleNamespace(serial=7, period=0.002))]
    problem = SimpleNamespace(scored=scored)
    still = {(7, "angle"): np.r_[np.ones(2000), np.full(8000, 9.0)]}
    assert noise_floor.decided(problem, still) is None
    moving = {(7, "angle"): np.r_[np.ones(8000), np.full(2000, 9.0)]}
    mask = noise_floor.decided(problem, moving)[7, "angle"]
    assert mask[:7600].all()
    assert not mask[7900:].any()


@pytest.fixture(scope="module")
def slackening():
    """A gait in which the extensor slackens in each cycle, and an experiment; the model is the true one."""
    effects = "flexor_pressure_gain", "extensor_pressure_offset"
    case = cases.make_case(36545140025, "clean", "medium", list(effects))
    system, settings = knee(case.parameters), case.parameters.gap
    groups = case.training, case.held_out
    recorded = [[from_arrays(n, system, a) for n, a in group.items()] for group in groups]
    problem, judge, floor = beginning.prepared(Replay(system), *recorded, settings)
    hidden = {f"{name}.{key}": v for name, p in case.answer["effects"].items() for key, v in p.items()}
    start = {**problem.replay.defaults(effects), **hidden}
    weighted, model = fit_tempered(problem, effects, start, free_parameters(system, effects))
    return weighted, model, SimpleNamespace(held_out=judge, floor=floor), settings


def test_when_a_slack_muscle_begins_to_pull_is_not_judged(slackening):
    """Its damping of some 60 N is there at once; when, the pressure's noise decides."""
    problem, model, start, settings = slackening
    found, judge = Selection(problem, model, problem, model), start.held_out
    spread = findings.covariance(problem, model)
    masks, floor = noise_floor.decided_and_floor(start, found, spread, settings)
    seen, there = (measure.gap(judge, model, one).white["angle"] for one in (None, masks))
    assert seen > 1.2 * floor.white["angle"]
    assert there < 1.03 * floor.white["angle"]
    for counted, clean in (None, False), (masks, True):
        assert structure.clean(structure.locate(judge, model, counted)) == clean
    assert (
        "left out of the judgement, where differences too small to measure decide: "
        in noise_floor.remark_on_left_out(masks)[0]
    )


@pytest.mark.parametrize(("decided", "known"), [(1.0, False), (0.8, True), (0.3, False)])
def test_noise_that_decides_nothing_or_most_leaves_nothing_out(decided, known):
    problem = SimpleNamespace(scored=[SimpleNamespace(run=SimpleNamespace(serial=1, period=0.002))])
    squares = np.where(np.arange(20_000) < 20_000 * decided, 1.0, 9.0)
    masks = noise_floor._by_noise(problem, {(1, "angle"): squares})
    assert (masks is not None) == known


def test_what_is_not_judged_is_reported():
    masks = {
        (1, "angle"): np.arange(100) < 40,
        (2, "angle"): np.ones(100, bool),
        (1, "pressure"): np.ones(9, bool),
    }
    (remark,) = noise_floor.remark_on_left_out(masks)
    assert remark.startswith("left out of the judgement, where differences too small to measure decide: ")
    assert remark.endswith(": 30% of angle")
    assert noise_floor.remark_on_left_out(None) == ()
    assert noise_floor.remark_on_left_out({(1, "pressure"): np.ones(9, bool)}) == ()


def test_a_correction_does_not_rub(bench):
    """Bristles of a friction bend with the model's motion, not with what holds it to the recording."""
    torque = bench.system.equations[0]
    (part,) = bench.replay.parts(torque, ("joint_friction",))
    values = bench.replay.defaults(("joint_friction",))
    run = Run(bench.system, bench.recording(1), 40.0)
    row, state = run.data(torque.channels)[1000], run.states(part, np.array([1000]))[0]
    state[part.own.index("angle")] += 0.01
    theta = np.array([values[name] for name in part.parameters])
    corrected, residual = (np.array(one)[:, 0] for one in part.observe(state, row, theta, run.period))
    assert abs(residual[0]) > 5e-3
    others = [i for i, name in enumerate(part.own) if name not in torque.states]
    assert others
    assert corrected[others] == pytest.approx(state[others], abs=0.0)
