# SPDX-License-Identifier: Apache-2.0
"""What corrects a static map is shown as a curve, in the units of its map, where recordings say something."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pam_orthosis.discrepancy.answer.curves import curves, drawn, in_words
from pam_orthosis.discrepancy.answer.verdict import runner_up_words
from pam_orthosis.discrepancy.search.findings import Named
from pam_orthosis.model.effects.valves import SIDE, knot_name, relative_error
from pam_orthosis.model.machines import KNEE
from pam_orthosis.report import gap, gap_figures
from pam_orthosis.report.plots import packed

VALVE = KNEE.catalogue["valve_curve_misfit"]
KNOTS = [knot_name(k) for k in range(-SIDE, SIDE + 1)]


def own(effect, actuator="extensor"):
    return [q for q in effect.parameters if q.name.startswith(f"{actuator}_")]


def shown(effect, values, known=0.1):
    sizes = np.array([q.prior for q in own(effect)])
    return drawn(effect, "extensor", np.asarray(values), np.diag((known * sizes) ** 2), sizes)


def test_a_valve_curve_is_the_opening_that_the_model_has():
    values = np.linspace(-0.1, 0.2, 11)
    (curve,) = shown(VALVE, values)
    openings = curve.places / 100
    expected = [100 * x * (1 + float(relative_error(x, list(values)))) for x in openings]
    assert curve.found == pytest.approx(expected)
    assert (curve.nominal == curve.places).all()
    assert (curve.places[0], curve.places[-1], curve.map.unit) == (-100, 100, "%")
    plot, less = gap_figures.maps([curve])
    assert (plot.x, plot.y) == ("opening by the nominal model / %", "valve opening / %")
    assert (less.x, less.y) == ("opening by the nominal model / %", "valve opening, difference / %")
    assert less.data[0]["y"] == packed(curve.found - curve.nominal)
    assert [trace["name"] for trace in plot.data] == ["nominal model", "found", "95 %, lower", "95 %, upper"]
    assert plot.data[1]["y"] == packed(curve.found)
    assert plot.data[2]["y"] == packed(curve.found - curve.half)


def test_its_interval_is_that_of_its_coefficients():
    sizes, spread = np.full(11, 0.03), np.diag(np.full(11, 0.01) ** 2)
    draws = np.random.default_rng(1).multivariate_normal(np.zeros(11), spread, 400)
    found = [drawn(VALVE, "extensor", values, spread, sizes)[0].found for values in draws]
    (curve,) = drawn(VALVE, "extensor", np.zeros(11), spread, sizes)
    assert 1.96 * np.std(found, axis=0) == pytest.approx(curve.half, rel=0.15)


def test_where_recordings_say_nothing_no_curve_is_drawn():
    sizes = np.full(11, 0.03)
    known = np.where(np.arange(11) < SIDE, 1.1, 0.1)  # venting was hardly seen
    (curve,) = drawn(VALVE, "extensor", np.zeros(11), np.diag((known * sizes) ** 2), sizes)
    assert -5 < curve.places[0] < 5
    assert curve.places[-1] == 100
    assert shown(VALVE, np.zeros(11), known=1.1) == []


def test_a_force_map_is_a_difference_at_three_pressures():
    effect = KNEE.catalogue["force_map_misfit"]
    names = [q.name.removeprefix("extensor_") for q in own(effect)]
    found = shown(effect, [{"c00": 4.0, "c10": 9.0}.get(name, 0.0) for name in names])
    assert [curve.pressure for curve in found] == [1, 3, 5]
    for curve in found:  # T1 runs from -1 to 1 over the stroke
        assert (curve.found[0], curve.found[-1]) == pytest.approx((4.0 - 9.0, 4.0 + 9.0))
    (plot,) = gap_figures.maps(found)
    assert plot.y == "static force, difference / N"
    assert plot.data[0]["name"].startswith("at 1 bar (±")
    (reported,) = in_words(found)
    assert reported.startswith("extensor: static force +1")
    assert "% contraction and" in reported


@pytest.mark.parametrize("name", [name for name, effect in KNEE.catalogue.items() if effect.shape])
def test_every_correction_of_a_map_can_be_drawn(name):
    effect = KNEE.catalogue[name]
    assert shown(effect, [0.0] * len(own(effect)))


def outcome(values):
    """Return what the curves look at of an outcome whose valve curve is known to a tenth of its priors."""
    keys = [f"{VALVE.name}.{q.name}" for q in VALVE.parameters]
    free = [SimpleNamespace(name=key, scale=0.003, sd=0.03) for key in keys]
    final = SimpleNamespace(free=free, hessian=np.eye(len(keys)), values=dict(zip(keys, values, strict=True)))
    problem = SimpleNamespace(system=SimpleNamespace(equations=()))
    wrong = replace(VALVE, name="leg_mass", shape=False)
    return SimpleNamespace(
        selection=SimpleNamespace(final=final, final_problem=problem),
        system=SimpleNamespace(
            catalogue={VALVE.name: VALVE, "leg_mass": wrong}, wrong={"leg_mass": "leg.mass"}, calibrations=()
        ),
    )


def test_the_page_draws_coefficients_and_marks_bounds():
    count = len(VALVE.parameters)
    parameters = {q.name: (0.1, "-", 0.09, 0.11) for q in VALVE.parameters}
    one = Named(VALVE.name, "valve", parameters, 50.0, at_bound=(VALVE.parameters[0].name,))
    seen = outcome([0.1] * (count // 2) + [-0.1] * (count // 2))
    part = gap._effect(seen, one, "")
    assert (part.title, part.table, part.pre) == ("Missing: valve curve misfit", None, "")
    assert f"1 of {count} values lie at a bound; the true ones may be beyond it." in part.words
    assert [plot.title.split()[0] for plot in part.plots] == ["Extensor,"] * 2 + ["Flexor,"] * 2
    extensor, flexor = (curve for curve in curves(seen, one))
    assert (np.abs(extensor.found) >= np.abs(extensor.nominal)).all()
    assert (np.abs(flexor.found) <= np.abs(flexor.nominal)).all()


def test_a_wrong_parameter_is_shown_beside_what_the_model_has():
    seen = outcome([0.0] * len(VALVE.parameters))
    quantity = replace(VALVE.parameters[0], name="value", neutral=3.0, meaning="mass of the leg", unit="kg")
    seen.system.catalogue["leg_mass"] = replace(VALVE, shape=False, parameters=(quantity,))
    seen.system.nominal_of = lambda name: seen.system.catalogue[name].parameters[0].neutral
    one = Named("leg_mass", "torque", {"value": (4.0, "kg", 3.9, 4.1)}, 50.0)
    assert gap.titled(seen, "leg_mass") == "Wrong in the model: mass of the leg"
    assert gap._values(seen, one) == [("mass of the leg", "4 kg", "3.9 to 4.1 kg", "3 kg")]


def test_the_next_best_is_said_in_words_whichever_fits_better():
    assert runner_up_words("creep", 12.3) == "next best: creep, with 12 less evidence"
    assert runner_up_words("creep", 27492518.0) == "next best: creep, far behind"
    assert runner_up_words("creep", 12.3, "play").startswith("next best in place of play: creep, ")
    assert (
        runner_up_words("creep", -4201.0)
        == "not accepted, although it fits better: creep, with 4201 more evidence"
    )
