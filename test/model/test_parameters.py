# SPDX-License-Identifier: Apache-2.0
"""Loading, checking and hiding of parameters."""

import math

import pytest

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model import parameters


def test_every_shipped_row_says_what_it_is():
    for row in parameters.load().rows():
        assert row.meaning, row.key
        assert row.unit, row.key
        assert row.source, row.key


def test_overrides_reach_the_tree_and_leave_the_defaults_alone():
    changed = parameters.load({"control.position.c1": 33})
    assert changed.control.position.c1 == 33.0
    assert parameters.load().control.position.c1 != 33.0


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("control.position.c3", 1.0, "did you mean control.position.c"),
        ("c1", 30.0, "did you mean control.position.c1"),
        ("control.position.c1", -1.0, "outside"),
        ("control.position.c1", math.nan, "finite"),
        ("control.position.c1", "forty", "number"),
        ("control.position.c1", True, "true or false|number"),
        ("valve.supply_pressure", 7.0, "check its unit"),
        ("leg.person.present", 1, "true or false"),
        ("leg.configuration", 0.5, "whole"),
        ("leg.configuration", 0, "1 .knee up. or -1"),
        ("scenario.trajectory", "walk", "not one of"),
        ("muscle.dmsp_20.force.a", [1.0, 2.0], "list of 4"),
        ("control.position.mean_pressure", 6.9e5, "must be below"),
        ("plant.simulation.step", 3.3e-4, "whole multiple"),
    ],
)
def test_unusable_values_are_refused_with_a_reason(key, value, words):
    with pytest.raises(OrthosisError, match=words):
        parameters.load({key: value})


def test_a_leg_that_cannot_reach_its_bearing_is_refused():
    short = {"leg.thigh.length": 0.22, "leg.shank.length": 0.22}
    parameters.load({**short, "leg.bearing_height": 0.2})
    with pytest.raises(OrthosisError, match="out of reach"):
        parameters.load({**short, "leg.bearing_height": 0.38})


def test_the_nominal_model_knows_no_plant():
    nominal = parameters.load().nominal()
    assert not [key for key in nominal.flat() if key.startswith("plant")]
    with pytest.raises(AttributeError):
        nominal.plant  # noqa: B018


def test_every_scenario_loads():
    names = parameters.scenario_names()
    assert {"default", "person"} <= set(names)
    for name in names:
        parameters.load(parameters.scenario_overrides(name))


def test_unknown_scenario_names_the_known_ones():
    with pytest.raises(OrthosisError, match="default"):
        parameters.scenario_overrides("marathon")


def test_broken_yaml_is_one_sentence(tmp_path):
    path = tmp_path / "broken.yaml"
    path.write_text("a: [1, 2\nb: }")
    with pytest.raises(OrthosisError, match="not valid YAML"):
        parameters.read_yaml(path)


def test_a_number_beyond_all_floats_is_refused():
    with pytest.raises(OrthosisError, match="not a finite number"):
        parameters.load({"valve.minimum_voltage": 10**400})
