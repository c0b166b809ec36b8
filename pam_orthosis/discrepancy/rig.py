# SPDX-License-Identifier: Apache-2.0
"""The test rig as a system of the gap workflow: a carriage between the investigated muscle and a MAS-40."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import casadi as ca

from pam_orthosis.bag.read import run_record
from pam_orthosis.discrepancy.data import Recording, from_bag, is_table
from pam_orthosis.discrepancy.system import Assembled, Calibration, Channel, Equation, System
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model import orthosis, rig
from pam_orthosis.model.effects.base import enabled
from pam_orthosis.model.parameters import Section
from pam_orthosis.model.rig_effects import RIG_CATALOGUE, at_rig
from pam_orthosis.model.specimens import SPECIMENS

# tolerance -> believed parameters that it multiplies, beside those of the muscles
MULTIPLIES = {
    "carriage_mass": "rig.carriage_mass",
    "conductance": "valve.conductance",
    "critical_ratio": "valve.critical_ratio",
    "polytropic_exponent": "valve.polytropic_exponent",
    "supply_pressure": "valve.supply_pressure",
    "hose_volume": "valve.hose.volume",
}
# of the knee's tolerances, those of gas, valves and pressure sensors
SHARED_TOLERANCES = (
    "conductance", "critical_ratio", "polytropic_exponent", "supply_pressure", "hose_volume",
    "extensor_closed_voltage", "flexor_closed_voltage", "extensor_pressure_offset", "flexor_pressure_offset",
)  # fmt: skip
# keys of the belief that recordings share
APPARATUS = (
    "muscle.",
    "valve.",
    "rig.effects.",
    "rig.carriage_mass",
    "rig.position_offset",
    "rig.supply_pressure",
)
POSITION, FORCE = "rig_position", "rig_force"
PRESSURES = {"extensor": "rig_pressure", "flexor": "rig_positioner_pressure"}
VOLTAGES = ("rig_voltage", "rig_positioner_voltage")
CHANNELS = (
    Channel(POSITION, "position", "m", "mm", 1e3),
    Channel(FORCE, None, "N", "N", 1.0),
    *(Channel(name, f"{muscle}_pressure", "Pa", "mbar", 0.01) for muscle, name in PRESSURES.items()),
)
UNFIT_TESTS = {"decay": "the MAS-40 is unhooked in a free decay"}


def test_rig(parameters, specimen: str) -> System:
    """Return the rig as the belief describes it; `plant` is not read.

    Args:
        parameters: the tree; effects that `rig.effects.*` switches on belong to the nominal model.
        specimen: the investigated muscle, one of `model.specimens.SPECIMENS`.
    """
    belief = rig.at_rig(parameters).only("muscle", "valve", "rig", "gap")
    present = enabled(belief.rig.effects)
    return System(
        name=f"test rig with a {specimen}",
        channels=CHANNELS,
        inputs=VOLTAGES,
        derived={"velocity": "position"},
        equations=_equations(belief.gap),
        calibrations=_calibrations(belief),
        catalogue={name: effect for name, effect in _catalogue().items() if name not in present},
        assemble=lambda effects: _assemble(belief, specimen, effects),
        needs=dict.fromkeys(("gas", "valve", "supply"), VOLTAGES),
        equation_names={"torque": "carriage"},
        branch="rig.effects",
        input_period="rig.control_period",
        simpler={name: partial(_without, parameters, name, specimen) for name in present},
    )


def _without(parameters, effect: str, specimen: str) -> System:
    return test_rig(parameters.changed({f"rig.effects.{effect}.enabled": False}), specimen)


def recording(path: Path, system: System, namespace: str = "") -> Recording:
    """Return the recording of a rig bag.

    Raises:
        OrthosisError: as `from_bag`, or a test in which the rig was another one.
    """
    test = run_record(path).get("test")
    if test in UNFIT_TESTS:
        raise OrthosisError(f"{path}: {UNFIT_TESTS[test]}; give bags of other tests")
    return from_bag(path, system, namespace)


def specimen_of(path: Path) -> str | None:
    """Return the investigated muscle of a rig bag; None for a recording of another system."""
    if is_table(path):
        return None
    specimen = run_record(path).get("specimen")
    return specimen if specimen in SPECIMENS else None


def _catalogue():
    """Return the rig's effects with the rig's channels in place of the signals they lag behind."""
    channels = {at_rig(f"{muscle}_pressure"): name for muscle, name in PRESSURES.items()}

    def told(effect):
        if effect.advance is None:
            return replace(effect, coordinate=channels.get(effect.coordinate, effect.coordinate))
        return replace(effect, advance=lambda p: {channels[k]: v for k, v in effect.advance(p).items()})

    return {name: told(effect) for name, effect in RIG_CATALOGUE.items()}


def _equations(settings) -> tuple[Equation, ...]:
    observer = settings.rig.replay
    motion = {POSITION: {"position": observer.position_gain, "velocity": observer.velocity_gain}}
    gas = {name: {f"{m}_pressure": settings.replay.pressure_gain} for m, name in PRESSURES.items()}
    return (
        Equation("carriage", ("position", "velocity"), (POSITION, FORCE), motion, stiff=True),
        Equation(
            "gas", tuple(f"{m}_pressure" for m in PRESSURES), tuple(PRESSURES.values()), gas, stiff=True
        ),
    )


def _calibrations(belief) -> tuple[Calibration, ...]:
    keys = [f"gap.rig.tolerance.{name}" for name, _ in belief.gap.rig.tolerance.items()]
    keys += [f"gap.tolerance.{name}" for name in SHARED_TOLERANCES]
    rows = [belief.row(key) for key in keys]
    names = [at_rig(row.key.rsplit(".", 1)[1]) for row in rows]
    return tuple(
        Calibration(name, row.value, row.unit, at_rig(row.meaning))
        for name, row in zip(names, rows, strict=True)
    )


def _assemble(belief, specimen: str, effects: tuple[str, ...]) -> Assembled:
    names = [one.name for one in _calibrations(belief)]
    own = [f"{name}.{q.name}" for name in effects for q in RIG_CATALOGUE[name].parameters]
    theta = ca.SX.sym("theta", len(names) + len(own))
    symbols = dict(zip([*names, *own], ca.vertsplit(theta), strict=True))
    assembly = rig.assembled(_hardware(belief, specimen, effects, symbols))
    u = ca.SX.sym("u", 2)
    volts = [u[i] + symbols[at_rig(f"{m}_closed_voltage")] for i, m in enumerate(orthosis.MUSCLES)]
    inputs = ca.vertcat(*volts, *[0] * (len(rig.INPUTS) - 2))  # no weight, no hand
    measured = _measured(assembly.signals, symbols)
    rates, *seen = ca.substitute([assembly.rates, *measured.values()], [assembly.u], [inputs])
    told = dict(zip(measured, seen, strict=True))
    time = ca.SX.sym("time")
    return Assembled(assembly.states, assembly.x, u, time, theta, (*names, *own), rates, told)


def _measured(s, symbols) -> dict[str, ca.SX]:
    """Return what the sensors show: channel -> expression."""
    force = (1 + symbols["load_cell_scale"]) * s.extensor_tension + symbols["load_cell_offset"]
    pressures = {
        name: getattr(s, f"measured_{m}_pressure") + symbols[at_rig(f"{m}_pressure_offset")]
        for m, name in PRESSURES.items()
    }
    return {POSITION: s.position, FORCE: force, **pressures}


def _hardware(belief, specimen: str, effects, symbols) -> rig.RigHardware:
    values = belief.flat()
    deviating = {key: values[key] * (1 + symbols[name]) for name, key in MULTIPLIES.items()}
    deviating["rig.position_offset"] = values["rig.position_offset"] + symbols["position_offset"]
    true = belief.substituted(deviating)
    muscles = {"extensor": getattr(true.muscle, specimen), "flexor": true.muscle.mas_40}
    settings = dict(belief.rig.effects.items())
    for name in effects:
        own = {q.name: symbols[f"{name}.{q.name}"] for q in RIG_CATALOGUE[name].parameters}
        settings[name] = Section(f"rig.effects.{name}", {"enabled": True, **own})
    return rig.RigHardware(
        rig=true.rig,
        valve=true.valve,
        muscles=muscles,
        damping={
            "extensor": muscles["extensor"].force.damping * (1 + symbols["specimen_damping"]),
            "flexor": muscles["flexor"].force.damping + symbols["positioner_damping"],
        },
        laws={m: _law(one, symbols[at_rig(f"{m}_force")]) for m, one in muscles.items()},
        effects=Section("rig.effects", settings),
        catalogue=RIG_CATALOGUE,
    )


def _law(m, deviation) -> orthosis.MuscleLaw:
    law = orthosis.polynomial_law(m)
    return orthosis.MuscleLaw(lambda dl, p: (1 + deviation) * law.force(dl, p), law.volume)
