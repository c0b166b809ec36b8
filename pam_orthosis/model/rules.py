# SPDX-License-Identifier: Apache-2.0
"""Rules between parameters that no single bound can express."""

import hashlib
import math
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

from pam_orthosis.model.components import muscle
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.mechanisms import leg

SHAPES = {"gait": "gait", "sine": "sine", "steps": "step"}  # trajectory -> section of its shape
# each chain must be strictly increasing
ORDERED = (
    ("valve.ambient_pressure", "control.position.minimum_pressure", "control.position.mean_pressure",
     "control.position.maximum_pressure", "valve.supply_pressure"),
    ("valve.minimum_voltage", "valve.closed_voltage", "valve.maximum_voltage"),
    ("scenario.diagnostic.low_angle", "scenario.diagnostic.high_angle"),
    ("scenario.diagnostic.low_mean", "scenario.diagnostic.high_mean"),
    *leg.ORDERED,
)  # fmt: skip
# what any apparatus of this kind has of one size: where one is so many times another, a decimal point slipped
ALIKE = (
    *leg.ALIKE,
    ("control.position.c1", "control.position.c2"),
    ("gap.tolerance.extensor_force", "gap.tolerance.flexor_force"),
    ("gap.tolerance.extensor_closed_voltage", "gap.tolerance.flexor_closed_voltage"),
    ("gap.tolerance.extensor_pressure_offset", "gap.tolerance.flexor_pressure_offset"),
)
BACKSTEPPING, POSITION = "backstepping", "position"
PHASES = 60
FARTHEST_PLAN = 0.35  # rad: beyond it guards would take the joint for one that does not follow


def broken_rules(values: Mapping[str, Any], machine: Machine) -> Iterator[str]:
    """Yield one sentence for each broken rule among the values that are there, those of a machine."""
    for chain in ORDERED:
        known = [key for key in chain if key in values]
        for low, high in pairwise(known):
            if not values[low] < values[high]:
                yield f"{low} = {values[low]} must be below {high} = {values[high]}"
    for group in ALIKE:
        yield from _alike(values, group)
    yield from muscle.broken_rules(values)
    yield from _period_rules(values)
    yield from _step_rule(values)
    yield from leg.broken_rules(values)
    if machine.start.startswith("scenario."):  # the scenarios are its own
        yield from out_of_reach(values, machine)
    yield from _plan_rule(values)
    yield from _controller_rule(values)
    yield from _delay_rule(values)
    yield from _person_rule(values)


def _person_rule(values: Mapping[str, Any]) -> Iterator[str]:
    """Refuse what a person is to do who does not act on the joint at all."""
    acts = "plant.person.volition.enabled"
    for key in ("plant.person.block.start", "plant.person.spasm.start"):
        if not values.get(acts, True) and values.get(key, -1.0) >= 0:
            yield f"{key} = {values[key]:g} has no effect while {acts} is false: set that to true too"


def _period_rules(values: Mapping[str, Any]) -> Iterator[str]:
    """Compare the control period with the steps of simulation and position controller, and with the run."""
    period, step = values.get("scenario.control_period"), values.get("plant.simulation.step")
    if period is None:
        return
    ratio = 1.0 if step is None else period / step
    if abs(ratio - round(ratio)) > 1e-9 * ratio or round(ratio) < 1:
        yield (
            f"scenario.control_period = {period} s must be a whole multiple of"
            f" plant.simulation.step = {step} s"
        )
    every, duration = values.get("control.position.every", 1), values.get("scenario.duration")
    longest = 0.05  # s, of the position controller's period: as long as a control period may be
    if every * period > longest:
        yield (
            f"control.position.every = {every} times scenario.control_period = {period} s must be at most"
            f" {longest} s"
        )
    if duration is not None and duration < 4 * every * period:
        times = f" times control.position.every = {every}" if every > 1 else ""
        text = f"scenario.control_period = {period} s{times}"
        yield f"scenario.duration = {duration} s must be four times {text}"


def _delay_rule(values: Mapping[str, Any]) -> Iterator[str]:
    """Check that a dead time of the hardware, whose differential equations have it as a divisor, is one."""
    effect = "plant.effects.valve_delay"
    delay = values.get("plant.effects.valve_delay.delay", 0.0)
    least_delay = 5.0e-4  # s, of a Pade approximation: its states have less than a quarter of it
    if values.get(f"{effect}.enabled") and delay != 0.0 and delay < least_delay:
        yield f"{effect}.delay = {delay} s must be 0 or at least {least_delay} s: hardware is never early"


def _step_rule(values: Mapping[str, Any]) -> Iterator[str]:
    if values.get("scenario.trajectory") != "steps":
        return
    rise, cycle = values["scenario.step.rise"], values["scenario.cycle_time"]
    if rise > 0.5 * cycle:
        yield f"scenario.step.rise = {rise} s must be at most half of scenario.cycle_time = {cycle} s"


def _controller_rule(values: Mapping[str, Any]) -> Iterator[str]:
    """Check that another law than backstepping follows a reference, which is what it is for."""
    key, mode = "control.position.controller", "control.cooperation.mode"
    name = values.get(key, BACKSTEPPING)
    if name != BACKSTEPPING and values.get(mode, POSITION) != POSITION:
        yield f"{key} = {name} is for {mode} = {POSITION}, not {values[mode]}"
    if name != BACKSTEPPING and not values.get("control.position.feedback", True):
        yield f"{key} = {name} needs control.position.feedback = true"


def _alike(values: Mapping[str, Any], keys: tuple[str, ...]) -> Iterator[str]:
    sizes = {key: abs(values[key]) for key in keys if values.get(key)}
    slip = 8.0
    if len(sizes) > 1 and max(sizes.values()) >= slip * min(sizes.values()):
        text = " and ".join(f"{key} = {values[key]}" for key in sizes)
        yield f"{text} are of the same kind and differ {slip:g}-fold or more; has a decimal point slipped?"


def out_of_reach(values: Mapping[str, Any], machine: Machine) -> Iterator[str]:
    """Yield a sentence if the machine's stops are before where it is to start or to follow."""
    stops = {key: values[key] for key in machine.stops if key in values}
    if len(stops) < 2 or "scenario.trajectory" not in values:
        return
    low, high = stops.values()
    for name, place in _places(values, machine.start):
        if not low <= place <= high:
            limits = " .. ".join(f"{key} = {value}" for key, value in stops.items())
            yield f"{name} goes to {place:.3g} {machine.coordinate.unit}, outside {limits}"
            return


def _places(values: Mapping[str, Any], start: str) -> Iterator[tuple[str, float]]:
    yield start, values[start]
    if values["scenario.trajectory"] == "sine":
        centre, amplitude = values["scenario.sine.centre"], values["scenario.sine.amplitude"]
        yield from (("scenario.sine.amplitude", centre + sign * amplitude) for sign in (-1, 1))
    if values["scenario.trajectory"] == "steps":
        yield from ((key, values[key]) for key in ("scenario.step.low", "scenario.step.high"))
    if values["scenario.trajectory"] == "gait":
        yield from (("scenario.gait", place) for place in _waves(values, "scenario.gait"))


def _plan_rule(values: Mapping[str, Any]) -> Iterator[str]:
    """Check that a plan is for this cycle, near what is wanted, and between the limits of the pressures."""
    if not values.get("scenario.plan.enabled"):
        return
    cycle, planned = values["scenario.cycle_time"], values["scenario.plan.cycle_time"]
    if cycle != planned:
        yield f"scenario.plan is for a cycle of {planned} s, scenario.cycle_time = {cycle} s: plan again"
    made_for = values.get("scenario.plan.made_for")
    if made_for and "leg.person.present" in values and made_for != motion_digest(values):
        yield "scenario.plan is for another motion, or for a leg with or without a person: plan again"
    angles, pressures = (_settled_and_started(values, name) for name in ("angle", "pressure"))
    farthest = max(map(abs, angles))
    if farthest >= FARTHEST_PLAN:
        yield f"scenario.plan.angle goes {farthest:.3g} rad away, {FARTHEST_PLAN} at most is wanted"
    low, high = (values.get(f"control.position.{end}_pressure") for end in ("minimum", "maximum"))
    if low is not None and high is not None and not low <= min(pressures) <= max(pressures) <= high:
        text = f"goes from {min(pressures):.3g} to {max(pressures):.3g} Pa"
        yield f"scenario.plan.pressure {text}, outside control.position's limits {low:.3g} .. {high:.3g} Pa"


def _settled_and_started(values: Mapping[str, Any], name: str) -> list[float]:
    """Return what a plan asks for over a cycle, when it has settled and at the start."""
    settled = _waves(values, f"scenario.plan.{name}")
    added = _waves(values, f"scenario.plan.start.{name}")
    return settled + [value + more for value, more in zip(settled, added, strict=True)]


def motion_digest(values: Mapping[str, Any]) -> str:
    """Return what identifies a motion, of a leg with or without a person."""
    trajectory = values["scenario.trajectory"]
    keys = [key for key in sorted(values) if key.startswith(f"scenario.{SHAPES.get(trajectory)}.")]
    others = "scenario.start_phase", "scenario.start_angle", "leg.person.present"
    keys += [key for key in others if key in values]  # not every machine has a leg
    numbers = [values[key] if isinstance(values[key], list) else [values[key]] for key in keys]
    content = trajectory, keys, [[float(number) for number in each] for each in numbers]
    return hashlib.sha256(repr(content).encode()).hexdigest()[:12]


def _waves(values: Mapping[str, Any], series: str) -> list[float]:
    """Return the values of a Fourier series of the parameters over a cycle."""
    pairs = list(enumerate(zip(values[f"{series}.cosine"], values[f"{series}.sine"], strict=True)))
    phases = [2 * math.pi * k / PHASES for k in range(PHASES)]
    return [sum(a * math.cos(n * phase) + b * math.sin(n * phase) for n, (a, b) in pairs) for phase in phases]
