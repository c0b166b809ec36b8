# SPDX-License-Identifier: Apache-2.0
"""Topics and signals of the test rig, beside those of the knee in `bag.topics`.

Same conventions: stamped standard types, truth on a topic of its own that identification never reads.
"""

from __future__ import annotations

from pam_orthosis.bag.topics import JOINT, MOTION, PRESSURE, WRENCH, Signal, Topic, typed

NAMESPACE = "rig"


def _topic(name: str, type_: str, meaning: str, unit: str) -> Topic:
    return Topic(f"{NAMESPACE}/{name}", type_, (NAMESPACE,), (), meaning, unit)


RIG_TOPICS = (
    _topic("joint_states", JOINT, "measured position of the carriage", "m"),
    _topic("specimen/pressure", PRESSURE, "measured pressure of the investigated muscle", "Pa"),
    _topic("positioner/pressure", PRESSURE, "measured pressure of the MAS-40", "Pa"),
    _topic("specimen/force", WRENCH, "load cell, force along x", "N"),
    _topic("specimen/cylinder", JOINT, "calliper: diameter and length of the cylinder", "m"),
    _topic("truth", JOINT, "state of the emulated rig", "SI"),
    _topic("reference", MOTION, "position to follow", "m, m/s, m/s^2"),
    _topic("specimen/pressure_reference", PRESSURE, "pressure to hold", "Pa"),
    _topic("estimate", JOINT, "observer: position, velocity", "m, m/s"),
    _topic("specimen/mass_flow", JOINT, "mass flow to reach (velocity)", "kg/s"),
    _topic("positioner/mass_flow", JOINT, "mass flow to reach (velocity)", "kg/s"),
    _topic("specimen/valve_voltage", JOINT, "valve voltage (effort)", "V"),
    _topic("positioner/valve_voltage", JOINT, "valve voltage (effort)", "V"),
)


def _signal(name: str, topic: str, field: str, joint: str, unit: str) -> Signal:
    return Signal(f"{NAMESPACE}_{name}", f"{NAMESPACE}/{topic}", field, joint, unit)


_SIGNALS = (
    _signal("position", "joint_states", "position", "carriage", "m"),
    _signal("pressure", "specimen/pressure", "fluid_pressure", "", "Pa"),
    _signal("positioner_pressure", "positioner/pressure", "fluid_pressure", "", "Pa"),
    _signal("force", "specimen/force", "wrench.force.x", "", "N"),
    _signal("diameter", "specimen/cylinder", "position", "diameter", "m"),
    _signal("cylinder_length", "specimen/cylinder", "position", "length", "m"),
    _signal("voltage", "specimen/valve_voltage", "effort", "specimen_valve", "V"),
    _signal("positioner_voltage", "positioner/valve_voltage", "effort", "positioner_valve", "V"),
    _signal("reference_position", "reference", "positions", "carriage", "m"),
    _signal("pressure_reference", "specimen/pressure_reference", "fluid_pressure", "", "Pa"),
    _signal("estimate_velocity", "estimate", "velocity", "carriage", "m/s"),
    _signal("truth_position", "truth", "position", "carriage", "m"),
    _signal("truth_force", "truth", "effort", "specimen", "N"),
)
RIG_SIGNALS = typed(_SIGNALS, RIG_TOPICS)
