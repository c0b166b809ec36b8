# SPDX-License-Identifier: Apache-2.0
"""The test rig as a system of the gap workflow: a carriage between the investigated muscle and a MAS-40."""

from collections.abc import Mapping

from pam_orthosis.discrepancy.systems.machine_system import machine_system
from pam_orthosis.discrepancy.systems.system import Channel, System
from pam_orthosis.discrepancy.systems.view import Symbols, View, from_rows
from pam_orthosis.model.deviations import DEVIATIONS, GAS
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.rig import with_specimen
from pam_orthosis.model.signals import Expression, Signals

# those of each actuator's valve and pressure sensor
OF_ACTUATORS = {
    "closed_voltage": "standard deviation of the {} valve's mid position",
    "pressure_offset": "standard deviation of the {} sensor's offset",
}
# keys of the nominal model that recordings share
OF_RIG = ("effects.", "carriage_mass", "position_offset", "supply_pressure")
APPARATUS = ("muscle.", "valve.", *(f"rig.{name}" for name in OF_RIG))
POSITION, FORCE = "rig_position", "rig_force"
PRESSURES = {"specimen": "rig_pressure", "positioner": "rig_positioner_pressure"}
CHANNELS = (
    Channel(POSITION, "position", "m", "mm", 1e3),
    Channel(FORCE, None, "N", "N", 1.0),
    *(Channel(name, f"{muscle}_pressure", "Pa", "mbar", 0.01) for muscle, name in PRESSURES.items()),
)


def test_rig(parameters: Parameters, specimen: str) -> System:
    """Return the rig as its parameters describe it; `plant` is not read.

    Args:
        parameters: the tree; effects that `rig.effects.*` switches on belong to the nominal model.
        specimen: the investigated muscle, one of `model.specimens.SPECIMENS`.
    """
    return machine_system(with_specimen(specimen), parameters, _view)


def _view(machine: Machine, nominal: Parameters) -> View:
    investigated, positioner = (one.parameters for one in machine.actuators)
    replay = nominal.gap.rig.replay
    return View(
        title=f"test rig with a {investigated.removeprefix('muscle.')}",
        equation="carriage",
        channels=CHANNELS,
        inputs=("rig_voltage", "rig_positioner_voltage"),
        calibrations=from_rows(nominal, *_tolerances(machine, nominal)),
        # Eq. (8) neglects the positioner's damping: what it has is all deviation
        multiplied={
            **DEVIATIONS,
            "carriage_mass": ("rig.carriage_mass",),
            "specimen_damping": (f"{investigated}.force.damping",),
        },
        added={"position_offset": "rig.position_offset", "positioner_damping": f"{positioner}.force.damping"},
        gains=(replay.position_gain, replay.velocity_gain),
        learns=False,
        beside=_load_cell,
    )


def _tolerances(machine: Machine, nominal: Parameters) -> tuple[dict[str, str], dict[str, str]]:
    """Return the keys of the rows of all tolerances, and what those of actuators mean."""
    keys = {name: f"gap.rig.tolerance.{name}" for name, _ in nominal.gap.rig.tolerance.items()}
    keys |= {name: f"gap.tolerance.{name}" for name in GAS}
    meanings = {}
    for kind, meaning in OF_ACTUATORS.items():
        for known, name in zip(KNEE.names, machine.names, strict=True):
            keys[f"{name}_{kind}"] = f"gap.tolerance.{known}_{kind}"
            meanings[f"{name}_{kind}"] = meaning.format(name)
    return keys, meanings


def _load_cell(s: Signals, symbols: Symbols) -> Mapping[str, Expression]:
    """Return what the load cell shows."""
    tension = s.actuators["specimen"].tension
    return {FORCE: (1 + symbols["load_cell_scale"]) * tension + symbols["load_cell_offset"]}
