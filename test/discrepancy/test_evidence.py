# SPDX-License-Identifier: Apache-2.0
"""Evidence of a model: on linear models, whose marginal likelihood is known exactly."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from pam_orthosis.discrepancy.fitting.candidates import penalty, widened_shape
from pam_orthosis.discrepancy.fitting.fit import Fit, score
from pam_orthosis.discrepancy.fitting.free import SHAPE_SCALES, WIDTHS, Free
from pam_orthosis.discrepancy.fitting.projection import Projection
from pam_orthosis.discrepancy.replay.problem import Block, Problem, Scored
from pam_orthosis.discrepancy.search import acceptance
from pam_orthosis.discrepancy.search.confirmation import Seen
from pam_orthosis.discrepancy.search.findings import deviations, interval
from pam_orthosis.model.effects.base import Contribution, Effect, Quantity

SAMPLES = 400
RNG = np.random.default_rng(29)
COLUMNS = {"mass": RNG.standard_normal(SAMPLES), "map.bend": np.linspace(-1, 1, SAMPLES) ** 2}
SD = {"mass": 0.3, "map.bend": 0.5}
INFINITE = math.inf


def shape():
    return SimpleNamespace(parameters=[SimpleNamespace(name="bend", prior=SD["map.bend"])])


def minus_twice_log_likelihood(row, sd):
    """Return it for a row of samples: normal, white noise of 1 and what the parameters' priors spread."""
    spread = np.eye(SAMPLES) + sum(sd[name] ** 2 * np.outer(x, x) for name, x in COLUMNS.items())
    return row @ np.linalg.solve(spread, row) + np.linalg.slogdet(spread)[1]


def best_fit(row, sd, effects=(), more=()):
    """Return a problem that knows the columns, and its fit with the largest posterior."""
    matrix = np.column_stack(list(COLUMNS.values()))
    weight = np.array([1 / sd[name] for name in COLUMNS])
    found = np.linalg.solve(matrix.T @ matrix + np.diag(weight**2), matrix.T @ row)
    values = dict(zip(COLUMNS, found.tolist(), strict=True)) | {one.name: 0.0 for one in more}
    free = [Free(name, 0.5 * sd[name], -INFINITE, INFINITE, sd[name]) for name in COLUMNS]
    residual = row - matrix @ found
    problem = SimpleNamespace(
        system=SimpleNamespace(shapes=("map",), catalogue={"map": shape()}, equations=()),
        replay=SimpleNamespace(touched=lambda _: {"torque"}),
        weights={"torque": 1.0},
        residuals=lambda *_: {"torque": residual},
    )
    blocks = {"torque": Block(residual, -matrix, tuple(COLUMNS))}
    return problem, Fit(effects, values, 0.0, np.eye(2), (*free, *more), SAMPLES, blocks)


def recorded(bend):
    """Return a row of residuals whose map is bent by so many standard deviations of its prior."""
    signal = 0.2 * COLUMNS["mass"] + bend * SD["map.bend"] * COLUMNS["map.bend"]
    return signal + np.random.default_rng(1).standard_normal(SAMPLES)


def test_the_score_of_a_model_is_its_marginal_likelihood():
    row = recorded(1.0)
    assert score(*best_fit(row, SD)) == pytest.approx(minus_twice_log_likelihood(row, SD), rel=1e-9)


def test_the_projection_takes_the_prior_of_largest_marginal_likelihood():
    for bend in (0.0, 1.0):
        row = recorded(bend)
        known = [minus_twice_log_likelihood(row, SD | {"map.bend": s * SD["map.bend"]}) for s in SHAPE_SCALES]
        projection = Projection(*best_fit(row, SD))
        assert projection.floor == pytest.approx(min(known), rel=1e-6)
        level = projection.best(*projection.state({}))[1]
        assert level.scales["map"] == SHAPE_SCALES[int(np.argmin(known))]
    assert known.index(min(known)) > 0, "what is bent must ask for a wider prior than what is straight"


@pytest.mark.parametrize("bend", [3.0, 14.0])
def test_a_shape_that_is_named_is_as_wide_as_is_most_likely(bend):
    row = recorded(bend)

    def unlikely(width):
        return minus_twice_log_likelihood(row, SD | {"map.bend": width * SD["map.bend"]})

    likely = min(WIDTHS, key=unlikely)
    problem, base = best_fit(row, SD)
    found = widened_shape(Projection(problem, base), "map")
    assert found.scales["map"] == likely
    price = penalty(base, 1)
    assert found.evidence == pytest.approx(unlikely(SHAPE_SCALES[-1]) - unlikely(likely) - price, rel=1e-6)
    wide = SD | {"map.bend": likely * SD["map.bend"]}
    assert score(*best_fit(row, wide, ("map",))) == pytest.approx(unlikely(likely) + price, rel=1e-9)
    projection = Projection(*best_fit(row, wide, ("map",)))
    assert projection.best(*projection.state({}))[1].scales["map"] == likely


def test_a_parameter_of_an_effect_costs_the_log_of_the_samples():
    size = Free("slip.size", 1.0, -INFINITE, INFINITE, INFINITE)
    row = recorded(0.5)
    plain, more = score(*best_fit(row, SD)), score(*best_fit(row, SD, ("slip",), (size,)))
    assert more - plain == pytest.approx(math.log(SAMPLES))
    _, base = best_fit(row, SD)
    assert penalty(base, 3) == pytest.approx(3 * math.log(SAMPLES))


@pytest.mark.parametrize(("scale", "counted"), [(0.05, 0.3), (0.3, 1.0), (1.0, 1.0), (8.0, 8.0)])
def test_an_interval_counts_with_what_shape_corrections_may_hide(scale, counted):
    columns = np.column_stack([COLUMNS["map.bend"] + 0.1 * COLUMNS["mass"], COLUMNS["map.bend"]])

    def known(width):
        return columns.T @ columns + np.diag([0.0, 1 / (width * SD["map.bend"]) ** 2])

    steps = np.array([0.2, 0.5])
    free = (
        Free("slip.size", steps[0], -INFINITE, INFINITE, INFINITE),
        Free("map.bend", steps[1], -INFINITE, INFINITE, scale * SD["map.bend"]),
    )
    problem, _ = best_fit(recorded(0.0), SD)
    hessian = known(scale) * np.outer(steps, steps)
    model = Fit(("slip",), {"slip.size": 0.7, "map.bend": 0.0}, 0.0, hessian, free, SAMPLES, {})
    found = deviations(problem.system, model, np.linalg.inv(hessian))
    assert found == pytest.approx(np.sqrt(np.diag(np.linalg.inv(known(counted)))), rel=1e-9)
    low, high = interval(model, found, "slip.size")
    assert (low + high) / 2 == pytest.approx(0.7)
    assert high - low == pytest.approx(2 * 1.96 * found[0])


def judged(monkeypatch, models, strained=False, silent=False, due=100.0, fall=0.0):
    """Return the step in which held-out recordings see models: name -> (evidence, t, transfer, size)."""
    seen = {name: Seen(t, transfer, fall, due) for name, (_, t, transfer, _) in models.items()}
    monkeypatch.setattr(acceptance, "confirmed", lambda *args: seen[args[-1].effects[-1]])
    monkeypatch.setattr(acceptance, "is_visible", lambda *_: not strained)
    monkeypatch.setattr(acceptance, "leaves_noise_alone", lambda *_: silent)
    monkeypatch.setattr(acceptance, "is_rounding", lambda *_: False)
    size = Quantity("size", 1.0, "kg/(s Pa)", 0.0, 1e3, "of the leak", 0.0)
    effect = Effect("leak", "gas", (size,), lambda *_: Contribution({}), "", "", minimum_effect=1.0)
    weighted = SimpleNamespace(weights={}, weighted=lambda _: None)
    problem = SimpleNamespace(
        system=SimpleNamespace(catalogue=dict.fromkeys(models, effect)), weighted=lambda _: None
    )
    able = [
        (evidence, weighted, SimpleNamespace(effects=(name,), values={f"{name}.size": value}))
        for name, (evidence, _, _, value) in models.items()
    ]
    return acceptance.accepted(problem, None, weighted, able, (), {}, ("blocked",))


@pytest.mark.parametrize(
    ("t", "transfer", "fall", "strained", "accepted"),
    [
        (3.5, 0.1, 50.0, False, True),
        (2.5, 0.1, 50.0, False, False),
        (2.5, 0.5, 50.0, False, True),
        (-2.0, 0.0, -50.0, False, False),
        (-2.0, 0.0, -50.0, True, True),
        (-4.0, 0.0, -50.0, True, False),
        (-4.0, 0.0, -0.1, True, True),  # steadily, but by a trifle
    ],
)
def test_held_out_recordings_decide(monkeypatch, t, transfer, fall, strained, accepted):
    step = judged(monkeypatch, {"leak": (90.0, t, transfer, 5.0)}, strained, fall=fall)
    assert step.accepted == ("leak" if accepted else None)
    assert accepted or step.reason == "held-out recordings do not confirm leak"


@pytest.mark.parametrize(
    ("evidence", "silent", "due", "fall", "accepted"),
    [
        (31.0, True, 35.0, 0.0, True),
        (29.0, True, 35.0, 0.0, False),
        (31.0, False, 35.0, 0.0, False),  # something else is in the training recordings
        (31.0, True, 37.0, 0.0, False),  # held-out ones could have shown it
        (31.0, True, 35.0, -10.0, False),  # they speak against it
    ],
)
def test_what_held_out_recordings_cannot_show_training_alone_decides(
    monkeypatch, evidence, silent, due, fall, accepted
):
    step = judged(monkeypatch, {"leak": (evidence, 0.5, 0.0, 5.0)}, silent=silent, due=due, fall=fall)
    assert step.accepted == ("leak" if accepted else None)


def test_what_is_too_small_is_not_called_unconfirmed(monkeypatch):
    step = judged(monkeypatch, {"leak": (90.0, 8.0, 0.9, 0.5)})
    assert step.accepted is None
    assert step.reason == "leak is smaller than what is worth a name (1 kg/(s Pa))"


def test_a_refusal_names_one_effect(monkeypatch):
    step = judged(monkeypatch, {"leak": (90.0, 1.0, 0.1, 5.0), "creep": (80.0, -7.0, 0.0, 5.0)})
    assert (step.evidence, step.held_out_t) == (90.0, 1.0)
    assert step.reason.endswith("leak")
    assert step.blocked == ("blocked",)
    second = judged(monkeypatch, {"leak": (90.0, 9.0, 0.9, 0.5), "creep": (80.0, 7.0, 0.9, 5.0)})
    assert (second.accepted, second.evidence, second.held_out_t) == ("creep", 80.0, 7.0)


def test_a_row_of_residuals_lies_run_by_run_and_channel_by_channel():
    """All that judges residuals piece by piece takes the pieces from one place."""
    lengths, warm_up = (7, 5), 2
    runs = [SimpleNamespace(recording=SimpleNamespace(samples=n + warm_up), period=0.01) for n in lengths]
    replay = SimpleNamespace(system=SimpleNamespace(equations=()))
    problem = Problem(replay, [Scored(run, None, warm_up) for run in runs])
    equation = SimpleNamespace(name="gas", channels=("extensor", "flexor"))
    row = np.arange(24.0)
    parts = [part.tolist() for _, part in problem.by_run(equation, row)]
    assert parts == [[list(range(7)), list(range(7, 14))], [list(range(14, 19)), list(range(19, 24))]]
    both = np.column_stack([row, -row])
    assert [part.shape for _, part in problem.by_run(equation, both)] == [(2, 7, 2), (2, 5, 2)]
