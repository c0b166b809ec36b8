# SPDX-License-Identifier: Apache-2.0
"""Rules between parameters that no single bound can express."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

SHAPES = {"gait": "gait", "sine": "sine", "steps": "step"}  # trajectory -> section of its shape
MUSCLES = ("dmsp_20", "dmsp_10", "mas_40")
# each chain must be strictly increasing
ORDERED = (
    ("valve.ambient_pressure", "control.position.minimum_pressure", "control.position.mean_pressure",
     "control.position.maximum_pressure", "valve.supply_pressure"),
    ("valve.minimum_voltage", "valve.closed_voltage", "valve.maximum_voltage"),
    ("leg.joint.minimum", "leg.joint.maximum"),
    ("scenario.diagnostic.low_angle", "scenario.diagnostic.high_angle"),
    ("scenario.diagnostic.low_mean", "scenario.diagnostic.high_mean"),
    *(tuple(f"muscle.{m}.box.{end}_contraction" for end in ("minimum", "maximum")) for m in MUSCLES),
)  # fmt: skip
# what any apparatus of this kind has of one size: where one is so many times another, a decimal point slipped
ALIKE = (
    ("leg.thigh.length", "leg.shank.length"),
    ("leg.thigh.mass", "leg.shank.mass"),
    ("leg.thigh.width", "leg.shank.width"),
    ("control.position.c1", "control.position.c2"),
    ("gap.tolerance.extensor_force", "gap.tolerance.flexor_force"),
    ("gap.tolerance.extensor_closed_voltage", "gap.tolerance.flexor_closed_voltage"),
    ("gap.tolerance.extensor_pressure_offset", "gap.tolerance.flexor_pressure_offset"),
)
SLIP = 8.0
BRAID_SHARE = (0.3, 5.0)  # what identified coefficients and the braid's geometry differ by at most
PHASES = 60
LEAST_DELAY = 5.0e-4  # s, of a Pade approximation: its states have less than a quarter of it
LONGEST_PERIOD = 0.05  # s, of the position controller: as long as a control period may be
FARTHEST_PLAN = 0.35  # rad: beyond it guards would take the knee for one that does not follow


def broken_rules(values: Mapping[str, Any]) -> Iterator[str]:
    """Yield one sentence for each broken rule among the values that are there."""
    for chain in ORDERED:
        known = [key for key in chain if key in values]
        for low, high in pairwise(known):
            if not values[low] < values[high]:
                yield f"{low} = {values[low]} must be below {high} = {values[high]}"
    for group in ALIKE:
        yield from _alike(values, group)
    for name in MUSCLES:
        yield from _braid_rule(values, f"muscle.{name}")
    yield from _period_rule(values)
    yield from _every_rule(values)
    yield from _duration_rule(values)
    yield from _step_rule(values)
    yield from _linkage_rule(values)
    yield from _reach_rule(values)
    yield from _plan_rule(values)
    yield from _delay_rule(values)


def _period_rule(values: Mapping[str, Any]) -> Iterator[str]:
    period, step = values.get("scenario.control_period"), values.get("plant.simulation.step")
    if period is None or step is None:
        return
    ratio = period / step
    if abs(ratio - round(ratio)) > 1e-9 * ratio or round(ratio) < 1:
        yield (
            f"scenario.control_period = {period} s must be a whole multiple of"
            f" plant.simulation.step = {step} s"
        )


def _delay_rule(values: Mapping[str, Any]) -> Iterator[str]:
    """Check that a dead time of the hardware, whose differential equations have it as a divisor, is one."""
    effect, delay = "plant.effects.valve_delay", values.get("plant.effects.valve_delay.delay")
    if values.get(f"{effect}.enabled") and delay != 0.0 and delay < LEAST_DELAY:
        yield f"{effect}.delay = {delay} s must be 0 or at least {LEAST_DELAY} s: hardware is never early"


def _every_rule(values: Mapping[str, Any]) -> Iterator[str]:
    every, period = values.get("control.position.every"), values.get("scenario.control_period")
    if every and period and every * period > LONGEST_PERIOD:
        yield (
            f"control.position.every = {every} times scenario.control_period = {period} s must be at most"
            f" {LONGEST_PERIOD} s"
        )


def _duration_rule(values: Mapping[str, Any]) -> Iterator[str]:
    duration, period = values.get("scenario.duration"), values.get("scenario.control_period")
    every = values.get("control.position.every", 1)
    if duration is not None and period is not None and duration < 4 * every * period:
        times = f" times control.position.every = {every}" if every > 1 else ""
        told = f"scenario.control_period = {period} s{times}"
        yield f"scenario.duration = {duration} s must be four times {told}"


def _step_rule(values: Mapping[str, Any]) -> Iterator[str]:
    if values.get("scenario.trajectory") != "steps":
        return
    rise, cycle = values["scenario.step.rise"], values["scenario.cycle_time"]
    if rise > 0.5 * cycle:
        yield f"scenario.step.rise = {rise} s must be at most half of scenario.cycle_time = {cycle} s"


def _alike(values: Mapping[str, Any], keys: tuple[str, ...]) -> Iterator[str]:
    sizes = {key: abs(values[key]) for key in keys if values.get(key)}
    if len(sizes) > 1 and max(sizes.values()) >= SLIP * min(sizes.values()):
        told = " and ".join(f"{key} = {values[key]}" for key in sizes)
        yield f"{told} are of the same kind and differ {SLIP:g}-fold or more; has a decimal point slipped?"


def _braid_rule(values: Mapping[str, Any], muscle: str) -> Iterator[str]:
    """Compare what the coefficients give at no contraction with the ideal braid and its cylinder."""
    diameter, angle = (values.get(f"{muscle}.geometry.{name}") for name in ("diameter", "fibre_angle"))
    if diameter is None:
        return
    section = math.pi / 4 * diameter**2
    area = section * (3 * math.cos(angle) ** 2 - 1) / math.sin(angle) ** 2
    volume = section * values[f"{muscle}.map_length"]
    for name, ideal, unit in (("force.a", area, "m^2"), ("volume.v", volume, "m^3")):
        first = values[f"{muscle}.{name}"][0]
        if not BRAID_SHARE[0] * ideal < first < BRAID_SHARE[1] * ideal:
            yield (
                f"{muscle}.{name} gives {first:g} {unit} at no contraction, the geometry in"
                f" {muscle}.geometry {ideal:.3g} {unit}; has a decimal point slipped?"
            )


def _linkage_rule(values: Mapping[str, Any]) -> Iterator[str]:
    """Check that Eq. (24) has a solution wherever the joint may go."""
    if "leg.configuration" not in values:
        return
    if abs(values["leg.configuration"]) != 1:
        yield f"leg.configuration = {values['leg.configuration']} must be 1 (knee up) or -1 (knee down)"
    thigh, shank = _segment_lengths(values)
    angles = (values["leg.joint.minimum"], values["leg.joint.maximum"])
    reach = min(math.hypot(thigh + shank * math.cos(q), shank * math.sin(q)) for q in angles)
    if abs(values["leg.bearing_height"]) >= reach:
        yield (
            f"leg.bearing_height = {values['leg.bearing_height']} m is out of reach of a leg bent as far as"
            f" leg.joint allows: from hip to ankle there are {reach:.3g} m then"
        )


def _segment_lengths(values: Mapping[str, Any]) -> tuple[float, ...]:
    if not values.get("leg.person.present"):
        return values["leg.thigh.length"], values["leg.shank.length"]
    height = values["leg.person.height"]
    return tuple(values[f"leg.person.{name}.length_fraction"] * height for name in ("thigh", "shank"))


def _reach_rule(values: Mapping[str, Any]) -> Iterator[str]:
    """Check that the knee may go where it is to start and to follow."""
    low, high = values.get("leg.joint.minimum"), values.get("leg.joint.maximum")
    if low is None or high is None or "scenario.trajectory" not in values:
        return
    for name, angle in _angles(values):
        if not low <= angle <= high:
            limits = f"leg.joint.minimum = {low} .. leg.joint.maximum = {high}"
            yield f"{name} goes to {angle:.3g} rad, outside {limits}"
            return


def _angles(values: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    yield "scenario.start_angle", values["scenario.start_angle"]
    if values["scenario.trajectory"] == "sine":
        centre, amplitude = values["scenario.sine.centre"], values["scenario.sine.amplitude"]
        yield from (("scenario.sine.amplitude", centre + sign * amplitude) for sign in (-1, 1))
    if values["scenario.trajectory"] == "steps":
        yield from ((key, values[key]) for key in ("scenario.step.low", "scenario.step.high"))
    if values["scenario.trajectory"] == "gait":
        yield from (("scenario.gait", angle) for angle in _waves(values, "scenario.gait"))


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
    if low is not None and not low <= min(pressures) <= max(pressures) <= high:
        told = f"goes from {min(pressures):.3g} to {max(pressures):.3g} Pa"
        yield f"scenario.plan.pressure {told}, outside control.position's limits {low:.3g} .. {high:.3g} Pa"


def _settled_and_started(values: Mapping[str, Any], name: str) -> list[float]:
    """Return what a plan asks for over a cycle, when it has settled and at the start."""
    settled = _waves(values, f"scenario.plan.{name}")
    added = _waves(values, f"scenario.plan.start.{name}")
    return settled + [value + more for value, more in zip(settled, added, strict=True)]


def motion_digest(values: Mapping[str, Any]) -> str:
    """Return what tells one motion, of a leg with or without a person, from another."""
    trajectory = values["scenario.trajectory"]
    keys = [key for key in sorted(values) if key.startswith(f"scenario.{SHAPES.get(trajectory)}.")]
    keys += ["scenario.start_phase", "scenario.start_angle", "leg.person.present"]
    numbers = [values[key] if isinstance(values[key], list) else [values[key]] for key in keys]
    told = trajectory, keys, [[float(number) for number in each] for each in numbers]
    return hashlib.sha256(repr(told).encode()).hexdigest()[:12]


def _waves(values: Mapping[str, Any], series: str) -> list[float]:
    """Return the values of a Fourier series of the parameters over a cycle."""
    pairs = list(enumerate(zip(values[f"{series}.cosine"], values[f"{series}.sine"], strict=True)))
    phases = [2 * math.pi * k / PHASES for k in range(PHASES)]
    return [sum(a * math.cos(n * phase) + b * math.sin(n * phase) for n, (a, b) in pairs) for phase in phases]
