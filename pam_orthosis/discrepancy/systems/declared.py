# SPDX-License-Identifier: Apache-2.0
"""A machine of a file as a system of the gap workflow, with the tolerances of knee and rig."""

from collections.abc import Mapping
from dataclasses import replace

from pam_orthosis.bag.topics import Topics
from pam_orthosis.discrepancy.systems.knee import SUSPECTS
from pam_orthosis.discrepancy.systems.machine_system import machine_system
from pam_orthosis.discrepancy.systems.suspects import ARMS, ASSEMBLED, VALVE, Suspects, each
from pam_orthosis.discrepancy.systems.system import Channel, Source, System
from pam_orthosis.discrepancy.systems.view import View, from_rows, graph_view
from pam_orthosis.model.deviations import DEVIATIONS, GAS
from pam_orthosis.model.effects.base import Effect
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.mechanisms.base import ROTATION
from pam_orthosis.model.parameters import Parameters

APPARATUS = (
    "machine.",
    "leg.",
    "muscle.",
    "valve.",
    "effects.",
)  # keys of the nominal model that recordings share
SIZES = {"muscle": "length", "cylinder": "area"}  # of an actuator, by its kind
DAMPING = {"muscle": "force.damping", "cylinder": "damping"}
MASSES = ("leg.shoe_mass",)  # of the ankle: where it is wrong, all forces are by one factor
# what may be off in machines of the leg, and in those that carry a person's
OF_LEG = {"knee": ("moving_mass", "muscle_damping"), "ankle": ("moving_mass", "small_muscle_damping")}
OF_PERSON = {"knee": ("person_mass",), "ankle": ("person_mass", "passive_moment")}


def declared_machine(
    machine: Machine,
    parameters: Parameters,
    catalogue: Mapping[str, Effect] | None = None,
    external: bool = False,
) -> System:
    """Return a machine as its file and the parameters describe it; see `machine_system`."""
    return machine_system(machine, parameters, _view, catalogue, external)


def coupled_joint(
    machine: Machine,
    beside: Source,
    parameters: Parameters,
    catalogue: Mapping[str, Effect] | None = None,
    external: bool = False,
) -> System:
    """Return a joint of a coupled mechanism: how the other one moves is recorded (`beside`), and known."""

    def view(machine: Machine, nominal: Parameters) -> View:
        alone, name = _view(machine, nominal), f"{machine.neighbour}_angle"
        angle = Channel(name, name, ROTATION.unit, ROTATION.shown_unit, ROTATION.shown_factor)
        of_knee = machine.kind == "knee"
        return replace(
            alone,
            title=f"{machine.meaning}, the {machine.neighbour} moving as recorded",
            channels=(*alone.channels, angle),
            neighbour=machine.neighbour,
            stiff=not of_knee,
            usual=of_knee,
            suspects=SUSPECTS if of_knee else alone.suspects,
            sources={**alone.sources, name: beside},
        )

    return machine_system(machine, parameters, view, catalogue, external)


def _view(machine: Machine, nominal: Parameters) -> View:
    own: dict[str, tuple[str, ...]]
    own = {name: (f"{machine.parameters}.{name}",) for name in ("inertia", "damping", "weight")}
    damped = _damped(machine, nominal)
    own |= {f"{name}_damping": () for name in damped}  # no row of all actuators of that kind
    return replace(
        graph_view(machine, nominal),
        calibrations=from_rows(nominal, *_tolerances(machine, nominal)),
        multiplied={**DEVIATIONS, **own},
        damped=damped,
        suspects={**each(*VALVE), **_suspects(machine, nominal)},
        usual=False,
        sources=_sources(machine),
    )


def _suspects(machine: Machine, nominal: Parameters) -> Suspects:
    """Return what of a machine's own may be wrong: what it moves, actuators, each arm, all by one factor."""
    if machine.parameters == "leg":
        return each(*(MASSES if machine.kind == "ankle" else ()))
    values = nominal.flat()
    loads = (f"{machine.parameters}.{name}" for name in ("inertia", "stiffness", "weight"))
    arms = tuple(f"{one.transmission}.arm" for one in machine.actuators)
    muscles = [f"{one.transmission}{ASSEMBLED}" for one in machine.actuators if one.kind == "muscle"]
    turns = machine.coordinate.unit == "rad" and all(values.get(key) for key in arms)
    sizes = dict.fromkeys(f"{one.parameters}.{SIZES[one.kind]}" for one in machine.actuators)
    assembled = [key for key in muscles if key in values]
    found = each(*(key for key in loads if values[key]), *sizes, *assembled, *(arms if turns else ()))
    return {**found, **({ARMS: arms} if turns and len(arms) > 1 else {})}


def _damped(machine: Machine, nominal: Parameters) -> tuple[str, ...]:
    """Return the actuators of a machine that is no leg which have a damping.

    Each is off by itself: two muscles of one kind share what the nominal model says, not what is true.
    """
    if machine.parameters == "leg":
        return ()
    known = nominal.flat()
    return tuple(one.name for one in machine.actuators if known[f"{one.parameters}.{DAMPING[one.kind]}"])


def _tolerances(machine: Machine, nominal: Parameters) -> tuple[dict[str, str], dict[str, str]]:
    """Return the keys of the rows of all tolerances, and their meanings."""
    keys: dict[str, str] = {}
    meanings: dict[str, str] = {}
    known = nominal.flat()

    def add(name: str, row: str, meaning: str) -> None:
        keys[name], meanings[name] = f"gap.{row}", f"standard deviation of {meaning}"

    def add_each(kind: str, meaning: str) -> None:
        for one in machine.names:
            row = one if f"gap.tolerance.{one}_{kind}" in known else "extensor"
            add(f"{one}_{kind}", f"tolerance.{row}_{kind}", meaning.format(one))

    if machine.parameters == "leg":
        kind, present = machine.kind, nominal.leg.person.present
        for name in (*OF_LEG[kind], *(OF_PERSON[kind] if present else ())):
            add(name, f"tolerance.{name}", f"the {name.replace('_', ' ')}, relative")
    else:
        add("inertia", "tolerance.moving_mass", "the inertia, relative")
        if known[f"{machine.parameters}.damping"]:
            add("damping", "tolerance.muscle_damping", "the damping, relative")
        if known[f"{machine.parameters}.weight"]:
            add("weight", "tolerance.moving_mass", "the weight, relative")
        for name in _damped(machine, nominal):
            add(f"{name}_damping", "tolerance.muscle_damping", f"the {name}'s damping, relative")
    add_each("force", "the {}'s static force, relative")
    for name in GAS:
        add(name, f"tolerance.{name}", f"the {name.replace('_', ' ')}, relative")
    add_each("closed_voltage", "the {} valve's mid position")
    offset = "tolerance.angle_offset" if machine.coordinate.unit == "rad" else "rig.tolerance.position_offset"
    add(f"{machine.coordinate.name}_offset", offset, "the sensor's offset")
    add_each("pressure_offset", "the {} sensor's offset")
    return keys, meanings


def _sources(machine: Machine) -> dict[str, Source]:
    """Return where bags have the signals: the topics of the graph."""
    voltages = (f"{name}_voltage" for name in machine.names)
    signals = Topics(machine).signals
    return {
        name: Source(topic=one.topic, type=one.type, field=one.field, joint=one.joint, spool=one.spool)
        for name in (*machine.channels, *voltages)
        for one in [signals[name]]
    }
