# SPDX-License-Identifier: Apache-2.0
"""What the model computes at fixed points: plants, closed loops, the gap workflow's equations.

Every case is a table of columns of numbers. Voltages, states and parameters follow from the case alone, and
from places and units of what a system lists, never from how a state is called.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping

import casadi as ca
import numpy as np

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.control.rig_loop import Rig
from pam_orthosis.discrepancy.systems.knee import knee
from pam_orthosis.discrepancy.systems.rig import test_rig
from pam_orthosis.discrepancy.systems.system import Assembled, System
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import Parameters, load, scenario_overrides
from pam_orthosis.model.plant import Plant
from pam_orthosis.model.rig import RigPlant

Column = list[float]
Case = dict[str, Column]

SECONDS = 0.5
POINTS = 4
RIG_STEPS = 100  # of 2 ms
SPECIMENS = ("dmsp_20", "dmsp_10")
SHAKEN = {"plant.external_torque": 3.0, "plant.external_frequency": 0.8}
KNEES = {
    "default": scenario_overrides("default"),
    "person": scenario_overrides("person"),
    "locked": scenario_overrides("diagnostic-locked"),
    "polynomial": {"plant.muscle_law": "polynomial", **SHAKEN},
    "none": {f"plant.effects.{name}.enabled": False for name in KNEE.catalogue},
    "all effects": {f"plant.effects.{name}.enabled": True for name in KNEE.catalogue} | SHAKEN,
}
# effects that the controllers' model has: those of each stage that go together
LEARNED = (
    "joint_friction", "muscle_hysteresis", "extra_foot_mass", "parallel_elasticity", "supply_sag",
    "extensor_leak", "flexor_dead_volume", "polytropic_exponent", "valve_dead_band", "valve_lag",
    "extensor_valve_gain", "flexor_pressure_offset", "angle_gain", "extensor_force_scale",
)  # fmt: skip
SLOW = {"control.position.every": 2, "control.observer.pole": 60.0, "control.position.c1": 20.0,
        "control.position.c2": 20.0}  # fmt: skip
MOVING = {"scenario.start_hold": 0.05, "scenario.start_ramp": 0.1}
LOOPS = {
    "default": scenario_overrides("default"),
    "person": scenario_overrides("person") | SHAKEN,
    "every other step": SLOW,
    "learned effects": SLOW | {f"effects.{name}.enabled": True for name in LEARNED},
}
# a state's or voltage's values by its unit, and those of a state that is a difference quotient
RANGES = {"rad": (0.2, 1.1), "Pa": (1.5e5, 6.0e5), "m": (0.002, 0.06), "V": (3.0, 7.0)}
SPEEDS = {"rad": 3.0, "m": 0.2}


def cases() -> Iterator[tuple[str, Case]]:
    """Yield name and table of every case."""
    yield "parameters", {key: _numbers(value) for key, value in load().flat().items()}
    for name, overrides in KNEES.items():
        yield f"knee plant, {name}", _knee_plant(load(overrides))
    for specimen in SPECIMENS:
        yield f"rig plant, {specimen}", _rig_plant(specimen)
    yield "rig plant, weight and hand", _weighed_rig()
    for name, overrides in LOOPS.items():
        parameters = load(overrides | MOVING)
        steps = round(SECONDS / parameters.scenario.control_period)
        loop = ClosedLoop(parameters, 1)
        yield f"knee loop, {name}", {key: row.tolist() for key, row in loop.run(steps).items()}
    yield "rig loop", _rig_loop()
    yield from _gap_cases()


def _numbers(value) -> Column:
    """Return a parameter's value as numbers; a text by its bytes."""
    if isinstance(value, str):
        return [float(byte) for byte in value.encode()]
    return [float(one) for one in value] if isinstance(value, list) else [float(value)]


def _table(rows: list[dict[str, float]]) -> Case:
    return {name: [float(row[name]) for row in rows] for name in rows[0]}


def _voltages(step: int) -> tuple[float, float]:
    wave = 0.8 * np.sin(2 * np.pi * 2.5 * step * 5e-3)
    return 5.02 + wave, 4.98 - wave


def _knee_plant(parameters: Parameters) -> Case:
    plant, rows = Plant(parameters, 1), []
    for step in range(round(SECONDS / parameters.scenario.control_period)):
        sensors = {f"measured {name}": value for name, value in plant.measure()._asdict().items()}
        states = {f"state {name}": x for name, x in zip(plant.states, plant.state.tolist(), strict=True)}
        rows.append(sensors | plant.truth()._asdict() | states)
        plant.advance(*_voltages(step))
    return _table(rows)


def _rig_row(plant: RigPlant) -> dict[str, float]:
    sensors = {f"measured {name}": value for name, value in plant.measure()._asdict().items()}
    return sensors | plant.truth()._asdict() | plant.calliper()._asdict()


def _rig_plant(specimen: str) -> Case:
    plant, rows = RigPlant(load(), specimen, 1, 0.01, 3.0e5), []
    for step in range(RIG_STEPS):
        rows.append(_rig_row(plant))
        plant.advance(*_voltages(step))
    return _table(rows)


def _weighed_rig() -> Case:
    plant, rows = RigPlant(load(), "dmsp_20", 1, weight=20.0), []
    for step in range(RIG_STEPS):
        rows.append(_rig_row(plant))
        plant.advance(6.0, 5.0, hand=0.02 if step > RIG_STEPS // 2 else None)
    return _table(rows)


def _rig_loop() -> Case:
    rig, rows = Rig(load(), "dmsp_20", 1, 0.01), []
    for step in range(RIG_STEPS):
        sample = rig.step(2.0e5 + 2.0e3 * step, 0.02)
        rows.append(
            {f"flow {i}": x for i, x in enumerate(sample.flows)}
            | {f"voltage {i}": x for i, x in enumerate(sample.voltages)}
            | {f"estimate {name}": x for name, x in sample.estimate._asdict().items()}
            | sample.truth._asdict()
        )
    return _table(rows)


def systems() -> dict[str, System]:
    """Return the systems of the gap workflow, nominal and with effects that the model has already."""
    learned = {f"effects.{name}.enabled": True for name in LEARNED}
    friction = {"rig.effects.carriage_friction.enabled": True}
    return {
        "knee": knee(load()),
        "knee with a person": knee(load(scenario_overrides("person"))),
        "knee with learned effects": knee(load(learned)),
        **{f"rig, {specimen}": test_rig(load(), specimen) for specimen in SPECIMENS},
        "rig with learned friction": test_rig(load(friction), "dmsp_20"),
    }


def _gap_cases() -> Iterator[tuple[str, Case]]:
    for name, system in systems().items():
        others = system.candidates if name in ("knee", "rig, dmsp_20") else ()
        for effects in ((), system.shapes, *((one,) for one in others), tuple(others)):
            yield f"gap, {name}, {' + '.join(effects)[:60] or 'nominal'}", _assembled(system, effects)


def _assembled(system: System, effects: tuple[str, ...]) -> Case:
    """Return rates and measured channels of a system's equations at a few random points."""
    model = system.assemble(effects)
    outputs = {f"rate {i}": one for i, one in enumerate(ca.vertsplit(model.rates))} | dict(model.measured)
    inputs = [model.x, model.u, model.time, model.theta]
    function = ca.Function("f", inputs, [ca.vertcat(*outputs.values())])
    rng = np.random.default_rng(zlib.crc32(" ".join(effects).encode()))
    points = [np.array(function(*_point(rng, system, model, effects))).ravel() for _ in range(POINTS)]
    return dict(zip(outputs, np.array(points).T.tolist(), strict=True))


def _point(rng: np.random.Generator, system: System, model: Assembled, effects) -> tuple:
    units = {channel.state: channel.unit for channel in system.channels}
    scales = {n: s for e in system.bare().catalogue.values() for n, s in zip(e.states, e.scales, strict=True)}

    def state(name: str) -> float:
        if name in units:
            return rng.uniform(*RANGES[units[name]])
        if name in system.derived:
            return rng.uniform(-1, 1) * SPEEDS[units[system.derived[name]]]
        return rng.uniform(-0.8, 0.8) * scales[name]

    theta = [0.5 * rng.standard_normal() * one.sd for one in system.calibrations]
    quantities = (q for name in effects for q in system.catalogue[name].parameters)
    theta += [_value(rng, q) for q in quantities]
    voltages = [rng.uniform(*RANGES["V"]) for _ in system.inputs]
    return [state(name) for name in model.states], voltages, rng.uniform(0, 10), theta


def _value(rng: np.random.Generator, quantity) -> float:
    if quantity.prior is not None:
        return quantity.prior * rng.standard_normal()
    return min(max(quantity.typical * rng.uniform(0.8, 1.2), quantity.minimum), quantity.maximum)


def differences(reference: Mapping[str, Case], cases: Mapping[str, Case]) -> list[str]:
    """Return a line on every column of a reference that is not there or not the same to the bit."""
    lines = []
    for case, columns in reference.items():
        for name, before in columns.items():
            after = cases.get(case, {}).get(name)
            if after is None:
                lines.append(f"{case}: {name} is missing")
            elif line := _difference(np.array(before), np.array(after)):
                lines.append(f"{case}: {name} {line}")
    return lines


def _difference(before: np.ndarray, after: np.ndarray) -> str:
    if before.shape != after.shape:
        return f"has {len(after)} values, not {len(before)}"
    other = (before != after) | (np.signbit(before) != np.signbit(after))
    other &= ~(np.isnan(before) & np.isnan(after))
    if not other.any():
        return ""
    at = int(np.argmax(other))
    size = np.abs(after - before) / np.maximum(np.abs(before), 1e-300)
    first = f"{float(before[at])!r} -> {float(after[at])!r}"
    return (
        f"differs in {other.sum()} of {len(before)} values, first at {at}: {first}"
        f" (at most {np.max(size[other]):.1e} relative)"
    )
