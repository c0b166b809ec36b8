# SPDX-License-Identifier: Apache-2.0
"""What an input does between rows: as its system says, and said where recordings know better."""

from dataclasses import replace

import numpy as np
import pytest

from pam_orthosis.discrepancy.api import (
    Channel,
    Effect,
    Input,
    Model,
    OrthosisError,
    Parameter,
    Quantity,
    check_system,
    find_gap,
    from_arrays,
)

LEAK, AREA = 0.3, 0.5  # 1/s, m^2
PERIOD, SUBSTEPS, COUNT = 0.02, 10, 1000
NEAR = 1.5e-4  # of the leak


def tank(held):
    """Return a tank whose leak is missing."""

    def equations(s, p):
        s.net = s.inflow / AREA
        s.measured_level = s.level + p.offset
        return {"level": s.net}

    leak = Effect(
        name="leak",
        stage="net",
        parameters=(Quantity("rate", 0.1, "1/s", 0.0, 5.0, "of the level", 0.0),),
        expression=lambda s, p, own: -p.rate * s.level,
        physics="It leaks.",
        source="assumption",
    )
    return Model(
        name="tank",
        channels=[Channel("level", "level", "m", "mm", 1e3)],
        inputs=[Input("inflow", "m^3/s", held=held)],
        states=["level"],
        equations=equations,
        parameters=[Parameter("offset", 0.0, "m", 1e-3, "zero of the gauge")],
        effects=[leak],
    ).system()


def recorded(system, seed, held, tide=0.0):
    """Return a recording, by equations of its own; `held`: what flows in changes at rows only.

    `tide`: what flows in and out beside it, m/s.
    """
    rng, count = np.random.default_rng(seed), COUNT
    time = np.arange(count * SUBSTEPS) * PERIOD / SUBSTEPS
    inflow = 0.2 + sum(
        0.05 * np.sin(2 * np.pi * f * time + phase)
        for f, phase in zip((0.03, 0.08, 0.3), rng.uniform(0, 6, 3), strict=True)
    )
    if held:
        inflow = np.repeat(inflow[::SUBSTEPS], SUBSTEPS)
    level, shrunk = np.empty(len(time)), np.exp(-LEAK * PERIOD / SUBSTEPS)
    level[0] = 1.0
    for k in range(1, len(time)):
        drive = inflow[k - 1] if held else 0.5 * (inflow[k - 1] + inflow[k])
        rate = drive / AREA + tide * np.sin(7.0 * time[k] + seed)
        level[k] = shrunk * level[k - 1] + (1 - shrunk) / LEAK * rate
    rows = slice(None, None, SUBSTEPS)
    arrays = {
        "time": time[rows],
        "level": level[rows] + 1e-4 * rng.standard_normal(count),
        "inflow": inflow[rows],
    }
    return from_arrays(str(seed), system, arrays)


def found(really, said):
    """Return the leak, and remarks on the input."""
    system = tank(said)
    outcome = find_gap(system, [recorded(system, 1, really)], [recorded(system, 2, really)])
    (leak,) = outcome.effects
    return leak.parameters["rate"][0], [one for one in outcome.remarks if one.startswith("inflow")]


def test_between_rows_an_input_goes_straight_if_its_system_says_so():
    leak, remarks = found(really=False, said=False)
    assert leak == pytest.approx(LEAK, rel=NEAR)
    assert not remarks


@pytest.mark.parametrize(("really", "way"), [(False, "going straight from row to row"), (True, "held until")])
def test_the_wrong_way_is_said(really, way):
    leak, remarks = found(really, not really)
    assert abs(leak - LEAK) > 3 * NEAR * LEAK
    (remark,) = remarks
    assert way in remark
    assert f"held={really} " in remark


def test_a_way_that_leaves_more_than_noise_is_no_reason_to_change_it():
    system = tank(False)
    outcome = find_gap(system, *([recorded(system, seed, True, tide=0.01)] for seed in (1, 2)))
    (remark,) = (one for one in outcome.remarks if one.startswith("inflow"))
    assert remark.endswith("no reason to change it")


@pytest.mark.parametrize("held", [True, False])
def test_missing_rows_of_an_input_are_interpolated(held):
    time = np.delete(np.arange(600) * PERIOD, 300)
    arrays = {"time": time, "level": np.sin(time), "inflow": time}
    assert from_arrays("a", tank(held), arrays).signals["inflow"][300] == pytest.approx(300 * PERIOD)


@pytest.mark.parametrize(("held", "value"), [(True, 299.0), (False, 299 + 1 / 1.4)])
def test_between_stamps_that_jitter_an_input_keeps_its_value_unless_it_is_gradual(held, value):
    rows = np.arange(600.0)
    time = PERIOD * np.where(rows == 300, 300.4, rows)
    arrays = {"time": time, "level": np.sin(time), "inflow": rows}
    assert from_arrays("a", tank(held), arrays).signals["inflow"][300] == pytest.approx(value)


def test_a_gradual_input_that_is_none_is_refused():
    with pytest.raises(OrthosisError, match="gradual: 'pump' is none of inflow"):
        check_system(replace(tank(True), gradual=("pump",)))
