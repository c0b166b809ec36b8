# SPDX-License-Identifier: Apache-2.0
"""The page of a planned cycle: what is wanted, what can be made, and with what pressures."""

import numpy as np

from pam_orthosis.model.machine import Machine
from pam_orthosis.planning.plan import Plan
from pam_orthosis.report.page import GOOD, NEUTRAL, Page, Part
from pam_orthosis.report.plots import ESTIMATE, MEASURED, OF_ACTUATORS, REFERENCE, Plot, line
from pam_orthosis.report.run_data import BAR

LITTLE = 1e-3  # rad or m, which nobody sees


def page(machine: Machine, plan: Plan, words: str) -> str:
    """Return the page; `words` are what the verb prints."""
    coordinate, away = machine.coordinate, float(np.abs(plan.cycle.position - plan.wanted).max())
    reached = away < LITTLE
    headline = (
        "The wanted motion is within reach of muscles, valves and supply."
        if reached
        else f"The wanted motion is out of reach: the nearest one is up to {coordinate.shown(away)} away."
    )
    meaning = ["By the nominal model; errors of a run still count from the wanted motion."]
    parts = [
        Part("The cycle", plots=[_motion(machine, plan), _pressures(machine, plan)]),
        Part("All numbers", pre=words, more="as plan prints it"),
    ]
    answer, tone = ("within reach", GOOD) if reached else ("nearest motion", NEUTRAL)
    return Page("plan", answer, tone, headline, meaning, parts, f"planned cycle of the {machine.name}").html()


def _motion(machine: Machine, plan: Plan) -> Plot:
    coordinate, time = machine.coordinate, _time(plan)
    shown = coordinate.shown_factor
    curves = [
        line(time, shown * plan.wanted, "wanted", REFERENCE, "dash", 2.2),
        line(time, shown * plan.cycle.position, "planned", MEASURED),
    ]
    if np.abs(plan.asked - plan.cycle.position).max() > LITTLE:
        curves.append(line(time, shown * plan.asked, "asked for, so that the plan is made", ESTIMATE, "dot"))
    name, unit = coordinate.name, coordinate.shown_unit
    alt = f"{name} over a cycle of {plan.cycle_time:g} s: wanted and planned"
    return Plot(f"{machine.name} {name}", alt, "time / s", f"{name} / {unit}", curves, (), "time")


def _pressures(machine: Machine, plan: Plan) -> Plot:
    time, cycle = _time(plan), plan.cycle
    curves = [
        line(time, pressure / BAR, name, colour)
        for name, pressure, colour in zip(machine.names, cycle.pressures, OF_ACTUATORS, strict=False)
    ]
    curves.append(line(time, cycle.mean_pressure / BAR, "mean: sets the stiffness", REFERENCE, "dash"))
    low, high = cycle.pressures.min() / BAR, cycle.pressures.max() / BAR
    alt = f"pressures over the cycle, {low:.2f} to {high:.2f} bar"
    return Plot("Pressures", alt, "time / s", "pressure / bar absolute", curves, (), "time")


def _time(plan: Plan) -> np.ndarray:
    return np.arange(len(plan.wanted)) / len(plan.wanted) * plan.cycle_time
