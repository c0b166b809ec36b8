# SPDX-License-Identifier: Apache-2.0
"""A system of one's own: zeros of sensors, inputs that lag, and what has no size that recordings tell."""

from types import SimpleNamespace

import numpy as np
import pytest

from pam_orthosis.discrepancy.api import (
    Channel,
    Effect,
    Input,
    Model,
    Parameter,
    Quantity,
    check_system,
    find_gap,
    from_arrays,
)
from pam_orthosis.discrepancy.replay.run import Run
from pam_orthosis.discrepancy.search.confirmation import is_slow
from pam_orthosis.discrepancy.search.elimination import _tells_nothing

PERIOD, SUBSTEPS, COUNT = 0.02, 40, 1500
NOISE = 1e-3  # K
HEAT = [
    Parameter("gain", 1.0, "1", 0.02, "of the heater"),
    Parameter("transfer", 0.5, "1/s", 0.01, "of heat"),
]


def equations(s, p):
    s.passed = p.transfer * (s.hot - s.cold)
    return {"hot": p.gain * s.power - s.passed, "cold": s.passed - 0.3 * s.cold**2}


def two(**changes):
    """Return two vessels, one heated by the other, which loses the more heat by a degree the hotter it is."""
    parts = {
        "name": "vessels",
        "channels": [Channel(name, name, "K", "mK", 1e3) for name in ("hot", "cold")],
        "inputs": [Input("power", "K/s")],
        "states": ["hot", "cold"],
        "equations": equations,
        "parameters": HEAT,
    }
    return Model(**{**parts, **changes}).system()


def heated(system, seed, lag=0.0, zero=0.0, power=None):
    """Return a recording; `lag` of the heater in s, `zero` of the cold vessel's sensor in K."""
    rng, step = np.random.default_rng(seed), PERIOD / SUBSTEPS
    asked = np.repeat(rng.choice([0.0, 0.5, 1.0], COUNT // 50), 50) if power is None else power
    rows, hot, cold, acts = np.zeros((COUNT, 2)), 1.0, 0.6, asked[0]
    for k in range(COUNT):
        rows[k] = hot, cold
        for _ in range(SUBSTEPS):
            before = acts if lag else asked[k]
            acts += (asked[k] - acts) * (1 - np.exp(-step / lag) if lag else 1.0)
            passed = 0.5 * (hot - cold)
            hot, cold = hot + step * ((before + acts) / 2 - passed), cold + step * (passed - 0.3 * cold**2)
    hot, cold = (rows + NOISE * rng.standard_normal(rows.shape)).T
    time = np.arange(COUNT) * PERIOD
    return from_arrays(str(seed), system, {"time": time, "hot": hot, "cold": cold + zero, "power": asked})


def searched(system, **how):
    check_system(system)
    outcome = find_gap(system, [heated(system, 1, **how)], [heated(system, 2, **how)])
    return outcome, {one.name: next(iter(one.parameters.values())) for one in outcome.effects}


@pytest.mark.parametrize(
    ("how", "name", "size"),
    [({"zero": 0.05}, "cold_zero", 0.05), ({"lag": 0.2}, "inputs_lag", 0.2), ({}, "", 0.0)],
)
def test_the_zero_of_a_sensor_and_an_input_that_lags_are_named(how, name, size):
    outcome, named = searched(two(), **how)
    assert (outcome.verdict, [*named]) == (("explained", [name]) if name else ("none", []))
    for value, _, low, high in named.values():
        assert value == pytest.approx(size, rel=0.02)
        assert low < size < high


def test_a_constant_that_the_equations_lack_is_no_zero():
    outcome, named = searched(two(equations=warmed), zero=0.0)
    assert (outcome.verdict, named) == ("described", {})


def warmed(s, p):
    """Return the equations with a constant that the recordings do not have."""
    rates = equations(s, p)
    return {**rates, "cold": rates["cold"] + 0.02}


def test_a_model_that_knows_a_zero_or_a_lag_leaves_noise():
    for name, quantity, how in (
        ("cold_zero", "offset", {"zero": 0.05}),
        ("inputs_lag", "time", {"lag": 0.2}),
    ):
        (size,) = how.values()
        system = two().changed({f"effects.{name}.enabled": True, f"effects.{name}.{quantity}": size})
        assert name not in system.catalogue
        assert searched(system, **how)[0].verdict == "none"


def test_what_lags_behind_an_input_begins_where_the_input_is():
    system = two()
    run = Run(system, heated(system, 1, power=np.full(COUNT, 0.7)), 5.0)
    assert run.states(SimpleNamespace(own=("hot", "power_follows")), np.array([0, 9]))[:, 1] == pytest.approx(
        0.7
    )


def carriage():
    """Return a carriage: where it stands changes nothing."""
    return Model(
        name="carriage",
        channels=[Channel("position", "position", "m", "mm", 1e3), Channel("pull", None, "N", "N", 1.0)],
        inputs=[Input("force", "N")],
        states=["position", "velocity"],
        equations=_driven,
        parameters=[Parameter("drag", 1.0, "N s/m", 0.1, "of the guide")],
    ).system()


def _driven(s, p):
    s.pull = s.force - p.drag * s.velocity
    return {"position": s.velocity, "velocity": s.pull}


def zeros(system):
    return {one.removesuffix("_zero") for one in system.catalogue if one.endswith("_zero")} - {"wrong"}


def with_zero(s, p):
    rates = equations(s, p)
    s.measured_cold = s.cold + p.zero
    return rates


def test_a_zero_that_a_constant_may_be_that_shows_nowhere_or_that_a_user_knows_is_no_candidate():
    assert zeros(two()) == {"cold"}  # on a linear law that of the other one does what a constant does
    assert "pull_zero" in carriage().catalogue
    assert "position_zero" not in carriage().catalogue
    known = two(equations=with_zero, parameters=[*HEAT, Parameter("zero", 0.0, "K", 0.1, "of a sensor")])
    offset = Quantity("off", 0.1, "K", -1.0, 1.0, "of the sensor", 0.0)
    own = Effect("off", "measured_cold", (offset,), lambda s, p, _: p.off, "its zero", "")
    for system in (two(effects=[own]), known):
        assert zeros(system) == set()


def test_a_lag_of_half_a_recording_is_none():
    system = two()
    problem = SimpleNamespace(
        system=system, scored=[SimpleNamespace(run=Run(system, heated(system, 1), 5.0))]
    )
    for name in ("cold_lag", "inputs_lag"):
        slow = [is_slow(problem, name, SimpleNamespace(values={f"{name}.time": t})) for t in (1.0, 16.0)]
        assert slow == [False, True]
    assert not is_slow(problem, "cold_zero", SimpleNamespace(values={"cold_zero.offset": 16.0}))


@pytest.mark.parametrize(
    ("name", "interval", "expected"),
    [
        ("cold_lag", (1.2, 29.6), True),
        ("cold_lag", (5e-4, 12.0), True),
        ("cold_lag", (1.2, 12.0), False),
        ("cold_zero", (-0.01, 0.2), True),
        ("cold_zero", (0.01, 0.2), False),
    ],
)
def test_an_interval_that_holds_all_or_none_tells_no_size(name, interval, expected):
    assert _tells_nothing(two().catalogue[name], *interval) is expected
