# SPDX-License-Identifier: Apache-2.0
"""The experiment that would help next, as a table of references for a controller of one's own."""

from __future__ import annotations

import csv
from collections.abc import Collection, Sequence
from io import StringIO
from typing import TYPE_CHECKING

from pam_orthosis.control.reference import Valve
from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.model.parameters import Parameters, experiments, scenario_overrides

if TYPE_CHECKING:
    from pam_orthosis.discrepancy.answer.judgement import Outcome


def next_experiment(
    outcome: Outcome | None, useful: Sequence[str], possible: Collection[str] | None = None
) -> str:
    """Return the scenario that separates what was found, if that is known, or else shows most; or nothing.

    `possible`: scenarios to choose from; all diagnostic experiments if None.
    """
    if outcome and outcome.foreign:
        return ""
    possible = experiments() if possible is None else possible
    found = (*outcome.effects, *outcome.surrogates) if outcome else ()
    apart = [test for one in found for test in one.separated_by]
    return next((name for name in (*apart, *useful) if name in possible), "")


def references(name: str, parameters: Parameters) -> str:
    """Return a CSV table: time s, position rad or m, mean pressure absolute Pa, whether valves are closed.

    The pressure is empty where valves are closed, or the controller's own is to be held.

    OrthosisError if the experiment is not for this machine, or its stops are in the way.
    """
    parameters = parameters.changed(scenario_overrides(name))
    experiment = make_trajectory(parameters)
    text = StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(
        ("time", f"reference_{parameters.declared.coordinate.name}", "mean_pressure", "valves_closed")
    )
    period_ns = 10_000_000  # a controller interpolates
    for time_ns in range(0, round(parameters.scenario.duration * 1e9), period_ns):
        now = experiment.sample(time_ns)
        asked = now.mean_pressure
        mean = "" if asked is None or isinstance(asked, Valve) else f"{asked:.0f}"  # no 0, which is vacuum
        row = f"{time_ns * 1e-9:.2f}", f"{now.position:.5f}", mean, int(asked is Valve.CLOSED)
        table.writerow(row)
    return text.getvalue()


def advice(name: str, parameters: Parameters) -> str:
    """Return in words what to do, what to record, and what to do with it."""
    machine = parameters.declared
    signals = [
        machine.coordinate.name,
        *(f"{n}_{what}" for what in ("pressure", "voltage") for n in machine.names),
    ]
    return (
        f"next: {experiments()[name]}; record {', '.join(signals)} by one clock, every"
        f" {1e3 * parameters.scenario.control_period:g} ms, and give them to gap beside these recordings"
    )
